"""Curve and comparison as their user meets them."""

import json
import shutil

import pytest
from cli_support import SMALL, names, one_line
from matplotlib.image import imread

pytestmark = pytest.mark.usefixtures("pictures_drawn")

RANKING = [*SMALL, "--objective", "deviation", "--kamikaze-count", "3"]
ASSESS = ["assess", *RANKING, "--safe", "good.csv"]


def content(path) -> dict:
    return json.loads(path.read_text())


def test_curves_are_drawn_and_compared(skd_here, here):
    done = skd_here(*ASSESS, "--multiplier", "0.5", "-p", "curve:=true", "--out", "one")
    assert done.returncode == 0, done.stderr
    first = content(here / "one" / "assessment.json")
    curve = first["vulnerability_curve"]
    assert curve["kamikazes"]["area_above"] == pytest.approx(first["deviation"], abs=1e-9)
    assert [point["trials"] for point in curve["budgets"]] == [1] * 4
    assert imread(here / "one" / "vulnerability.png").shape[1] > 600
    assert skd_here(*ASSESS, "--multiplier", "0.9", "--out", "two").returncode == 0
    compared = skd_here("compare", "one", "two", "--out", "both")
    assert compared.returncode == 0, compared.stderr
    assert compared.stderr == ""
    assert names(here / "both") == ["comparison.json", "manifest.sha256", "price.png", "vulnerability.png"]
    rows = content(here / "both" / "comparison.json")["rows"]
    assert [row["car"] for row in rows] == ["basic, C = 0.5", "basic, C = 0.9"]
    assert [rows[0][name] for name in ("margin", "deviation")] == [first["margin"], first["deviation"]]
    assert rows[0]["adversary_model"] == "exact"
    assert "not compared" in compared.stdout  # one φ says nothing about how φ differ
    (held,) = content(here / "both" / "comparison.json")["comparisons"]
    for name in ("margin", "deviation"):
        apart = rows[1][name] - rows[0][name]
        assert held["differences"][name]["difference"] == pytest.approx(apart)
    assert held["design"] == "paired on 1 φ and draws"
    shutil.copytree(here / "one", here / "again")
    same = skd_here("compare", "one", "again", "--json")
    assert [row["car"] for row in json.loads(same.stdout)["rows"]] == ["basic, C = 0.5 (one)", "basic, C = 0.5 (again)"]


def test_what_does_not_compare_is_said_or_refused(skd_here, here):
    assert skd_here(*ASSESS, "--out", "one").returncode == 0
    assert skd_here("assess", *RANKING, "--out", "two").returncode == 0
    assert "different φ" in skd_here("compare", "one", "two", "--out", "both").stderr
    one_line(skd_here("compare", "one"), 2, "at least two")
    one_line(skd_here("compare", "one", "one"), 2, "at least two")
    one_line(skd_here("compare", "one", "nowhere"), 2, "nowhere")
    one_line(skd_here("compare", "one", "both"), 2, "both")
