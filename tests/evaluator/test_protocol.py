"""`skd protocol`: the tests of UN R152 and FMVSS 127, their limits, and what is said of them."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.extensions.protocols.evaluation import ProtocolRequest, evaluated_grid, scenario_of, series_tests
from skd_evaluator.extensions.protocols.matrices import REGULATIONS, Criterion, ProtocolMatrix
from skd_evaluator.extensions.protocols.result import RESULT, GridCell, read_protocol
from skd_sim.scenario.protocol import impact_offset, regulatory_trajectories
from skd_sim.scenario.road import road_pose
from skd_sim.scenario.scenario import load_scenario

KMH = 1.0 / 3.6
CAR = """
from pathlib import Path

class Brakes:
    control_period = 0.05
    def reset(self, scenario, rng):
        self.braking = float(Path(__file__).with_name("braking").read_text())
    def command(self, car, adversary):  # undisturbed it keeps its speed
        return -self.braking if abs(adversary.x - car.x) + abs(adversary.y - car.y) < 200.0 else 0.0
"""


@pytest.fixture(scope="module")
def graded(tmp_path_factory):
    """Return the cell of the last test of a series for a car that brakes from the start by so much, m/s²."""
    folder = tmp_path_factory.mktemp("protocol")
    (folder / "protocol_car.py").write_text(CAR)
    with pytest.MonkeyPatch.context() as patch, InProcessRunner(1, isolated=True) as runner:
        patch.syspath_prepend(folder)
        plan = Plan(load_scenario("ccrs"), controller="protocol_car:Brakes", kamikaze_count=1)
        runner.start()

        def found(series: ProtocolMatrix, braking: float) -> GridCell:
            (folder / "braking").write_text(repr(braking))
            request = ProtocolRequest(plan, 0.05, [max(one.speed for one in series.points)], 0)
            grid, _ = evaluated_grid(series, request, runner, lambda *_progress: None)
            assert series.paragraphs in grid.source
            assert not grid.cells[-1].why
            return grid.cells[-1]

        yield found


@pytest.mark.parametrize(
    "series", [pytest.param(one, id=f"{name}: {one.test}") for name, (_, tests) in REGULATIONS.items() for one in tests]
)
def test_a_car_just_passes_and_another_just_fails(graded, series):
    """They brake by almost the same; who must not brake fails by braking more, who must by braking less."""
    false_reaction = series.points[0].criterion == Criterion.BRAKING
    fails, passes = (9.0, 0.0) if false_reaction else (0.0, 9.0)
    for _ in range(15):
        middle = 0.5 * (fails + passes)
        colour = graded(series, middle).colour
        fails, passes = (middle, passes) if colour == "red" else (fails, middle)
    worse, better = graded(series, fails), graded(series, passes)
    assert (worse.colour, better.colour) == ("red", "green")
    if false_reaction:
        assert better.value < better.limit <= worse.value
        assert not better.touched
        assert (fails, passes) == pytest.approx((better.limit, better.limit), abs=0.01)
        return
    assert better.value <= better.limit < worse.value
    if series.scenario == "ccrs":
        assert worse.value - better.value < 0.5


@pytest.mark.parametrize(("paragraph", "first", "second"), [("1.2", 2.8, 1.7), ("3.2", 1.6, 1.1), ("4.2", 4.2, 3.3)])
def test_a_false_reaction_is_at_most_as_far_as_in_its_example(paragraph, first, second):
    """R152: times to collision where the car begins to steer, and where a car (1.2) or a centre is beside its path."""
    (series,) = (one for one in REGULATIONS["r152"][1] if one.paragraphs.endswith(f"2, {paragraph}"))
    scenario = scenario_of(series.scenario, series_tests(series, None)[0], series)
    car, (radius, along, across) = scenario.car, scenario.adversary.shape
    centre = regulatory_trajectories(scenario)[0].positions[0]
    corners = centre + [(i * (across or radius), j * (along or radius)) for i in (-1, 1) for j in (-1, 1)]

    def seen(s: float) -> tuple[float, float, bool]:
        x, y, heading = road_pose(scenario.road.line, s)
        cos, sin = math.cos(heading), math.sin(heading)
        ahead, left = np.array([cos, sin]), np.array([-sin, cos])
        nearest = float(((corners - (x, y)) @ ahead).min()) - car.front
        places = (corners if paragraph == "1.2" else centre[None]) - (x, y)
        return nearest / car.start_speed, float((places @ left).min()), bool((places @ left).max() < -car.half_width)

    path = np.arange(0.0, 20.0, 0.05)
    assert first - car.front / car.start_speed - 0.01 < seen(0.0)[0] <= first
    in_the_way = next(s for s in path if seen(s)[1] < car.half_width)
    assert 0.0 < next(seen(s)[0] for s in path if s > in_the_way and seen(s)[2]) <= second


def test_the_car_that_turns_right_is_as_near_as_in_its_example():
    """R152, 2.2: who slows from 26 to 20 km/h by 2 m/s² is at most 2.5 s behind it when it has left the path."""
    (series,) = (one for one in REGULATIONS["r152"][1] if one.paragraphs.endswith("2.2"))
    scenario = scenario_of(series.scenario, series_tests(series, None)[0], series)
    first, *_ = states = scenario.others[0].states(40, 0.1)
    front = -scenario.car.start_gap
    assert first.y - 0.5 * 4.023 - front == pytest.approx(4.7 * (26 - 10) * KMH, rel=1e-3)
    assert math.hypot(first.vx, first.vy) == pytest.approx(10 * KMH, rel=0.01)
    for tick, one in enumerate(states):
        time, turned = 0.1 * tick, abs(one.heading - 0.5 * math.pi)
        slowing = min(time, 6 * KMH / 2.0)
        gap = one.y - 0.5 * (4.023 * math.cos(turned) + 1.712 * math.sin(turned)) - front
        gap -= 26 * KMH * slowing - slowing**2 + 20 * KMH * (time - slowing)
        if one.x - 0.5 * (4.023 * math.sin(turned) + 1.712 * math.cos(turned)) > 0.9:
            break
    assert 0.0 < gap / (20 * KMH) <= 2.5


@pytest.mark.parametrize("protocol", REGULATIONS)
def test_every_test_is_the_one_of_its_paragraph(protocol):
    """The target's speed and impact place are those of the table, in a scenario that can be driven."""
    for series in REGULATIONS[protocol][1]:
        assert series.paragraphs
        for cell in series_tests(series, None):
            scenario = scenario_of(series.scenario, cell, series)
            assert scenario.car.start_speed == pytest.approx(cell.speed * KMH)
            assert scenario.protocol is not None
            assert scenario.protocol.speed == pytest.approx((cell.target or 0.0) * KMH)
            assert cell.limit is not None
            (track,) = regulatory_trajectories(scenario)
            assert len(track) * scenario.time_step > 4.0
            if series.headway is not None:  # from the front of the car to the rear of the target
                front = -scenario.car.start_gap - 0.5 * scenario.car.start_gap_range
                rear = track.positions[0, 1] - 0.5 * (scenario.adversary.length or 0.0)
                assert rear - front == pytest.approx(series.headway)


def test_the_tables_have_the_published_numbers():
    def limits(protocol: str, test: str) -> dict[float, float | None]:
        (series,) = (one for one in REGULATIONS[protocol][1] if one.test == test)
        return {one.speed: one.limit for one in series.points}

    first = {20: 0, 25: 0, 30: 0, 35: 20, 40: 25, 45: 30, 50: 35, 55: 40, 60: 45}
    assert limits("r152_first", "pedestrian") == first
    assert limits("r152", "pedestrian") == {**first, 35: 0, 40: 0, 42: 0, 45: 15, 50: 25, 55: 30, 60: 35}
    assert limits("r152", "bicycle") == {**first, 35: 0, 38: 0, 40: 0, 45: 25, 50: 30, 55: 35, 60: 40}
    assert limits("fmvss127", "pedestrian along the path")[65] == 0
    (between,) = (one for one in REGULATIONS["fmvss127"][1] if one.test == "between two cars")
    (cell,) = series_tests(between, None)
    scenario = scenario_of(between.scenario, cell, between)
    half = 0.5 * (scenario.adversary.width or 0.0)
    (other,) = scenario.others
    assert impact_offset(scenario, cell.place or 0.0) + half == pytest.approx(-2.25)
    assert other.way[0].x - 0.5 * (other.width or 0.0) == pytest.approx(2.25)
    assert cell.limit == pytest.approx(0.25 * 9.81)


def test_a_regulation_is_failed_by_one_test(skd_here, here):
    few = ("--speeds", "80:80:1", "--margin-limit", "0", "--workers", "1")
    done = skd_here("protocol", "fmvss127", *few, "--out", "out")
    assert done.returncode == 1, done.stderr
    found = read_protocol(here / "out")
    cells = [cell for grid in found.grids for cell in grid.cells]
    red = sum(cell.colour == "red" for cell in cells)
    assert 0 < red < len(cells) == 7
    assert f"FMVSS 127: failed: {7 - red} of 7 tests passed, {red} failed, 0 without a verdict" in done.stdout
    assert "49 CFR 571.127 S7.3" in done.stdout
    page = (here / "out" / "protocol.html").read_text()
    assert "FMVSS 127: failed" in page
    content = json.loads((here / "out" / RESULT).read_text())
    content["grids"][0]["cells"][0]["limit"] = 200.0
    (here / "out" / RESULT).write_text(json.dumps(content))
    assert skd_here("verify", "out").returncode == 1
    refused = skd_here("protocol", "r152", "--scenarios", "cpna")
    assert (refused.returncode, "--scenarios goes with ncap" in refused.stderr) == (2, True)
