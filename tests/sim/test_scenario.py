from __future__ import annotations

import copy
import dataclasses
import math
import operator
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import pytest
import yaml
from skd_sim.encounter.known_scenarios import shipped_scenarios
from skd_sim.encounter.road import Road
from skd_sim.encounter.road_user import RoadUser
from skd_sim.encounter.scenario import Scenario, load_scenario, scenario_from_dict
from skd_sim.encounter.sections import Car, Collision, Sensor
from skd_sim.errors import UsageError

SECTIONS: dict[str, Any] = {"road": Road, "car": Car, "adversary": RoadUser, "collision": Collision}
SECTIONS["sensor"] = Sensor
OPTIONAL = ("sensor", "obstacles", "others", "ending", "control_period", "radius", "destination_x")
"""A disc needs its radius, which a box has not; and who crosses, the destination, which a region can stand for."""
BASE = load_scenario("crossing").as_dict()


def _numbers() -> list[tuple[str, float, float]]:
    """Every numeric key with its allowed range."""
    kinds: list[tuple[str, Any]] = [("", Scenario)] + [(f"{name}.", kind) for name, kind in SECTIONS.items()]
    return [
        (f"{prefix}{name}", allowed.low, allowed.high)
        for prefix, kind in kinds
        for name, hint in get_type_hints(kind, include_extras=True).items()
        for one in (hint, *get_args(hint))  # an optional number is a union of it and None
        if get_origin(one) is Annotated and hasattr(allowed := one.__metadata__[0], "low")
    ]


def _keys(*, optional: bool = False) -> list[str]:
    """Keys that a file must have, or those that it may leave out."""
    kinds: list[tuple[str, Any]] = [("", Scenario)] + [(f"{name}.", kind) for name, kind in SECTIONS.items()]
    return [
        f"{prefix}{field.name}"
        for prefix, kind in kinds
        for field in dataclasses.fields(kind)
        if field.name not in OPTIONAL and (field.default is not dataclasses.MISSING) == optional
    ]


def _changed(key: str, value: Any) -> dict[str, Any]:
    data = copy.deepcopy(BASE)
    *path, last = key.split(".")
    section = data
    for name in path:
        section = section[name]
    section[last] = value
    return data


def _message(data: Any) -> str:
    with pytest.raises(UsageError) as caught:
        scenario_from_dict(data, "some.yaml")
    message = str(caught.value)
    assert message.startswith("some.yaml: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_load_and_round_trip(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario_from_dict(scenario.as_dict()) == scenario
    assert scenario_from_dict(yaml.safe_load(yaml.safe_dump(scenario.as_dict()))) == scenario


def test_shipped_names() -> None:
    assert {"crossing", "citr_crossing"} <= set(shipped_scenarios())


def test_numbers_of_the_paper() -> None:
    scenario = load_scenario("crossing")
    assert scenario.time_step == 0.3
    assert scenario.car.start_speed == 25.0 / 3.0
    assert scenario.car.safe_distance == pytest.approx(9.921, abs=5e-4)
    assert (scenario.car.front + scenario.car.rear, scenario.car.width) == (4.5, 1.8)
    assert (scenario.adversary.speed, scenario.adversary.radius) == (2.5, 0.25)
    assert scenario.path_edge == pytest.approx(0.9 + 0.25)
    assert scenario.ticks == round(12.0 / 0.3)
    cart = load_scenario("citr_crossing").car
    assert (cart.front, cart.rear, cart.half_width) == (1.0, 1.2, 0.6)


@pytest.mark.parametrize(("key", "low", "high"), _numbers())
def test_a_number_out_of_range_names_key_and_range(key: str, low: float, high: float) -> None:
    values = [math.nextafter(low, -math.inf), math.nextafter(high, math.inf), math.nan, math.inf, "1", True, None]
    for value in (*values, [1.0]):
        message = _message(_changed(key, value))
        assert f"{key} must be a number from {low:g} to {high:g}" in message


@pytest.mark.parametrize(("key", "value", "kind"), [
    ("name", 3, "text"),
    ("description", None, "text"),
    ("car.meet_safe_trajectory", 1, "true or false"),
    ("car.meet_safe_trajectory", "yes", "true or false"),
    ("car.antilock", "yes", "true or false"),
])  # fmt: skip
def test_a_wrong_type_names_the_key(key: str, value: Any, kind: str) -> None:
    assert f"{key} must be {kind}, got {value!r}" in _message(_changed(key, value))


@pytest.mark.parametrize("key", _keys())
def test_a_missing_key_is_named(key: str) -> None:
    data = copy.deepcopy(BASE)
    *path, last = key.split(".")
    section = data
    for name in path:
        section = section[name]
    del section[last]
    assert f"missing key {key}" in _message(data)


@pytest.mark.parametrize("key", _keys(optional=True))
def test_a_key_with_a_default_may_be_left_out(key: str) -> None:
    data = copy.deepcopy(BASE)
    *path, last = key.split(".")
    section = data
    for name in path:
        section = section[name]
    section.pop(last, None)
    value = operator.attrgetter(key)
    assert value(scenario_from_dict(data)) == value(load_scenario("crossing"))


def test_a_file_from_before_the_dynamics_is_still_valid() -> None:
    """The keys that have come with `car.dynamics` all have defaults, and these mean the basic car on a dry road."""
    data = copy.deepcopy(BASE)
    for key in _keys(optional=True):
        *path, last = key.split(".")
        (data[path[0]] if path else data).pop(last, None)
    scenario = scenario_from_dict(data)
    assert scenario == load_scenario("crossing")
    assert (scenario.car.dynamics, scenario.road.friction, scenario.eta_max) == ("basic", 1.0, 5.0)


@pytest.mark.parametrize("value", ["fast", "", 3, None, True])
def test_unknown_dynamics_names_those_there_are(value: Any) -> None:
    assert f"car.dynamics must be one of basic, multi_body; got {value!r}" in _message(_changed("car.dynamics", value))


@pytest.mark.parametrize(("changes", "message"), [
    ({"radius": None}, "missing key adversary.radius (of a disc; or length and width, of a box)"),
    ({"radius": None, "length": 1.8}, "missing key adversary.width (a box needs length and width)"),
    ({"radius": None, "width": 0.6}, "missing key adversary.length (a box needs length and width)"),
    ({"width": 0.6}, "adversary has a radius and a width; give radius for a disc, or length and width for a box"),
    ({"kind": "A cyclist"}, "adversary.kind must be a name of small letters, digits and _, as pedestrian; got 'A cyc"),
    ({"kind": 3}, "adversary.kind must be text, got 3"),
])  # fmt: skip
def test_an_adversary_has_one_shape_and_a_name_for_what_it_is(changes: dict[str, Any], message: str) -> None:
    data = copy.deepcopy(BASE)
    data["adversary"] = {k: v for k, v in {**data["adversary"], **changes}.items() if v is not None}
    assert message in _message(data)


def test_a_box_reaches_as_far_as_its_corners() -> None:
    data = copy.deepcopy(BASE)
    del data["adversary"]["radius"]
    data["adversary"].update(length=1.8, width=0.6, kind="cyclist")
    scenario = scenario_from_dict(data)
    assert scenario.adversary.shape == (0.0, 0.9, 0.3)
    assert scenario.path_edge == pytest.approx(0.9 + math.hypot(0.9, 0.3))
    assert scenario_from_dict(scenario.as_dict()) == scenario
    north, stays = scenario.adversary.heading(0.0, 0.0, 1.0), scenario.adversary.heading(2.0, 0.0, 0.0)
    assert (north, stays) == (math.pi / 2, 2.0)


CURVE = {"length": 8.0, "radius": 8.0, "turn": "right"}


@pytest.mark.parametrize(("parts", "more", "message"), [
    ([{"length": 8.0, "radius": 8.0}], {}, "road.parts[0] has a radius and no turn; a curve needs both"),
    ([{"length": 8.0}, {"length": 8.0, "turn": "left"}], {}, "road.parts[1] has a turn and no radius"),
    ([{"length": 8.0, "radius": 8.0, "turn": "up"}], {}, "road.parts[0].turn must be one of left, right; got 'up'"),
    ([{"length": 0.0}], {}, "road.parts[0].length must be a number from 0.1 to 10000 (m), got 0"),
    ([{"radius": 8.0, "turn": "left"}], {}, "missing key road.parts[0].length"),
    ([{**CURVE, "radius": 1.5}], {}, "road.parts[0].radius must exceed half of road.lane_width (1.75 m), got 1.5"),
    ([{**CURVE, "length": 26.0}], {}, "more than half a circle; its length may be at most 25.13 m"),
    ([CURVE], {"origin": 8.5}, "road.origin must be at most the length of all parts (8 m), got 8.5"),
    ([], {"origin": 8.5}, "road.origin says where along road.parts the crossing point is; there are no parts"),
    ({"length": 3.0}, {}, "road.parts must be a list, got dict"),
])  # fmt: skip
def test_a_road_that_cannot_be_driven_names_its_key(parts: Any, more: dict[str, Any], message: str) -> None:
    data = copy.deepcopy(BASE)
    data["road"].update(parts=parts, **more)
    assert message in _message(data)


def test_a_curved_road_round_trips() -> None:
    data = copy.deepcopy(BASE)
    data["road"].update(parts=[{"length": 30.0}, CURVE, {"length": 20.0}], origin=40.0)
    scenario = scenario_from_dict(data)
    assert scenario.road.line.shape == (3, 6)
    assert scenario_from_dict(scenario.as_dict()) == scenario
    data["car"]["dynamics"] = "multi_body"
    assert "car.dynamics multi_body does not steer, so it cannot follow the curves of road.parts" in _message(data)


def test_overlap_at_the_start_on_a_curve() -> None:
    """The car begins 13 to 15.5 m before the crossing, around the corner: West of it, not South."""
    data = copy.deepcopy(BASE)
    data["road"].update(parts=[{"length": 30.0}, {"length": 4.0 * math.pi, "radius": 8.0, "turn": "left"}], origin=42.5)
    data["adversary"].update(start_x=-10.0, start_y=-8.0)
    assert "overlaps the adversary at the start" in _message(data)
    data["adversary"].update(start_x=-3.5, start_y=-14.0)
    scenario_from_dict(data)


def test_friction_needs_a_car_that_feels_it() -> None:
    message = _message(_changed("road.friction", 0.65))
    assert "road.friction 0.65 has no effect on car.dynamics basic" in message
    data = _changed("road.friction", 0.65)
    data["car"]["dynamics"] = "multi_body"
    assert scenario_from_dict(data).road.friction == 0.65


@pytest.mark.parametrize("key", ["colour", "car.colour", "road.colour", "adversary.colour", "collision.colour"])
def test_an_unknown_key_is_named(key: str) -> None:
    message = _message(_changed(key, 1))
    assert f"unknown key {key}; allowed: " in message


@pytest.mark.parametrize("section", sorted(SECTIONS))
@pytest.mark.parametrize("value", [None, 3, "text", [1]])
def test_a_section_must_be_a_mapping(section: str, value: Any) -> None:
    assert f"{section} must be a mapping" in _message(_changed(section, value))


@pytest.mark.parametrize("data", [None, 3, "text", []])
def test_the_file_must_be_a_mapping(data: Any) -> None:
    assert "the file must be a mapping" in _message(data)


@pytest.mark.parametrize(("x", "y"), [(0.0, -20.0), (-1.1, -14.0), (0.0, -13.1), (0.9, -18.0)])
def test_overlap_at_the_start(x: float, y: float) -> None:
    data = _changed("adversary.start_x", x)
    data["adversary"]["start_y"] = y
    message = _message(data)
    assert "overlaps the adversary at the start" in message
    assert "car.start_gap" in message


def test_overlap_anywhere_in_the_start_range() -> None:
    """The car's rear reaches from −13 − 4.5 m to 2.5 m further back."""
    data = _changed("adversary.start_x", 0.0)
    data["adversary"]["start_y"] = -17.5 - 2.5 - 0.25 + 0.01
    assert "overlaps" in _message(data)
    data["adversary"]["start_y"] = -17.5 - 2.5 - 0.25 - 0.01
    scenario_from_dict(data)


def test_horizon_shorter_than_a_step() -> None:
    data = _changed("horizon", 0.2)
    assert "horizon must be at least time_step" in _message(data)


def test_destination_at_the_start() -> None:
    message = _message(_changed("adversary.destination_x", BASE["adversary"]["start_x"]))
    assert "adversary.destination_x must differ from adversary.start_x" in message


def test_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump(BASE), encoding="utf-8")
    assert load_scenario(str(file)) == load_scenario("crossing")
    file.write_text(yaml.safe_dump(_changed("car.width", 99)), encoding="utf-8")
    with pytest.raises(UsageError, match=r"mine\.yaml: car\.width must be a number from 0\.2 to 5 \(m\), got 99"):
        load_scenario(str(file))


def test_whole_numbers_are_fine() -> None:
    scenario = scenario_from_dict(_changed("horizon", 12))
    assert isinstance(scenario.horizon, float)


@pytest.mark.parametrize("content", ["a: [1, 2", "\t- x", "a: b: c"])
def test_not_yaml(tmp_path: Path, content: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(content, encoding="utf-8")
    with pytest.raises(UsageError, match=r"mine\.yaml: not valid YAML") as caught:
        load_scenario(str(file))
    assert "\n" not in str(caught.value)


def test_no_such_scenario(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"scenario absent: .* crossing"):
        load_scenario("absent")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe")
    for source in (tmp_path / "binary.yaml", tmp_path):
        with pytest.raises(UsageError, match="not a readable file"):
            load_scenario(str(source))


def test_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        load_scenario("crossing").time_step = 1.0  # type: ignore[misc]


def test_every_number_has_a_range() -> None:
    assert len(_numbers()) == 4 + 3 + 13 + 11 + 2 + 6


@pytest.mark.parametrize(
    ("period", "periods"), [(0.3, 1), (0.15, 2), (0.1, 3), (0.05, 6), (0.01, 30), (0.3 / 7, 7), (0.001, 300)]
)
def test_a_control_period_divides_the_time_step(period: float, periods: int) -> None:
    scenario = scenario_from_dict(_changed("control_period", period))
    assert scenario.control_periods == periods
    assert scenario.control_duration == pytest.approx(period, rel=1e-12)
    assert scenario_from_dict(scenario.as_dict()) == scenario


def test_by_default_the_car_decides_once_a_time_step() -> None:
    scenario = load_scenario("crossing")
    assert scenario.control_period is None
    assert (scenario.control_periods, scenario.control_duration) == (1, 0.3)
    assert "control_period" not in scenario.as_dict()


@pytest.mark.parametrize(("period", "said"), [(0.07, "0.075 s does"), (0.2, "0.3 s does"), (0.6, "0.3 s does")])
def test_another_control_period_is_refused(period: float, said: str) -> None:
    message = _message(_changed("control_period", period))
    assert message == f"some.yaml: control_period {period:g} s must divide time_step 0.3 s; {said}"


@pytest.mark.parametrize("period", ["often", 0.0, -0.1, None, True, 3.0])
def test_what_is_no_control_period_is_refused(period: object) -> None:
    assert "control_period must be a number from 0.001 to 2 (s)" in _message(_changed("control_period", period))
