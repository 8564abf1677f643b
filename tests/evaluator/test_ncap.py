"""Euro NCAP: the command, and its result in assessments."""

import json
import re
from dataclasses import replace

import pytest
from cli_support import names, one_line, skd
from skd_evaluator.assessment.files.verification import Verified
from skd_evaluator.extensions.protocols import evaluation
from skd_evaluator.extensions.protocols.evaluation import requested_tests, scenario_of
from skd_evaluator.extensions.protocols.matrices import known_scenarios, scenarios_of
from skd_evaluator.extensions.protocols.page import margin_text, views_of
from skd_evaluator.extensions.protocols.result import (
    RESULT,
    Grid,
    GridCell,
    ProtocolResult,
    as_data,
    read_protocol,
    with_regulator,
)
from skd_evaluator.library import assess
from skd_evaluator.report.html.subjects import read_subjects
from skd_sim import UsageError, load_scenario
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.scenario.scenario_file import SCENARIOS
from static_support import static_tests

NCAP = ("protocol", "ncap")
KMH = 1.0 / 3.6
CARS = """
import os

class Brakes:
    control_period, sees = 0.05, 500.0
    def reset(self, scenario, rng):
        self.calls = 0
    def command(self, car, adversary):
        self.calls += 1
        time = 0.05 * (self.calls - 1)
        near = adversary.y - car.y < self.sees  # a car that brakes where there is no road user is not tested
        return -self.deceleration if near and self.begins - 1e-9 <= time < self.ends - 1e-9 else 0.0

class Early(Brakes):
    begins, ends, deceleration = 1.5, 100.0, 6.0
class JustPasses(Brakes):
    begins, ends, deceleration = 0.0, 0.6, 1.2
class SpeedsUp(Brakes):
    begins, ends, deceleration = 0.0, 2.0, -2.0
class Stands(Brakes):
    sees, begins, ends, deceleration = 5000.0, 0.0, 100.0, 9.0
class Keeps(Brakes):
    deceleration, ends, begun = 6.0, 100.0, 0
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        Keeps.begun += 1  # brakes later from test to test
        self.begins = 1.0 + 0.5 * Keeps.begun
"""
STILL = """name: still
description: As cpna-90, without any noise of the car.
extends: cpna-90
car:
  start_time: 4.65
  start_time_range: 0.0
  speed_noise: 0.0
  acceleration_noise: 0.0
"""
FEW = ("--workers", "1", "--kamikaze-count", "1", "--margin-limit", "128")
NONE = ("--workers", "1", "--margin-limit", "0")


@pytest.fixture
def cars(here):
    (here / "ncap_cars.py").write_text(CARS)
    (here / "still.yaml").write_text(STILL)
    return here


def cells_of(folder) -> list[GridCell]:
    return [cell for grid in read_protocol(folder).grids for cell in grid.cells]


def test_a_car_that_just_passes_stands_out_by_its_margin(cars):
    """It arrives later by what it braked; by then the target is so far beside it. Less could not have been enough.

    A pedestrian has few actions in each tick, so that a little more is needed.
    """
    done = skd(*NCAP, "--controller", "ncap_cars:JustPasses", "--scenarios", "still.yaml", "--speeds", "30:30:1",
               *FEW, "--out", "out", cwd=cars)  # fmt: skip
    assert done.returncode == 0, done.stderr
    (cell,) = cells_of(cars / "out")
    speed, slower = 30.0 * KMH, 30.0 * KMH - 0.6 * 1.2
    lost = 0.5 * 1.2 * 0.6**2 + 0.6 * 1.2 * (4.65 - 0.25 / speed - 0.6)
    beside = 0.4 * 1.8 + 5.0 * KMH * lost / slower - 0.9 - 0.25
    assert 0.1 < beside < 0.2
    assert (cell.colour, cell.touched) == ("green", False)
    assert 0.95 * beside < cell.margin < beside + 0.1
    assert cell.braking_ttc == pytest.approx(4.65, abs=1e-6)  # at once, with the front that far from the target
    least = r"the least is ≤?0\.18 m, at 30 km/h, 90 %\."  # the search may need more candidates than it is given
    assert re.search(rf"1 of 1 test is green, 1 with a margin below 0\.5 m: {least}", done.stdout)
    assert 'class="green narrow"' in (cars / "out" / "protocol.html").read_text("utf-8")


def test_a_cell_is_what_an_assessment_of_its_test_says(skd_here, here):
    """Margins to the last bit, for both try the same under the same draws."""
    done = skd_here(*NCAP, "--multiplier", "0.9", "--scenarios", "cpfa-50", "--speeds", "30:30:1",
                    "--kamikaze-count", "2", "--margin-limit", "256", "--workers", "1", "--out", "out")  # fmt: skip
    assert done.returncode == 0, done.stderr
    (cell,) = cells_of(here / "out")
    rating = assess(scenario="cpfa-50", multiplier=0.9, safe="regulatory", safe_count=1, objective="deviation",
                    kamikaze_count=2, simulations=50, margin_limit=256, collision_runs=1, behaviour="none",
                    workers=1, out=here / "assessed")  # fmt: skip
    assert cell.margins == tuple(rating.margins.values.tolist())
    assert cell.margin == rating.margins.mean
    (view,) = views_of(read_subjects([here / "assessed"]))  # so its report shows the same cell
    assert view.grid.cells == (cell,)


def test_numbers_do_not_depend_on_the_number_of_workers(skd_here, here):
    for workers in ("1", "2"):
        done = skd_here(*NCAP, "--scenarios", "cpna-75,cptans-50", "--kamikaze-count", "2", "--margin-limit", "128",
                        "--workers", workers, "--out", workers)  # fmt: skip
        assert done.returncode == 0, done.stderr
    assert names(here / "1") == ["manifest.sha256", "protocol.html", "protocol.json"]
    assert (here / "1" / "protocol.html").read_bytes() == (here / "2" / "protocol.html").read_bytes()
    one, two = (json.loads((here / name / RESULT).read_text("utf-8")) for name in ("1", "2"))
    assert one.pop("provenance")["command"] != two.pop("provenance")["command"]
    assert one == two
    first, second = read_protocol(here / "1").grids
    assert [cell.speed for cell in first.cells] == [10.0 * step for step in range(1, 7)]
    assert [cell.speed for cell in second.cells] == [10.0]
    assert {len(cell.margins) for cell in (*first.cells, *second.cells)} == {2}


def test_cells_that_cannot_be_judged_say_why(cars):
    done = skd(*NCAP, "--controller", "ncap_cars:SpeedsUp", "--scenarios", "cpna-50,cpna-0,cpla-50",
               "--speeds", "20:35:15", *NONE, "--out", "out", cwd=cars)  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = cells_of(cars / "out")
    assert [cell.colour for cell in found] == [""] * 6
    assert "no margin: --margin-limit 0" in done.stdout
    assert "the car speeds up to 34 km/h, which is no test at 20 km/h" in done.stdout
    assert "CPNA day has no test at 35 km/h" in done.stdout
    assert "CPNA day has no impact place of 0 %" in done.stdout
    assert all(cell.touched is not None and cell.why for cell in found)
    done = skd(*NCAP, "--controller", "ncap_cars:Stands", "--scenarios", "cpnco-50", "--speeds", "20:20:10", *NONE,
               "--out", "stands", cwd=cars)  # fmt: skip
    assert [cell.colour for cell in cells_of(cars / "stands")] == [""]
    assert "the car slows down to 0 km/h undisturbed, which is no test at 20 km/h" in done.stdout
    (cars / "fast.yaml").write_text("name: fast\ndescription: fast\nextends: cpna-50\nprotocol:\n  speed: 2.0\n")
    done = skd(*NCAP, "--scenarios", "fast.yaml", *NONE, "--out", "fast", cwd=cars)
    assert "the test's target has 5 km/h, this one 7.2 km/h" in done.stdout
    done = skd(*NCAP, "--controller", "cal", "--scenarios", "cptans-50", *NONE, "--out", "cal", cwd=cars)
    assert done.returncode == 1
    assert "controller cal has learned hazards on straight roads" in done.stdout
    assert "no test could be evaluated" in done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--scenarios", "crossing"), "scenario crossing has no section protocol"),
        (("--scenarios", "cpnaa"), "cpna"),
        (("--scenarios", "cpna,cpna"), "different names"),
        (("--scenarios", ""), "different names"),
        (("--scenarios", "cpna-33"), "impact places are 0, 10, 25"),
        (("--controller", "external"), "--controller external needs the node graph"),
        (("--controller", "carla", "--multiplier", "2"), "leave it out"),
        (("--controller", "missing:Car"), "missing"),
    ],
)
def test_what_cannot_be_asked_is_said_in_one_line(skd_here, here, words, said):
    one_line(skd_here(*NCAP, *words, "--out", "out"), 2, said)
    assert not (here / "out").exists()


def test_a_car_that_does_not_repeat_itself_is_not_credible(cars):
    words = ("--scenarios", "cpna-50,cpfa-50", "--speeds", "30:60:10", *NONE, "--out")
    done = skd(*NCAP, "--controller", "ncap_cars:Keeps", *words, "keeps", cwd=cars)
    assert done.returncode == 1, done.stderr
    (warning,) = read_protocol(cars / "keeps").warnings
    assert re.match("not credible: [5-8] of 8 episodes ended differently", warning)
    assert f"skd protocol: warning: {warning}\n" in done.stderr
    assert done.stdout.startswith("Not credible")
    assert warning.partition("(")[0].strip() in (cars / "keeps" / "protocol.html").read_text()
    done = skd(*NCAP, "--controller", "ncap_cars:Early", *words, "early", cwd=cars)
    assert (done.returncode, done.stderr, read_protocol(cars / "early").warnings) == (0, "", ())


def test_who_interrupts_it_gets_what_there_is(skd_here, here, monkeypatch):
    judged, begun = evaluation.evaluated_grid, []

    def interrupted(source, *others):
        begun.append(source)
        if source == "cpfa-50":
            raise KeyboardInterrupt
        return judged(source, *others)

    monkeypatch.setattr(evaluation, "evaluated_grid", interrupted)
    done = skd_here(*NCAP, "--scenarios", "cpna-50,cpfa-50,cpnco-50", *NONE, "--out", "out")
    assert (done.returncode, begun) == (130, ["cpna-50", "cpfa-50"])
    assert "cpna-50 (CPNA day)" in done.stdout
    assert "interrupted; nothing was written. What is above is of 1 of 3 scenarios" in done.stderr
    assert not (here / "out").exists()


CELL = GridCell(
    speed=30.0, target=5.0, place=50.0, range="standard", criterion="relative impact speed", touched=True,
    impact_speed=9.5, value=9.5, colour="brown", margin=0.5, margins=(0.25, 0.75),
)  # fmt: skip
GREEN = replace(CELL, touched=False, impact_speed=0.0, value=0.0, colour="green")


def of(*cells: GridCell) -> ProtocolResult:
    return ProtocolResult(skd="0", car="a car", seed=0, trials=2, margin_limit=9, grids=(Grid("cpna", "x", cells),))


def store(folder, data: object) -> None:
    (folder / RESULT).write_text(json.dumps(data), encoding="utf-8")


@pytest.mark.parametrize("data", [{**as_data(of(CELL)), "version": 2}, {}, [], {**as_data(of(CELL)), "more": 1}])
def test_a_file_of_another_version_or_kind_is_refused(tmp_path, data):
    store(tmp_path, data)
    with pytest.raises(UsageError, match=RESULT):
        read_protocol(tmp_path)


@pytest.mark.parametrize(
    ("cell", "narrow"),
    [
        (replace(GREEN, margin=0.5), False),
        (replace(GREEN, margin=0.49), True),
        (replace(GREEN, margin=None), False),
        (replace(CELL, margin=0.0), False),  # brown
        (replace(GREEN, criterion="speed reduction", value=25.0, impact_speed=20.0, margin=0.0), False),
    ],
)
def test_a_green_test_without_a_hit_is_narrow_below_the_room(cell, narrow):
    assert cell.is_narrow(0.5) == narrow


def test_a_margin_that_is_a_bound_says_so(tmp_path):
    """A search that has not converged may have missed a hit, so that it gives no least value."""
    lower, upper = replace(CELL, margin=3.0, margins=(1.0, 5.0), beyond=1), replace(CELL, converged=False)
    assert [margin_text(cell) for cell in (CELL, lower, upper, replace(upper, beyond=1))] == [
        "0.50", "≥3.00", "≤0.50", "≤0.50",
    ]  # fmt: skip
    store(tmp_path, as_data(of(CELL, lower, upper)))
    verified = with_regulator(Verified(tmp_path, None))
    assert not verified.problems
    assert [line.partition(":")[0] for line in verified.remarks[:2]] == [
        "1 of 3 margins are lower bounds", "1 of 3 margins are upper bounds",
    ]  # fmt: skip


def test_every_test_of_the_matrices_can_be_had():
    """Each place and target speed that the calculator asks for stands in the scenario's own file, or is put there.

    An unbraked car runs into the target, or to be green would say nothing; of all 778 tests the command itself says so,
    with --multiplier 0.
    """
    assert set(known_scenarios()) == {name for name in SCENARIOS.own if load_scenario(name).protocol is not None}
    assert scenarios_of("CPTAfs & CPTAns") == ["cptafs", "cptans"]
    for name in known_scenarios():
        matrix, cells = requested_tests(name, None)
        assert cells == [GridCell.of_point(point) for point in matrix.points]
        for cell in cells[-1:]:
            scenario = scenario_of(name, cell, matrix)
            assert scenario.protocol.speed == pytest.approx((cell.target or 0.0) * KMH)
            assert scenario.car.start_speed == pytest.approx(cell.speed * KMH)
            (one,) = static_tests(scenario, CarUnderTest("basic", 0.0))
            assert (one.touched, one.impact_speed) == (True, pytest.approx(cell.speed * KMH))
