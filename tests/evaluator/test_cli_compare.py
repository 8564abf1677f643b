"""Curve and comparison as their user meets them."""

import json
import shutil

import pytest
from cli_support import SMALL, names, one_line
from matplotlib.image import imread
from report_support import edited

pytestmark = pytest.mark.usefixtures("pictures_drawn")

ASSESS = ["assess", *SMALL, "--objective", "deviation", "--kamikaze-count", "3", "--safe", "good.csv"]


def content(path) -> dict:
    return json.loads(path.read_text())


def test_curves_are_drawn(skd_here, here):
    done = skd_here(*ASSESS, "--multiplier", "0.5", "-p", "curve:=true", "--out", "one")
    assert done.returncode == 0, done.stderr
    first = content(here / "one" / "assessment.json")
    curve = first["vulnerability_curve"]
    assert curve["kamikazes"]["area_above"] == pytest.approx(first["deviation"], abs=1e-9)
    assert [point["trials"] for point in curve["budgets"]] == [1] * 4
    assert imread(here / "one" / "vulnerability.png").shape[1] > 600
    shutil.copytree(here / "one", here / "again")
    same = skd_here("compare", "one", "again", "--json")
    assert [row["car"] for row in json.loads(same.stdout)["rows"]] == ["basic, C = 0.5 (one)", "basic, C = 0.5 (again)"]
    assert "not compared" in skd_here("compare", "one", "again").stdout  # one φ says nothing about how φ differ


def test_cars_are_compared(skd_here, here, sweep):
    one, two = (sweep / "synthetic" / name for name in ("C_0.5", "C_1"))
    compared = skd_here("compare", one, two, "--out", "both")
    assert (compared.returncode, compared.stderr) == (0, "")
    pictures = ["price.png", "rating.png", "vulnerability.png"]
    assert names(here / "both") == ["comparison.json", "manifest.sha256", *pictures]
    rows, figures = content(here / "both" / "comparison.json")["rows"], content(one / "assessment.json")
    assert [row["car"] for row in rows] == ["basic, C = 0.5", "basic, C = 1"]
    for name in ("margin", "deviation", "adversary_model"):
        assert rows[0][name] == figures[name]
    (held,) = content(here / "both" / "comparison.json")["comparisons"]
    for name in ("margin", "deviation"):
        apart = rows[1][name] - rows[0][name]
        assert held["differences"][name]["difference"] == pytest.approx(apart)
    assert held["design"] == "paired on 2 φ and draws"
    longer = edited(two, here / "longer", scenario={**figures["scenario"], "horizon": 99.0})
    assert "different scenarios: horizon is 12.0 and 99.0" in skd_here("compare", one, longer).stderr
    one_line(skd_here("compare", one), 2, "at least two")
    one_line(skd_here("compare", one, one), 2, "the same one counts once")
    one_line(skd_here("compare", one, "nowhere"), 2, "nowhere")
    one_line(skd_here("compare", one, "both"), 2, "both")
