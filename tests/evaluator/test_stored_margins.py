"""Margins on disk: computed anew from their ways, refused where they are not those of the file beside."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_support import one_line
from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.compare.comparison import compare
from skd_evaluator.assessment.files.results import read_result, write_assessment
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_sim.errors import UsageError
from skd_sim.options.adversary import Objective
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import Outcome
from stages import rate, with_margins

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))


PLAN = Plan(load_scenario("crossing"), safe_count=4, kamikaze_count=3, collision_runs=4, seed=5, simulations=30)


@pytest.fixture(scope="module")
def ratings() -> dict[float, Assessment]:
    with InProcessRunner(1) as runner:
        safe = safe_trajectories(PLAN, runner)
        found = {}
        for multiplier in (0.5, 1.15):
            plan = replace(PLAN, multiplier=multiplier)
            found[multiplier] = with_margins(rate(plan, [Objective.DEVIATION], safe, runner), runner, 50)
        return found


@pytest.fixture(scope="module")
def folders(ratings: dict[float, Assessment], tmp_path_factory: pytest.TempPathFactory) -> dict[float, Path]:
    found = {}
    for multiplier, rating in ratings.items():
        folder = found[multiplier] = tmp_path_factory.mktemp("margins") / f"{multiplier}"
        folder.mkdir()
        write_assessment(folder, rating)
    return found


def edited(folder: Path, to: Path, **changes: Any) -> Path:
    shutil.copytree(folder, to)
    path = to / "assessment.json"
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")) | changes), encoding="utf-8")
    return to


def test_another_margin_than_that_of_the_ways_is_refused(folders, tmp_path):
    said = read_result(folders[0.5]).figures["margin"]
    with pytest.raises(UsageError, match="not of one assessment"):
        read_result(edited(folders[0.5], tmp_path / "more", margin=said + 1e-6))
    with pytest.raises(UsageError, match="margin is nothing"):
        read_result(edited(folders[0.5], tmp_path / "none", margin=None))
    without = tmp_path / "without"
    shutil.copytree(folders[0.5], without)
    with np.load(without / "episodes.npz") as arrays:
        kept = {name: arrays[name] for name in arrays.files if not name.startswith("margin")}
    np.savez_compressed(without / "episodes.npz", **kept)
    with pytest.raises(UsageError, match="its episodes give nothing"):
        read_result(without)


def test_a_result_whose_kamikazes_were_all_aborted_has_its_margin(folders, tmp_path):
    """The margin is of no kamikaze: a car is judged where none ran."""
    found = {}
    for multiplier, folder in folders.items():
        changes = {"deviation": None}
        found[multiplier] = edited(folder, tmp_path / f"{multiplier}", **changes)
        with np.load(folder / "episodes.npz") as arrays:
            aborted = dict(arrays)
        aborted["outcome"] = np.where(aborted["mode"] == 1, int(Outcome.ABORTED), aborted["outcome"]).astype(np.int8)
        np.savez_compressed(found[multiplier] / "episodes.npz", **aborted)
    first, second = (read_result(found[multiplier]) for multiplier in (0.5, 1.15))
    assert first.curve is None
    held = compare(first, second)
    assert (held.verdict, held.judged_by) == ("safer", "margin")
    assert "deviation" not in held.differences


def test_plan_goes_by_the_margin_and_refuses_unlike_kamikazes(skd_here, here, folders, tmp_path):
    one, two = folders[0.5], edited(folders[1.15], tmp_path / "two", adversary_model="generic")
    done = skd_here("compare", str(one), str(two), "--difference", "0.3", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["figure"] == "margin"
    margins = [np.array(read_result(folder).groups["margin"]) for folder in (one, two)]
    within = (margins[1] - margins[0]).var(axis=1, ddof=1).mean()
    assert found["variance_within"] == pytest.approx(within)
    refused = skd_here("compare", str(one), str(two), "--difference", "0.3", "--figure", "deviation")
    one_line(refused, 2, "planned figures are not compared", "adversary model exact and generic")
    limited = edited(folders[1.15], tmp_path / "limited", maximum_distance=2.0)
    refused = skd_here("compare", str(one), str(limited), "--difference", "0.3", "--figure", "deviation")
    one_line(refused, 2, "planned figures are not compared", "maximum distance (m) none and 2")
