"""`skd protocol`: the tests of UN R152 and FMVSS 127, their limits, and what is said of them."""

from __future__ import annotations

import json

import pytest
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.extensions.protocols.evaluation import ProtocolRequest, evaluated_grid, scenario_of, series_tests
from skd_evaluator.extensions.protocols.regulations import REGULATIONS
from skd_evaluator.extensions.protocols.result import RESULT, read_protocol
from skd_sim.scenario.protocol import impact_offset, regulatory_trajectories
from skd_sim.scenario.scenario import load_scenario

KMH = 1.0 / 3.6
CARS = """
LIMITS = {45: 15, 50: 25, 55: 30, 60: 35}  # km/h, of R152

class Hits:
    control_period, more = 0.05, 0.0  # km/h more than the limit at the impact
    def reset(self, scenario, rng):
        self.front, self.depth = scenario.car.front, 0.5 * (scenario.adversary.length or 0.0)
        self.limit = LIMITS.get(round(3.6 * scenario.car.start_speed), 0) + self.more
    def command(self, car, adversary):
        gap = adversary.y - car.y - self.front - self.depth
        if self.limit < 0.0:  # it is to stand before
            gap, self.limit = gap - 0.3, -0.001
        least = max(0.0, self.limit) / 3.6
        braking = (car.speed ** 2 - least ** 2) / (2.0 * max(gap, 1e-3))
        return -braking if braking > 4.0 or car.speed < 0.5 else 0.0

class JustPasses(Hits):
    more = -0.4
class JustFails(Hits):
    more = 0.4

class BrakesBetween:
    control_period, braking = 0.05, 0.24
    def reset(self, scenario, rng):
        self.calls = 0
    def command(self, car, adversary):
        self.calls += 1
        return -9.81 * self.braking if 30 < self.calls < 40 and adversary.y - car.y < 200.0 else 0.0
class BrakesTooMuch(BrakesBetween):
    braking = 0.26
"""


@pytest.fixture
def colours(monkeypatch, tmp_path):
    """Return the colour of each test of a series, by its speed, of one of the cars above."""
    (tmp_path / "protocol_cars.py").write_text(CARS)
    monkeypatch.syspath_prepend(tmp_path)

    def found(protocol: str, test: str, car: str, *speeds: float) -> dict[float, str]:
        (series,) = (one for one in REGULATIONS[protocol][1] if one.test == test)
        plan = Plan(load_scenario("ccrs"), controller=f"protocol_cars:{car}", kamikaze_count=1)
        request = ProtocolRequest(plan, 0.05, speeds or None, 0)
        with InProcessRunner(1, isolated=True) as runner:
            runner.start()
            grid, _ = evaluated_grid(series, request, runner, lambda *_progress: None)
        assert not any(cell.why for cell in grid.cells), grid.cells
        assert series.paragraphs in grid.source
        return {cell.speed: cell.colour for cell in grid.cells}

    return found


STANDING = [("r152", "car, stationary"), ("r152_first", "car, stationary"), ("fmvss127", "lead vehicle, stopped")]


@pytest.mark.parametrize(("protocol", "test"), STANDING)
def test_a_car_that_just_passes_is_green_and_one_that_just_fails_red(colours, protocol, test):
    speeds = (40.0, 45.0, 60.0) if protocol != "fmvss127" else (40.0, 70.0)
    assert colours(protocol, test, "JustPasses", *speeds) == dict.fromkeys(speeds, "green")
    assert colours(protocol, test, "JustFails", *speeds) == dict.fromkeys(speeds, "red")


def test_a_car_may_not_brake_by_a_quarter_of_g_between_two_cars(colours):
    """S5.3 and S9.3 of FMVSS 127."""
    assert colours("fmvss127", "between two cars", "BrakesBetween") == {80.0: "green"}
    assert colours("fmvss127", "between two cars", "BrakesTooMuch") == {80.0: "red"}


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
            assert len(track) > 1
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
    assert limits("r152", "bicycle")[38] == 0
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
