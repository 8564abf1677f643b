from __future__ import annotations

import copy
import dataclasses
import math
import operator
from pathlib import Path
from typing import Any, get_type_hints

import pytest
import yaml
from skd_sim import scenario as module
from skd_sim.errors import UsageError
from skd_sim.scenario import Scenario, load_scenario, scenario_from_dict, shipped_scenarios

SECTIONS = {"road": module.Road, "car": module.Car, "pedestrian": module.Pedestrian, "collision": module.Collision}
SECTIONS["sensor"] = module.Sensor
OPTIONAL = ("sensor", "obstacles", "control_period")
BASE = load_scenario("crossing").as_dict()


def _numbers() -> list[tuple[str, float, float]]:
    """Every numeric key with its allowed range."""
    kinds: list[tuple[str, Any]] = [("", Scenario)] + [(f"{name}.", kind) for name, kind in SECTIONS.items()]
    return [
        (f"{prefix}{name}", hint.__metadata__[0].low, hint.__metadata__[0].high)
        for prefix, kind in kinds
        for name, hint in get_type_hints(kind, include_extras=True).items()
        if hasattr(hint, "__metadata__") and hasattr(hint.__metadata__[0], "low")
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
    assert (scenario.pedestrian.speed, scenario.pedestrian.radius) == (2.5, 0.25)
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
    default = section.pop(last)
    assert operator.attrgetter(key)(scenario_from_dict(data)) == default


def test_a_file_from_before_the_dynamics_is_still_valid() -> None:
    """The keys that have come with `car.dynamics` all have defaults, and these mean the basic car on a dry road."""
    data = copy.deepcopy(BASE)
    for key in _keys(optional=True):
        *path, last = key.split(".")
        del (data[path[0]] if path else data)[last]
    scenario = scenario_from_dict(data)
    assert scenario == load_scenario("crossing")
    assert (scenario.car.dynamics, scenario.road.friction, scenario.eta_max) == ("basic", 1.0, 5.0)


@pytest.mark.parametrize("value", ["fast", "", 3, None, True])
def test_unknown_dynamics_names_those_there_are(value: Any) -> None:
    assert f"car.dynamics must be one of basic, multi_body; got {value!r}" in _message(_changed("car.dynamics", value))


def test_friction_needs_a_car_that_feels_it() -> None:
    message = _message(_changed("road.friction", 0.65))
    assert "road.friction 0.65 has no effect on car.dynamics basic" in message
    data = _changed("road.friction", 0.65)
    data["car"]["dynamics"] = "multi_body"
    assert scenario_from_dict(data).road.friction == 0.65


@pytest.mark.parametrize("key", ["colour", "car.colour", "road.colour", "pedestrian.colour", "collision.colour"])
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
    data = _changed("pedestrian.start_x", x)
    data["pedestrian"]["start_y"] = y
    message = _message(data)
    assert "overlaps the pedestrian at the start" in message
    assert "car.start_gap" in message


def test_overlap_anywhere_in_the_start_range() -> None:
    """The car's rear reaches from −13 − 4.5 m to 2.5 m further back."""
    data = _changed("pedestrian.start_x", 0.0)
    data["pedestrian"]["start_y"] = -17.5 - 2.5 - 0.25 + 0.01
    assert "overlaps" in _message(data)
    data["pedestrian"]["start_y"] = -17.5 - 2.5 - 0.25 - 0.01
    scenario_from_dict(data)


def test_horizon_shorter_than_a_step() -> None:
    data = _changed("horizon", 0.2)
    assert "horizon must be at least time_step" in _message(data)


def test_destination_before_start() -> None:
    message = _message(_changed("pedestrian.destination_x", -4.0))
    assert "pedestrian.destination_x must be greater than pedestrian.start_x" in message


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
    assert len(_numbers()) == 3 + 2 + 12 + 7 + 1 + 6


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
