"""`--floor` as its user meets it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from cli_support import SMALL, one_line, skd
from skd_sim.episode import Outcome

FIGURES = (
    "floor", "floor_ci95", "floor_missing", "closeness", "closeness_ci95", "deformation_floor",
    "deformation_floor_ci95", "deformation_closeness", "deformation_closeness_ci95",
)  # fmt: skip


def unfloored(result: dict[str, Any]) -> dict[str, Any]:
    """The content of an assessment.json but for time and floors, those of each objective too."""
    others = {*FIGURES, "floor_of_all", "floor_of_all_ci95", "floor_gap", "floor_budget", "objectives"}
    others |= {"seconds", "provenance"}
    kept = {name: value for name, value in result.items() if name not in others}
    return {**kept, **{name: unfloored(figures) for name, figures in result.get("objectives", {}).items()}}


def test_floor_is_refused_for_a_car_that_cannot_be_asked(here):
    paper = (
        "assess",
        *SMALL,
        "--knowledge",
        "nothing",
        "--controller",
        "my_cars:Fine",
        "--floor",
        "--objective",
        "paper",
    )
    one_line(skd(*paper, cwd=here), 2, "--floor", "basic", "my_cars:Fine", "deformation")
    external = ("assess", *SMALL, "--graph", "--controller", "external", "--floor")
    one_line(skd(*external, cwd=here), 2, "--floor", "in process", "external")
    assert not (here / "skd_results").exists()


def test_floor_of_a_car_of_ones_own_is_what_a_search_finds(here):
    plain = [
        "assess",
        *SMALL,
        "--safe",
        "good.csv",
        "--knowledge",
        "nothing",
        "--controller",
        "my_cars:Fine",
        "--floor",
        "--floor-budget",
    ]
    done = skd(*plain, "60", "--out", "out", cwd=here)
    assert done.returncode == 0, done.stderr
    assert "floor found (upper bound, budget 60) (m)" in done.stdout
    result = json.loads((here / "out" / "assessment.json").read_text())
    entry = result["objectives"]["deformation"]
    assert result["objectives"]["paper"]["floor"] is None
    assert entry["floor_budget"] == 60
    assert 0.0 <= entry["floor_of_all"] <= entry["deformation"] + 1e-9
    assert skd(*plain, "240", "--out", "longer", cwd=here).returncode == 0
    longer = json.loads((here / "longer" / "assessment.json").read_text())["objectives"]["deformation"]
    assert longer["floor_of_all"] <= entry["floor_of_all"]


def test_floor_is_refused_for_safe_trajectories_that_end_far_beyond_the_path(here):
    (here / "far.csv").write_text("t,x,y\n0,-3,0\n4,7,0\n")
    one_line(skd("assess", *SMALL, "--safe", "far.csv", "--floor", cwd=here), 2, "--floor", "3.5 m", "far", "5.6 m")
    assert not (here / "skd_results").exists()


def test_floor_is_reported(here):
    plain = ["assess", *SMALL, "--safe", "good.csv"]
    assert skd(*plain, "--out", "without", cwd=here).returncode == 0
    done = skd(*plain, "--floor", "--workers", "2", "--out", "with", cwd=here)
    assert done.returncode == 0, done.stderr
    assert "clairvoyant floor (m)" in done.stdout
    assert "closeness, SKD / floor" in done.stdout
    without, result = (json.loads((here / name / "assessment.json").read_text()) for name in ("without", "with"))
    assert [without[name] for name in FIGURES] == [None] * len(FIGURES)
    assert unfloored(result) == unfloored(without)
    with np.load(here / "with" / "episodes.npz") as episodes:
        paired = (episodes["objective"] == "paper") & (episodes["outcome"] == Outcome.COLLISION)
        floors = episodes["floor"][paired]
        assert np.isnan(episodes["floor"][episodes["mode"] != 1]).all()
    assert 0.0 < floors.min() <= floors.max() <= 2.0 * result["skd"]
    assert skd(*plain, "--floor", "--workers", "1", "--out", "alone", cwd=here).returncode == 0
    with np.load(here / "alone" / "episodes.npz") as episodes:
        assert np.array_equal(episodes["floor"][paired], floors)
    assert result["floor"] == pytest.approx(floors.mean(), rel=1e-12)
    assert result["floor_missing"] == 0
    assert result["closeness"] == pytest.approx(result["skd"] / result["floor"], rel=1e-12)
    assert result["closeness"] >= 1.0
    for entry in result["objectives"].values():
        assert entry["floor_gap"] == 0.0
        assert entry["floor_budget"] is None
    assert result["deformation_closeness"] >= 1.0
    assert result["deformation_closeness"] == pytest.approx(
        result["deformation_of_successes"] / result["deformation_floor"], rel=1e-12
    )
    low, high = result["closeness_ci95"]
    assert low <= result["closeness"] <= high


def test_sweep_reports_the_floor(here):
    done = skd("sweep", *SMALL, "--multipliers", "0.5", "1.0", "--floor", "--out", "out", cwd=here)
    assert done.returncode == 0, done.stderr
    assert max(map(len, done.stdout.splitlines()[:7])) <= 80
    rows = json.loads((here / "out" / "sweep.json").read_text())["rows"]
    assert all(row["closeness"] == pytest.approx(row["skd"] / row["floor"], rel=1e-12) for row in rows)
