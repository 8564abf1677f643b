"""`skd ncap`: impact speeds, colours and the margin beside them; its file, its page, and what it refuses."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from cli_support import names, one_line, skd
from matplotlib.image import imread
from skd_evaluator.assessing.library import assess
from skd_evaluator.campaign.run.static_test import static_tests
from skd_evaluator.cli.commands import ncap
from skd_evaluator.ncap import points
from skd_evaluator.ncap.colours import colour_of
from skd_evaluator.ncap.matrices import Criterion, encounters_of, known_encounters, matrix_of
from skd_evaluator.ncap.result import RESULT, Cell, Grid, Ncap, Points, as_data, checked, ncap_of, read_ncap
from skd_evaluator.ncap.wanted import scenario_of, wanted_cells
from skd_evaluator.report.html.subjects import read_subjects
from skd_evaluator.report.ncap.layout import headline, layout_of, margin_text, reasons
from skd_evaluator.report.ncap.of_results import views_of
from skd_evaluator.report.ncap.page import details
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.encounter.known_scenarios import SCENARIOS, lineage
from skd_sim.encounter.scenario import load_scenario
from skd_sim.errors import UsageError

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
        somebody = adversary.y - car.y < self.sees  # a car that brakes for nobody is not tested
        return -self.deceleration if somebody and self.begins - 1e-9 <= time < self.ends - 1e-9 else 0.0

class Early(Brakes):
    begins, ends, deceleration = 1.5, 100.0, 6.0
class Late(Brakes):
    begins, ends, deceleration = 4.4, 100.0, 6.0
class JustPasses(Brakes):
    begins, ends, deceleration = 0.0, 0.6, 1.2
class SpeedsUp(Brakes):
    begins, ends, deceleration = 0.0, 2.0, -2.0
class Stands(Brakes):
    sees, begins, ends, deceleration = 5000.0, 0.0, 100.0, 9.0
class FailsAlone(Brakes):
    begins, ends, deceleration = 1.5, 100.0, 6.0
    def command(self, car, adversary):
        return super().command(car, adversary) if adversary.y - car.y < 500.0 else 1 / 0
class Keeps(Brakes):
    deceleration, ends, begun = 6.0, 100.0, 0
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        Keeps.begun += 1  # brakes later from test to test
        self.begins = 1.0 + 0.5 * Keeps.begun
class Marks(Brakes):
    begins, ends, deceleration, mine = 1.5, 100.0, 6.0, None
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        if Marks.mine is None:  # it brakes in the first process that drives, and knows it by a file
            Marks.mine = not os.path.exists("driven")
            open("driven", "w").close()
        self.begins = 1.5 if Marks.mine else 4.4
class Raises:
    def reset(self, scenario, rng): pass
    def command(self, car, adversary): return 1 / 0
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


def cells_of(folder) -> list[Cell]:
    return [cell for grid in read_ncap(folder).grids for cell in grid.cells]


def test_a_late_braker_is_red_where_an_early_one_is_green_at_the_speed_of_the_textbook(cars):
    """v² − 2·a·d: the front is 0.25 m before the target's way 4.65 s after the start, less what that takes."""
    for name in ("Early", "Late"):
        done = skd(
            "ncap", "--controller", f"ncap_cars:{name}", "--encounters", "cpna-50", *NONE, "--out", name, cwd=cars
        )
        assert done.returncode == 0, done.stderr
        assert "no margin: --margin-limit 0" in done.stdout
    early, late = cells_of(cars / "Early"), cells_of(cars / "Late")
    assert [cell.colour for cell in early] == ["green"] * 6
    assert not any(cell.touched for cell in early)
    for cell in late:
        speed = cell.speed * KMH
        left = speed * (4.65 - 4.4) - 0.25
        squared = speed**2 - 2.0 * 6.0 * left
        assert squared > 0.0
        assert cell.touched
        assert cell.colour == "red"
        assert (cell.value or 0.0) * KMH == pytest.approx(math.sqrt(squared), abs=0.1)


def test_a_car_that_just_passes_stands_out_by_its_margin(cars):
    """It arrives later by what it braked; by then the target is so far beside it. Less could not have been enough.

    Somebody on foot has few actions in each tick, so that a little more is needed.
    """
    done = skd("ncap", "--controller", "ncap_cars:JustPasses", "--encounters", "still.yaml", "--speeds", "30:30:1",
               *FEW, "--out", "out", cwd=cars)  # fmt: skip
    assert done.returncode == 0, done.stderr
    (cell,) = cells_of(cars / "out")
    speed, slower = 30.0 * KMH, 30.0 * KMH - 0.6 * 1.2
    lost = 0.5 * 1.2 * 0.6**2 + 0.6 * 1.2 * (4.65 - 0.25 / speed - 0.6)
    beside = 0.4 * 1.8 + 5.0 * KMH * lost / slower - 0.9 - 0.25
    assert 0.1 < beside < 0.2
    assert (cell.colour, cell.touched) == ("green", False)
    assert cell.margin is not None
    assert 0.95 * beside < cell.margin < beside + 0.1
    assert "G  0" in done.stdout
    assert "!" in done.stdout
    assert "1 of 1 test is green, 1 with less than 0.5 m of room: the least is 0.18 m, at 30 km/h, 90 %." in done.stdout
    assert 'class="green narrow"' in (cars / "out" / "ncap.html").read_text("utf-8")
    quiet = skd("ncap", "--controller", "ncap_cars:JustPasses", "--encounters", "still.yaml", "--speeds", "30:30:1",
                *FEW, "--room", "0.01", "--out", "wide", cwd=cars)  # fmt: skip
    assert "1 of 1 test is green, none with less than 0.01 m of room." in quiet.stdout


def test_a_cell_is_what_an_assessment_of_its_test_says(skd_here, here):
    """Margins and planned deformation to the last bit, for both attempt the same under the same draws."""
    done = skd_here("ncap", "--multiplier", "0.9", "--encounters", "cpfa-50", "--speeds", "30:30:1", "--planned",
                    "--kamikaze-count", "2", "--simulations", "50", "--margin-limit", "256", "--workers", "1",
                    "--out", "out")  # fmt: skip
    assert done.returncode == 0, done.stderr
    (cell,) = cells_of(here / "out")
    rating = assess(scenario="cpfa-50", multiplier=0.9, safe="regulatory", safe_count=1, objective="deformation",
                    kamikaze_count=2, simulations=50, margin_limit=256, collision_runs=1, behaviour="none",
                    workers=1, out=here / "assessed")  # fmt: skip
    assert rating.margins is not None
    assert cell.margins == tuple(rating.margins.values.tolist())
    assert cell.margin == rating.margins.mean
    assert cell.deformation == rating.as_dict()["deformation"]
    (view,) = views_of(read_subjects([here / "assessed"]), 0.5)  # so its report shows the same cell
    assert view.grid.cells == (cell,)
    assert view.said == headline(read_ncap(here / "out").grids[0], 0.5)


def test_the_equivalent_multiplier_of_a_basic_car_is_its_own(skd_here, here):
    """It is one of those that it is compared with, in the same attempts: their difference is 0 there."""
    words = ("--encounters", "cpna-50", "--speeds", "30:30:1", "--equivalent", *FEW, "--kamikaze-count", "4")
    done = skd_here("ncap", *words, "--multiplier", "1.25", "--out", here / "same")
    assert done.returncode == 0, done.stderr
    (cell,) = cells_of(here / "same")
    assert (cell.equivalent, cell.equivalent_text) == (1.25, "1.250")
    assert "C 1.25" in done.stdout
    assert "C of the basic car with the same margin" in done.stdout
    page = (here / "same" / "ncap.html").read_text(encoding="utf-8")
    assert "equivalent multiplier 1.250" in page
    skd_here("ncap", *words, "--multiplier", "0", "--out", here / "none")
    (cell,) = cells_of(here / "none")
    assert cell.equivalent is None or cell.equivalent <= 0.75
    stored = json.loads((here / "same" / RESULT).read_text(encoding="utf-8"))
    stored["grids"][0]["cells"][0]["equivalent"] = 1.4
    (here / "same" / RESULT).write_text(json.dumps(stored), encoding="utf-8")
    (here / "same" / "manifest.sha256").unlink()
    with pytest.raises(UsageError, match=r"equivalent multiplier is 1\.400, and not 1\.250"):
        read_ncap(here / "same")


@pytest.mark.usefixtures("pictures_drawn")
def test_numbers_do_not_depend_on_the_number_of_workers(skd_here, here):
    for workers in ("1", "2"):
        done = skd_here("ncap", "--encounters", "cpna-75,cptans-50", "--kamikaze-count", "2", "--margin-limit", "128",
                        "--workers", workers, "--out", workers)  # fmt: skip
        assert done.returncode == 0, done.stderr
    assert names(here / "1") == ["manifest.sha256", "ncap.csv", "ncap.html", "ncap.json", "ncap.png"]
    assert imread(here / "1" / "ncap.png").shape[1] > 300
    assert (here / "1" / "ncap.csv").read_bytes() == (here / "2" / "ncap.csv").read_bytes()
    assert (here / "1" / "ncap.html").read_bytes() == (here / "2" / "ncap.html").read_bytes()
    one, two = (json.loads((here / name / RESULT).read_text("utf-8")) for name in ("1", "2"))
    assert one.pop("provenance")["command"] != two.pop("provenance")["command"]
    assert one == two
    with (here / "1" / "ncap.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["encounter"], float(row["speed"])) for row in rows] == [
        *(("cpna-75", 10.0 * step) for step in range(1, 7)),
        ("cptans-50", 10.0),
    ]
    assert {len(row["margins"].split()) for row in rows} == {2}


def test_cells_that_cannot_be_judged_say_why(cars):
    done = skd("ncap", "--controller", "ncap_cars:SpeedsUp", "--encounters", "cpna-50,cpna-0,cpla-50",
               "--speeds", "20:35:15", *NONE, "--out", "out", cwd=cars)  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = cells_of(cars / "out")
    assert [cell.colour for cell in found] == [""] * 6
    assert "the car speeds up to 34 km/h, which is no test at 20 km/h" in done.stdout
    assert "CPNA day has no test at 35 km/h" in done.stdout
    assert "CPNA day has no impact place of 0 %" in done.stdout
    assert all(cell.touched is not None and cell.why for cell in found)
    done = skd("ncap", "--controller", "ncap_cars:Stands", "--encounters", "cpnco-50", "--speeds", "20:20:10", *NONE,
               "--out", "stands", cwd=cars)  # fmt: skip
    assert [cell.colour for cell in cells_of(cars / "stands")] == [""]
    assert "the car slows down to 0 km/h with nobody near, which is no test at 20 km/h" in done.stdout
    done = skd("ncap", "--controller", "ncap_cars:FailsAlone", "--encounters", "cpna-50", "--speeds", "20:20:10", *NONE,
               "--out", "alone", cwd=cars)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "whether the car keeps its speed with nobody near cannot be told: controller ncap_cars:Fails" in done.stdout
    (cars / "fast.yaml").write_text("name: fast\ndescription: fast\nextends: cpna-50\nprotocol:\n  speed: 2.0\n")
    done = skd("ncap", "--encounters", "fast.yaml", *NONE, "--out", "fast", cwd=cars)
    assert "the test's target has 5 km/h, this one 7.2 km/h" in done.stdout
    done = skd("ncap", "--controller", "cal", "--encounters", "cptans-50", *NONE, "--out", "cal", cwd=cars)
    assert done.returncode == 1
    assert "controller cal has learned hazards on straight roads" in done.stdout
    assert "no test could be judged" in done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--encounters", "crossing"), "scenario crossing has no section protocol"),
        (("--encounters", "cpnaa"), "cpna"),
        (("--encounters", "cpna,cpna"), "different names"),
        (("--encounters", ""), "different names"),
        (("--encounters", "cpna-33"), "impact places are 0, 10, 25"),
        (("--controller", "external"), "--controller external needs the node graph"),
        (("--controller", "carla", "--multiplier", "2"), "leave it out"),
        (("--controller", "missing:Car"), "missing"),
    ],
)
def test_what_cannot_be_asked_is_said_in_one_line(skd_here, here, words, said):
    one_line(skd_here("ncap", *words, "--out", "out"), 2, said)
    assert not (here / "out").exists()


def test_a_car_that_fails_ends_the_command(cars):
    done = skd("ncap", "--controller", "ncap_cars:Raises", "--encounters", "cpna-50", *NONE, "--out", "o", cwd=cars)
    one_line(done, 1, "ncap_cars:Raises", "ZeroDivisionError")
    assert not (cars / "o").exists()


@pytest.mark.parametrize(
    ("car", "said", "code"),
    [
        (
            "Keeps",
            r"these figures are in doubt: [5-8] of 8 episodes went otherwise",
            0,
        ),
        ("Marks", r"do not believe these figures: [5-8] of 8 episodes went otherwise", 1),
        ("Early", "", 0),
    ],
)
def test_tests_are_run_again_and_the_car_is_asked_alone(cars, car, said, code):
    """As of assessments: it may be another car in another order, or where it is not tested."""
    words = ("--encounters", "cpna-50,cpfa-50", "--speeds", "30:60:10", *NONE, "--out", f"again_{car}")
    done = skd("ncap", "--controller", f"ncap_cars:{car}", *words, cwd=cars)
    assert done.returncode == code, done.stderr
    found = read_ncap(cars / f"again_{car}")
    if not said:
        assert (found.warnings, done.stderr) == ((), "")
        return
    warning, *others = found.warnings
    assert re.match(said, warning)
    assert all("of its noise" in line for line in others)  # one that keeps something is another car by then
    assert f"skd ncap: warning: {warning}\n" in done.stderr
    assert done.stdout.startswith("Not to be believed" if code else "In doubt")
    assert warning.partition("(")[0].strip() in (cars / f"again_{car}" / "ncap.html").read_text()


def test_who_interrupts_it_gets_what_there_is(skd_here, here, monkeypatch):
    judged, begun = ncap.judged_grid, []

    def interrupted(source, *others):
        begun.append(source)
        if source == "cpfa-50":
            raise KeyboardInterrupt
        return judged(source, *others)

    monkeypatch.setattr(ncap, "judged_grid", interrupted)
    done = skd_here("ncap", "--encounters", "cpna-50,cpfa-50,cpnco-50", *NONE, "--out", "out")
    assert (done.returncode, begun) == (130, ["cpna-50", "cpfa-50"])
    assert "cpna-50 (CPNA day)" in done.stdout
    assert "interrupted; nothing was written. What is above is of 1 of 3 encounters" in done.stderr
    done = skd_here("ncap", "--encounters", "cpfa-50", *NONE, "--out", "out")
    one_line(done, 130, "interrupted; nothing was written")
    assert not (here / "out").exists()


def test_without_the_calculator_it_says_how_to_get_points(skd_here, here, monkeypatch):
    monkeypatch.setattr(points, "find_spec", lambda _name: None)
    monkeypatch.setitem(sys.modules, f"{points.PACKAGE}.common", None)  # which whoever imports it would notice
    done = skd_here("ncap", "--encounters", "cpna-50", *NONE, "--out", "out")
    assert done.returncode == 0, done.stderr
    assert "pip install 'euroncap-rating-2026>=5.4.9,<6'" in done.stdout
    assert (read_ncap(here / "out").points, "in standard range" in done.stdout) == ((), False)


def small(**changes: object) -> Ncap:
    cell = Cell(
        speed=30.0, target=5.0, place=50.0, range="standard", criterion="relative impact speed", touched=True,
        impact_speed=9.5, value=9.5, colour="brown", margin=0.5, margins=(0.25, 0.75),
    )  # fmt: skip
    cells = (Cell(**{**vars(cell), **changes}),)
    return Ncap(skd="0", car="a car", seed=0, attempts=2, margin_limit=9, room=0.5, grids=(Grid("cpna", "x", cells),))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, ""),
        ({"colour": "green"}, "a relative impact speed of 9.5 km/h is brown, not green"),
        ({"value": None}, "does not say of what"),
        ({"speed": 35.0}, "there are no colours at 35 km/h"),
        ({"margin": 0.9}, "no mean of those of its attempts"),
        ({"margins": ()}, "no mean of those of its attempts"),
        ({"margin": None}, "has no margin, which is no mean"),
        ({"margin": 0.4}, "has a margin of 0.4 m, which is no mean"),  # between the least and the greatest
        ({"margins": (0.5,)}, "has margins of 1 attempts, and there were 2"),
        ({"beyond": 2}, "says that 2 attempts have no hit"),
        ({"beyond": 3}, "says that 3 attempts have no hit"),
        ({"touched": False}, "does not go with whether the car touched"),
        ({"impact_speed": None}, "does not go with whether the car touched"),
        ({"touched": False, "impact_speed": 0.0}, "and by its impact speed 0"),
        ({"criterion": "impact speed", "value": 0.0, "colour": "green"}, "is 0 km/h, and by its impact speed 9.5"),
        ({"criterion": "speed reduction", "value": 25.0, "colour": "green"}, "and by its impact speed 20.5"),
        ({"why": "it is too fast"}, "says why it has no colour"),
        ({"colour": "blue"}, "must be one of"),
        ({"margin": -1.0}, "must be a number from 0"),
    ],
)
def test_a_file_that_contradicts_itself_is_refused(tmp_path, changes, said):
    found = small(**changes)
    (tmp_path / RESULT).write_text(json.dumps({**as_data(found), "provenance": {}}), encoding="utf-8")
    if said:
        with pytest.raises(UsageError, match=said):
            read_ncap(tmp_path)
    else:
        assert read_ncap(tmp_path) == found


def test_a_file_with_something_twice_or_points_of_nothing_is_refused():
    one = small()
    (grid,) = one.grids
    more = Points("CPNA day", standard=2.0, standard_most=1.0)
    for changes, said in (
        ({"grids": (grid, grid)}, "an encounter twice"),
        ({"grids": (replace(grid, cells=grid.cells * 2),)}, "cpna at 30 km/h: is there twice"),
        ({"points": (more,)}, "points of 'CPNA day', of which it has no grid"),
        ({"grids": (replace(grid, test="CPNA day"),), "points": (more,)}, "more points of CPNA day than there are"),
    ):
        with pytest.raises(UsageError, match=said):
            checked(replace(one, **changes), Path("ncap.json"))


def _sign_again(folder: Path) -> None:
    """Write the manifest anew, as a forger would."""
    names = sorted(path.name for path in folder.iterdir() if path.name != "manifest.sha256")
    lines = [f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}\n" for name in names]
    (folder / "manifest.sha256").write_text("".join(lines), encoding="utf-8")


def test_an_edited_file_is_refused_and_not_fine(skd_here, here):
    folder = here / "out"
    skd_here("ncap", "--encounters", "cpna-50", "--speeds", "30:50:20", "--multiplier", "0.9", *NONE, "--out", folder)
    done = skd_here("verify", folder)
    assert (done.returncode, "colours follow from impact speeds" in done.stdout) == (0, True)
    kept = (folder / RESULT).read_text(encoding="utf-8")
    data = json.loads(kept)
    cell = next(cell for grid in data["grids"] for cell in grid["cells"] if cell.get("colour") == "red")
    cell["colour"] = "green"
    (folder / RESULT).write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(UsageError, match="was changed since it was written"):
        read_ncap(folder)
    _sign_again(folder)
    done = skd_here("verify", folder)
    assert (done.returncode, "is red, not green" in done.stdout) == (1, True)
    (folder / RESULT).write_text(kept, encoding="utf-8")
    rows = (folder / "ncap.csv").read_text(encoding="utf-8")
    (folder / "ncap.csv").write_text(rows.replace(",red,", ",green,"), encoding="utf-8")
    _sign_again(folder)
    done = skd_here("verify", folder)
    assert (done.returncode, "ncap.csv: has other cells than ncap.json" in done.stdout) == (1, True)


def test_a_file_of_another_version_or_kind_is_refused(tmp_path):
    for data in ({**as_data(small()), "ncap": 2}, {}, [], {**as_data(small()), "more": 1}):
        with pytest.raises(UsageError, match="there"):
            ncap_of(data, "there")
    with pytest.raises(UsageError, match=RESULT):
        read_ncap(tmp_path)


def test_a_green_test_with_as_much_room_as_wanted_is_not_narrow():
    green = {"colour": "green", "value": 0.0, "impact_speed": 0.0, "touched": False, "margins": (0.5,)}
    for margin, narrow in ((0.5, False), (0.49, True), (None, False)):
        (cell,) = small(**green, margin=margin).grids[0].cells
        assert cell.is_narrow(0.5) == narrow
    head_on = {"colour": "green", "criterion": "speed reduction", "value": 25.0, "margin": 0.0, "margins": (0.0,)}
    for changes in ({}, head_on):  # red, and green though it hits
        (cell,) = small(**changes).grids[0].cells
        assert not cell.is_narrow(9.0)
    assert margin_text(Cell(speed=1.0, margin=5.0, margins=(5.0, 5.0), beyond=2)) == "≥5.00"


def test_a_green_test_whose_margin_nobody_measured_says_so():
    """Where no attempt has a hit, η_max stands for the margin, and the cell is not framed for that reason alone."""
    safe = {"colour": "green", "value": 0.0, "impact_speed": 0.0, "touched": False}
    (grid,) = small(**safe, margin=5.0, margins=(5.0, 5.0), beyond=2).grids
    assert headline(grid, 0.5).endswith("none with less than 0.5 m of room; of 1 because no hit was found.")
    line = "the search found no hit in any attempt: the margin stands at η_max, and was not measured"
    assert reasons(grid) == [f"30 km/h, 50 %: {line}"]
    assert "no hit was found in 2 of 2 attempts, which count as η_max" in details(grid.cells[0])
    (grid,) = small(**safe, margin=3.0, margins=(1.0, 5.0), beyond=1).grids
    assert headline(grid, 0.5).endswith("none with less than 0.5 m of room.")
    assert line not in " ".join(reasons(grid))
    assert "no hit was found in 1 of 2 attempts" in details(grid.cells[0])


def test_an_attempt_in_which_nobody_can_be_hit_is_not_hidden_in_a_mean():
    """Four hits and one attempt without any are no margin of 1 m without a word."""
    (grid,) = small(margin=1.0, margins=(0.0, 0.0, 0.0, 0.0, 5.0), beyond=1).grids
    assert margin_text(grid.cells[0]) == "≥1.00"
    assert any("in some attempts nobody could be hit within η_max" in line for line in reasons(grid))
    assert margin_text(Cell(speed=1.0, margin=1.0, margins=(0.0, 2.0), beyond=1, converged=False)) == "1.00"
    (grid,) = small(margin=0.5, margins=(0.5,), beyond=0).grids
    assert not any("nobody could be hit" in line for line in reasons(grid))


def test_what_is_said_of_a_grid():
    unsure = Cell(speed=30.0, place=50.0, colour="green", margin=2.0, margins=(2.0,), converged=False)
    refused = [
        Cell(speed=speed, place=50.0, why="it is too fast", margin_why="it is too fast") for speed in (70.0, 80.0)
    ]
    grid = Grid("cpna", "", (unsure, *refused))
    assert headline(grid, 0.5) == "1 of 1 test is green, none with less than 0.5 m of room."
    assert reasons(grid) == [
        "30 km/h, 50 %: the search for the margin has not converged, which is an upper bound: try a greater "
        "--margin-limit",
        "2 cells, from 70 km/h, 50 %: it is too fast",
    ]
    assert headline(Grid("cpna", "", tuple(refused)), 0.5) == "No test has a colour."
    assert headline(small(margin=None, margins=()).grids[0], 0.5) == "0 of 1 test is green."


def test_columns_are_places_or_the_speeds_of_targets():
    head_on = matrix_of("ccfhos")
    assert head_on is not None
    cells = tuple(Cell(speed=one.speed, target=one.target, place=one.place) for one in head_on.points)
    layout = layout_of(Grid("ccfhos", "", cells))
    assert layout.columns == ("25 %", "50 %", "75 %", "100 %")
    assert [row.label for row in layout.rows][:4] == ["30 (50)", "40 (50)", "50 (50)", "60 (70)"]
    crossing = matrix_of("cccscp")
    assert crossing is not None
    cells = tuple(Cell(speed=one.speed, target=one.target, place=one.place) for one in crossing.points)
    layout = layout_of(Grid("cccscp", "", cells))
    assert layout.columns == tuple(f"{speed} km/h" for speed in range(20, 90, 10))
    assert [sum(cell is not None for cell in row.cells) for row in layout.rows] == [7, 7, 5, 5, 5, 2, 2]


def test_every_test_of_the_matrices_can_be_had():
    """Each place and target speed that the calculator asks for stands in the encounter's own file, or is put there.

    An unbraked car runs into the target, or to be green would say nothing; of all 778 tests the command itself says so,
    with --multiplier 0.
    """
    assert set(known_encounters()) == {name for name in SCENARIOS.own if load_scenario(name).protocol is not None}
    assert encounters_of("CPTAfs & CPTAns") == ["cptafs", "cptans"]
    for name in known_encounters():
        matrix, cells = wanted_cells(name, None)
        assert matrix is not None
        assert [cell.point for cell in cells] == list(matrix.points)
        for cell in cells[-1:]:
            scenario = scenario_of(name, cell, matrix)
            assert scenario.protocol is not None
            assert scenario.protocol.speed == pytest.approx((cell.target or 0.0) * KMH)
            assert scenario.car.start_speed == pytest.approx(cell.speed * KMH)
            (one,) = static_tests(scenario, CarUnderTest("basic", 0.0))
            assert (one.touched, one.impact_speed) == (True, pytest.approx(cell.speed * KMH))


def test_a_file_belongs_to_the_matrix_of_what_it_builds_upon(tmp_path):
    (tmp_path / "one.yaml").write_text("name: one\nextends: cpfa-50\n")
    (tmp_path / "two.yaml").write_text("name: two\nextends: one.yaml\n")
    path = str(tmp_path / "two.yaml")
    assert lineage(path) == [path, str(tmp_path / "one.yaml"), "cpfa-50", "cpfa", "cpna", "crossing"]
    assert lineage("crossing") == ["crossing"]


@pytest.mark.parametrize(("speed", "colours"), [(20, "gr"), (30, "gbr"), (40, "gobr"), (50, "gyobr"), (60, "gyobr")])
def test_colours_change_every_ten_kmh_down_to_green(speed, colours):
    """What docs/ncap.md says of 2026: the faster the test, the more a lower impact speed is worth."""
    values = [0.0, *(10.0 * step + 5.0 for step in range(6))]
    found = [colour_of(Criterion.RELATIVE, float(speed), value)[0] for value in values]
    assert "".join(dict.fromkeys(found)) == colours
    assert colour_of(Criterion.IMPACT, float(speed), 0.1) == "red"
    assert [colour_of(Criterion.REDUCTION, 50.0, value) for value in (10.0, 20.0, 30.0, 30.1)] == [
        "red", "orange", "green", "red",
    ]  # fmt: skip
