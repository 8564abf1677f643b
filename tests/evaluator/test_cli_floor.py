"""`--floor` as its user meets it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from cli_support import SMALL, one_line, skd
from skd_sim.episode.episode import Outcome

FIGURES = ("floor", "floor_ci95", "floor_missing", "floor_ratio", "floor_ratio_ci95")


def unfloored(result: dict[str, Any]) -> dict[str, Any]:
    """The content of an assessment.json but for time and floors, those of each objective too."""
    others = {*FIGURES, "objectives", "seconds", "provenance"}
    kept = {name: value for name, value in result.items() if name not in others}
    return {**kept, **{name: unfloored(figures) for name, figures in result.get("objectives", {}).items()}}


def test_floor_is_refused_for_a_car_that_cannot_be_asked(here):
    mine = ("assess", *SMALL, "--knowledge", "nothing", "--controller", "my_cars:Fine", "--floor")
    one_line(skd(*mine, "--objective", "paper", cwd=here), 2, "--floor", "basic", "my_cars:Fine", "margin")
    one_line(skd("assess", *SMALL, "--floor", "--objective", "deformation", cwd=here), 2, "--floor", "Fréchet")
    external = ("assess", *SMALL, "--graph", "--controller", "external", "--floor")
    one_line(skd(*external, cwd=here), 2, "--floor", "basic", "external")
    assert not (here / "skd_results").exists()


def test_floor_is_refused_for_safe_trajectories_that_end_far_beyond_the_path(here):
    (here / "far.csv").write_text("t,x,y\n0,-3,0\n4,7,0\n")
    one_line(skd("assess", *SMALL, "--safe", "far.csv", "--floor", cwd=here), 2, "--floor", "3.5 m", "far", "5.6 m")
    assert not (here / "skd_results").exists()


def test_floor_is_reported(here):
    plain = ["assess", *SMALL, "--safe", "good.csv"]
    assert skd(*plain, "--out", "without", cwd=here).returncode == 0
    done = skd(*plain, "--floor", "--workers", "2", "--details", "--out", "with", cwd=here)
    assert done.returncode == 0, done.stderr
    assert "clairvoyant floor (m)" in done.stdout
    assert "SKD / floor" in done.stdout
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
    assert result["floor_ratio"] == pytest.approx(result["skd"] / result["floor"], rel=1e-12)
    assert result["floor_ratio"] >= 1.0
    low, high = result["floor_ratio_ci95"]
    assert low <= result["floor_ratio"] <= high
    assert result["objectives"]["deformation"]["floor"] is None


def test_sweep_reports_the_floor(here):
    done = skd("sweep", *SMALL, "--multipliers", "0.5", "1.0", "--floor", "--out", "out", cwd=here)
    assert done.returncode == 0, done.stderr
    assert max(map(len, done.stdout.splitlines()[:7])) <= 80
    rows = json.loads((here / "out" / "sweep.json").read_text())["rows"]
    assert all(row["floor_ratio"] == pytest.approx(row["skd"] / row["floor"], rel=1e-12) for row in rows)
