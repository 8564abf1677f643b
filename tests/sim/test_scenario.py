"""Scenarios of files and mappings: what is read is what was written, and a mistake is one line."""

import copy
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from skd_sim.errors import UsageError
from skd_sim.inputs.model import schema_of
from skd_sim.scenario.scenario import Scenario, changed_scenario, load_scenario, scenario_from_dict, with_oncoming_lane
from skd_sim.scenario.scenario_file import is_named, shipped_scenarios

BASE = load_scenario("crossing").as_dict()
FULL = load_scenario("cpnco").as_dict() | {
    "others": [{"kind": "van", "length": 5.0, "width": 2.0, "way": [{"time": 0.0, "x": 8.0, "y": 30.0}]}],
    "ending": {"missed": {"right_of": 30.0}},
    "control_period": 0.1,
}
FULL["road"] |= {"lanes": [{"number": -1}], "parts": [{"length": 300.0}]}
LANES = [
    {"number": -1, "direction": "oncoming"},
    {"number": 1, "width": 3.0},
    {"number": 9, "x": 0.0, "y": 30.0, "heading": 0.0},
]
LEFT_OUT = object()
CURVE = {"length": 8.0, "radius": 8.0, "turn": "right"}
PLACED = {"adversary.start_x": LEFT_OUT, "adversary.start_y": LEFT_OUT}
STANDS = {"kind": "pedestrian", "radius": 0.25, "way": [{"time": 0.0, "x": 0.5, "y": 10.0}]}


def changed(changes: dict[str, Any], base: dict[str, Any] = BASE) -> dict[str, Any]:
    """A scenario's content with other values at some places, such as car.width or others[0].kind."""
    data = copy.deepcopy(base)
    for place, value in changes.items():
        *path, last = place.replace("[", ".").replace("]", "").split(".")
        section: Any = data
        for name in path:
            section = section[int(name)] if name.isdigit() else section.setdefault(name, {})
        key: Any = int(last) if last.isdigit() else last
        if value is LEFT_OUT:
            del section[key]
        else:
            section[key] = value
    return data


def message(data: Any) -> str:
    with pytest.raises(UsageError) as caught:
        scenario_from_dict(data, "some.yaml")
    said = str(caught.value)
    assert said.startswith("some.yaml: ")
    assert "\n" not in said
    return said.removeprefix("some.yaml: ")


def places(data: Any, path: str = "") -> Iterator[str]:
    """Every place in nested data."""
    inner = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, (list, tuple)) else ()
    for key, value in inner:
        place = f"{path}[{key}]" if isinstance(key, int) else f"{path}.{key}".lstrip(".")
        yield place
        yield from places(value, place)


def listed(data: Any) -> Any:
    return json.loads(json.dumps(data))


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_load_and_round_trip(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario_from_dict(scenario.as_dict()) == scenario
    assert scenario_from_dict(yaml.safe_load(yaml.safe_dump(scenario.as_dict()))) == scenario
    assert scenario_from_dict(listed(scenario.as_dict())) == scenario
    assert copy.deepcopy(scenario) is scenario


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


@pytest.mark.parametrize(("place", "low", "high", "unit"), [
    ("time_step", 0.01, 2.0, "s"),
    ("control_period", 0.001, 2.0, "s"),
    ("car.width", 0.2, 5.0, "m"),
    ("car.deceleration", 0.1, 15.0, "m/s²"),
    ("adversary.start_x", -100.0, 100.0, "m"),
    ("others[0].way[0].time", 0.0, 600.0, "s since the start"),
    ("obstacles[1].heading", -math.pi, math.pi, "rad, of its length"),
    ("protocol.impact_places[3]", -300.0, 300.0, "% of the car's width"),
    ("ending.missed.right_of", -500.0, 500.0, "m"),
])  # fmt: skip
def test_a_number_has_a_range_and_a_unit(place: str, low: float, high: float, unit: str) -> None:
    right = f"{place} must be a number from {low:g} to {high:g} ({unit}), got "
    for value in (math.nextafter(low, -math.inf), math.nextafter(high, math.inf), math.nan, math.inf, "1", True, [1.0]):
        assert message(changed({place: value}, listed(FULL))).startswith(right)


def test_every_number_has_a_range_and_a_unit() -> None:
    nodes = [schema_of(Scenario), *schema_of(Scenario)["$defs"].values()]
    values = [value for node in nodes for value in node["properties"].values()]
    every = [one for value in values for one in (value, value.get("items", {}), *value.get("anyOf", ()))]
    numbers = [one for one in every if one.get("type") in ("number", "integer")]
    assert len(numbers) > 70
    assert all({"minimum", "maximum", "unit"} <= set(one) for one in numbers)


@given(data=st.data())
@settings(max_examples=100, deadline=None)
def test_anything_in_any_place_is_a_scenario_or_one_line(data: st.DataObject) -> None:
    base = listed(FULL)
    place = data.draw(st.sampled_from([*places(base)]))
    odd = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8), st.binary(max_size=3))
    inner = st.lists(odd, max_size=2) | st.dictionaries(st.text(max_size=3) | st.integers(), odd, max_size=2)
    content = changed({place: data.draw(odd | inner)}, base)
    try:
        scenario = scenario_from_dict(content)
    except UsageError:
        assert len(message(content)) < 600
    else:
        assert scenario_from_dict(scenario.as_dict()) == scenario


@given(place=st.sampled_from([one for one in places(listed(FULL)) if not one.endswith("]")]))
@settings(max_examples=100, deadline=None)
def test_a_slip_of_the_pen_is_named_with_what_was_meant(place: str) -> None:
    section, dot, key = place.rpartition(".")
    slip = f"{key}{key[-1]}"
    data = changed({place: LEFT_OUT, f"{section}{dot}{slip}": 1.0}, listed(FULL))
    said = message(data)
    assert said == f"unknown key {section}{dot}{slip}; did you mean {key!r}?"


MISTAKES: list[tuple[dict[str, Any], str]] = [
    # of types
    ({"name": 3}, "name must be text, got 3"),
    ({"car.meet_safe_trajectory": 1}, "car.meet_safe_trajectory must be true or false, got 1"),
    ({"obstacles": {"x": 1.0}}, "obstacles must be a list, got dict"),
    ({"sensor.beams": 20.5}, "sensor.beams must be a whole number from 2 to 4096 (beams), got 20.5"),
    ({"car.dynamics": True}, "car.dynamics must be one of basic, multi_body, got True"),
    # of keys
    ({"car.colour": 1}, "unknown key car.colour; allowed: front, rear, width, "),
    ({"adversary": LEFT_OUT}, "missing key adversary"),
    # of bodies
    ({"adversary.radius": LEFT_OUT}, "adversary: needs radius, for a disc, or both length and width, for a box"),
    ({"others": [STANDS | {"way": [{"time": 1.0, "x": 0.0, "y": 9.0}, {"time": 1.0, "x": 1.0, "y": 9.0}]}]},
     "others[0]: way[1].time must be greater than that of the point before it (1 s), got 1"),
    ({"others": [STANDS | {"way": [{"time": 0.0, "x": -3.4, "y": 0.1}]}]}, "others[0] is where the adversary starts"),
    # of times
    ({"horizon": 0.2}, "horizon must be at least time_step (0.3 s)"),
    ({"control_period": 0.6}, "control_period 0.6 s must divide time_step 0.3 s; 0.3 s does"),
    # of destinations
    ({"adversary.destination_x": LEFT_OUT}, "missing key adversary.destination_x (or a section ending with arrived)"),
    ({"ending": {"arrived": {"right_of": 2.0}}}, "adversary.destination_x and ending.arrived both say where"),
    ({"ending": {"missed": {"east_of": 2.0}}},
     "unknown key ending.missed.east_of; did you mean"),
    # of roads
    ({"road.parts": [{"length": 8.0, "radius": 8.0}]}, "road.parts[0]: has a radius and no turn; a curve needs both"),
    ({"road.parts": [CURVE | {"length": 26.0}]},
     "road.parts[0]: turns by more than half a circle; its length may be at most 25.13 m"),
    ({"road.origin": 8.5}, "road: origin says where along parts the crossing point is; there are no parts"),
    ({"road.friction": 0.65}, "road.friction 0.65 has no effect on car.dynamics basic; set car.dynamics to multi_body"),
    # of lanes
    ({"road.lanes": [{"number": 0}]}, "road: lanes[0].number 0 is that of the car's own lane"),
    ({"road.lanes": [{"number": 2}]}, "road: lanes[0].number 2 leaves out lane 1"),
    ({"road.lanes": [{"number": 5, "heading": 0.0}]},
     "road.lanes[0]: has heading; a lane elsewhere needs x, y and heading"),
    ({"road.lanes": [LANES[2] | {"direction": "oncoming"}]},
     "road.lanes[0]: has a heading, which says which way it is driven"),
    ({"road.lanes": [{"number": -1}], "road.parts": [{"length": 8.0, "radius": 5.0, "turn": "left"}]},
     "road: parts[0].radius must exceed half of lane_width and the widths of lanes on that side (5.25 m), got 5"),
    # of places on lanes
    (PLACED | {"adversary.lane": 4, "adversary.along": 1.0},
     "adversary.lane: the road has no lane 4; it has 0 (road.lanes)"),
    ({"adversary.lane": 0, "adversary.along": 1.0}, "adversary has a lane and start_x; leave one out"),
    ({"ending": {"missed": {"lane": 9}}, "road.lanes": LANES},
     "ending.missed.lane 9 is elsewhere; a region is beside and"),
    # of starts
    ({"car.start_time": 3.0}, "car.start_time and car.start_gap both say where the car starts; leave one out"),
    ({"adversary.start_x": 0.0, "adversary.start_y": -20.0}, "the car overlaps the adversary at the start"),
    # of a regulator's target
    ({"protocol": {"source": "", "speed": 1.0, "impact_places": [5, 5]}},
     "protocol: impact_places must be a list of different"),
    ({"protocol": {"source": "", "impact_places": [5], "acceleration_distance": 1.0, "headway": 1.0}},
     "protocol: acceleration_distance is for a target that starts from standing"),
    ({"protocol": {"source": "", "speed": 1.0, "impact_places": [5], "aside": 1.0}},
     "protocol: aside, change_time and change_ends say"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "said"), MISTAKES)
def test_a_mistake_is_one_line_that_says_what_would_be_right(changes: dict[Any, Any], said: str) -> None:
    data = changed({key: value for key, value in changes.items() if isinstance(key, str)})
    data |= {key: value for key, value in changes.items() if not isinstance(key, str)}
    assert said in message(data)


def test_overlap_anywhere_in_the_start_range() -> None:
    """The car's rear reaches from −13 − 4.5 m to 2.5 m further back."""
    rear = -17.5 - 2.5 - 0.25
    assert "overlaps" in message(changed({"adversary.start_x": 0.0, "adversary.start_y": rear + 0.01}))
    scenario_from_dict(changed({"adversary.start_x": 0.0, "adversary.start_y": rear - 0.01}))


@pytest.mark.parametrize(
    ("period", "periods"), [(0.3, 1), (0.15, 2), (0.1, 3), (0.05, 6), (0.01, 30), (0.3 / 7, 7), (0.001, 300)]
)
def test_a_control_period_divides_the_time_step(period: float, periods: int) -> None:
    scenario = scenario_from_dict(changed({"control_period": period}))
    assert scenario.control_periods == periods
    assert scenario.control_duration == pytest.approx(period, rel=1e-12)


def written(folder: Path, name: str, text: str) -> str:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_five_lines_make_a_scenario(tmp_path: Path) -> None:
    mine = load_scenario(
        written(tmp_path, "mine.yaml", "name: mine\ndescription: slower\nextends: cpna-75\ncar:\n  start_speed: 5.0\n")
    )
    base = load_scenario("cpna-75")
    assert mine.protocol == base.protocol
    assert base.protocol.impact_places == (75.0,)
    assert (mine.name, mine.car.start_speed, mine.car.start_gap) == ("mine", 5.0, 22.5)  # 4.5 s of its way
    assert mine.adversary == base.adversary


def test_files_build_upon_files_beside_them(tmp_path: Path) -> None:
    written(tmp_path, "one.yaml", "name: one\ndescription: d\nextends: crossing\neta_max: 3.0\nsensor: null\n")
    two = load_scenario(written(tmp_path, "two.yaml", "name: two\ndescription: d\nextends: one.yaml\nhorizon: 9.0\n"))
    assert (two.eta_max, two.horizon, two.sensor) == (3.0, 9.0, None)
    assert two.adversary == load_scenario("crossing").adversary


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("extends: a.yaml\n", "leads back to"),
        ("extends: nowhere\n", "neither a file nor a known name"),
        ("extends: 3\n", "extends must be the name or the path"),
        ("extends: cpna-33\n", "its impact places are 0, 10, 25, 50, 75, 90, 100 %"),
        ("extends: crossing-50\n", "it has no impact places"),
        ("extends: cpna\nprotocol:\n  headway: 1.0\n", "protocol: acceleration_distance .* leave one out"),
    ],
)
def test_mistakes_are_one_line_that_names_the_file(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, "a.yaml", f"name: a\ndescription: d\n{text}")
    with pytest.raises(UsageError, match=message) as caught:
        load_scenario(path)
    assert path in str(caught.value) or "cpna" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_names_with_an_impact_place() -> None:
    assert all(map(is_named, ("cpna", "cpna-25", "ccrs--25", "crossing")))
    assert not is_named("nothing-25")
    assert not is_named("./cpna.yaml")
    places = load_scenario("ccrs--25").protocol
    assert places.impact_places == (-25.0,)


def test_what_is_relative_follows_the_test_speed() -> None:
    for kmh in (30, 50, 130):
        fast = changed_scenario("ccrb", {"car.start_speed": kmh / 3.6})
        assert fast.car.start_gap == pytest.approx(kmh / 3.6)
        assert fast.car.start_gap_range == pytest.approx(0.3 * kmh / 3.6)
        assert fast.protocol.speed == fast.adversary.start_speed == pytest.approx(kmh / 3.6)
    assert changed_scenario("cut_in", {"adversary.start_y": -9.0}).adversary.start_y == -9.0


def test_an_oncoming_lane_is_free_or_occupied() -> None:
    free, occupied = load_scenario("oncoming_lane"), load_scenario("oncoming_traffic")
    assert (free.oncoming_lane, occupied.oncoming_lane) == ("free", "occupied")
    assert with_oncoming_lane(occupied, "free").others == ()
    (car,), (shipped,) = with_oncoming_lane(free, "occupied").others, occupied.others
    assert (car.kind, car.shape, car.first_heading) == (shipped.kind, shipped.shape, pytest.approx(-math.pi / 2))
    for own, theirs in zip(car.way, shipped.way, strict=True):
        assert (own.time, own.x, own.y) == pytest.approx((theirs.time, theirs.x, theirs.y))
    parked = load_scenario("parked_car")  # half on the car's own lane
    both = with_oncoming_lane(parked, "occupied")
    assert [one.stands for one in both.others] == [True, False]
    assert with_oncoming_lane(both, "free").others == parked.others
    fast = replace(free, car=replace(free.car, start_speed=60.0), horizon=60.0)
    assert min(point.y for (one,) in [with_oncoming_lane(fast, "occupied").others] for point in one.way) >= -500.0


@pytest.mark.parametrize("name", ["crossing", "oncoming_turn"])  # there the adversary drives on it
def test_a_scenario_without_an_oncoming_lane_of_its_own_has_no_state_of_it(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.oncoming_lane == ""
    assert with_oncoming_lane(scenario, "") is scenario
