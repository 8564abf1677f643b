"""Assessments until an interval is narrow, and batches."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from common import PATIENCE
from scipy import stats
from skd_evaluator import Assessment, Plan, clustered_mean
from skd_evaluator.assessment.context import Context
from skd_evaluator.assessment.files.episodes_npz import write_episodes
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.kamikazes import LOOKS, run_until_width
from skd_evaluator.metrics.clustered import DISTANCES
from skd_evaluator.metrics.sample_size import nominal_confidence
from skd_sim import Trajectory, UsageError, load_scenario
from skd_sim.options.car_and_adversary import Objective
from stages import rate

PLAN = Plan(load_scenario("crossing"), multiplier=0.9, safe_count=2, kamikaze_count=2, collision_runs=3, simulations=20)


def until(wanted: float, plan: Plan = PLAN) -> tuple[Assessment, list[Trajectory]]:
    runner = InProcessRunner(1)
    found = run_until_width(Context(runner, runner, (Objective.DEVIATION,), until_width=wanted), Assessment(plan))
    return found, list(found.safe)


def test_it_is_the_assessment_of_all_phi_at_once(tmp_path) -> None:
    found, safe = until(1e-9)
    stop = found.until_width
    assert (len(safe), len(stop.looks), stop.reached) == (2 * LOOKS, LOOKS, False)
    assert [look.safe_count for look in stop.looks] == list(range(2, 2 * LOOKS + 1, 2))
    plan = replace(PLAN, safe_count=2 * LOOKS, collision_runs=2 * 2 * LOOKS)  # two runs along each, rounded up
    at_once = rate(plan, [Objective.DEVIATION], safe, InProcessRunner(1))
    contents = []
    for name, rating in (("one", found), ("other", at_once)):
        write_episodes(tmp_path / name, rating)
        contents.append((tmp_path / f"{name}.npz").read_bytes())
    assert contents[0] == contents[1]
    assert found.contact_rate.counts == at_once.contact_rate.counts
    assert sum(runs for _, runs in found.contact_rate.counts) == plan.collision_runs
    # The figures are the same; only the confidence of the intervals by φ is higher, and at each look.
    one, other = found.as_dict(), at_once.as_dict()
    for name in ("deviation", "deviation_ci95_trials", "contact_rate", "contact_rate_ci95_runs", "safe"):
        assert one[name] == other[name]
    groups = found.for_deviation.deviation.groups
    for look in stop.looks:
        expected = clustered_mean(
            groups[: look.safe_count], nominal_confidence(LOOKS), prior=DISTANCES, limits=(0.0, 5.0)
        )
        assert look.found == expected
    assert one["deviation_ci95"] == stop.looks[-1].interval
    low, high = one["deviation_ci95"]
    inner = other["deviation_ci95"]
    assert low < inner[0] < inner[1] < high
    assert json.loads(json.dumps(one["until_width"]))["reached"] is False


def test_it_stops_at_the_first_look_that_is_narrow_enough() -> None:
    found, safe = until(10.0)
    assert found.until_width.reached
    assert len(safe) == 2 * len(found.until_width.looks)
    assert 0.0 < (found.until_width.width or 0.0) <= 10.0
    assert found.plan.safe_count == len(safe)


def test_recorded_phi_come_in_an_order_by_chance_and_end(tmp_path) -> None:
    for number in range(5):
        rows = "".join(f"{t},{-3 + 1.3 * t},{0.1 * number * t}\n" for t in np.arange(0.0, 5.1, 0.3).tolist())
        (tmp_path / f"{number}.csv").write_text("t,x,y\n" + rows)
    plan = replace(PLAN, safe=str(tmp_path), kamikaze_count=1)
    found, safe = until(1e-9, plan)
    assert found.until_width.most_looks == 2  # of five φ, two at a time
    assert found.until_width.confidence == nominal_confidence(2)
    names = [one.name for one in safe]
    assert len(set(names)) == 4
    assert [one.name for one in until(1e-9, plan)[1]] == names
    assert [one.name for one in until(1e-9, replace(plan, seed=1))[1]] != names
    with pytest.raises(UsageError, match="batches of 3 φ"):
        until(0.1, replace(plan, safe_count=3))
    with pytest.raises(UsageError, match="--safe-count 2 or more"):
        until(0.1, replace(plan, safe_count=1))


@pytest.mark.parametrize(
    ("looks", "bound"), [(1, 1.960), (2, 2.178), (3, 2.289), (4, 2.361), (5, 2.413), (8, 2.512), (10, 2.555)]
)
def test_the_bounds_are_pococks(looks, bound):
    """Jennison and Turnbull, Group Sequential Methods (2000), table 2.1, α = 0.05."""
    assert stats.norm.ppf(0.5 + nominal_confidence(looks) / 2.0) == pytest.approx(bound, abs=6e-4)


def test_what_nobody_reads_is_written(here: Path, sweep: Path) -> None:
    """The tables are printed before anything is written, as pictures take longer."""
    reading, writing = os.pipe()
    os.close(reading)
    cars = [sweep / "synthetic" / name for name in ("C_0.5", "C_1")]
    words = [sys.executable, "-m", "skd_evaluator", "compare", *cars, "--no-pictures", "--out", "c"]
    done = subprocess.run(words, cwd=here, stdout=writing, stderr=subprocess.PIPE, timeout=PATIENCE, check=False)
    os.close(writing)
    assert (done.returncode, b"Traceback" in done.stderr) == (1, False)
    assert (here / "c" / "manifest.sha256").exists()
