"""The plug-in of pytest, in a pytest of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from skd_evaluator.assessing import library
from skd_evaluator.campaign.store.manifest import MANIFEST
from skd_evaluator.errors import AssessmentError
from skd_evaluator.measure.doubt import DOUBT
from skd_evaluator.pytest_plugin import Assessed, Skd

CONFTEST = """
import json, pathlib
from types import SimpleNamespace
from skd_evaluator.assessing import library
from skd_evaluator.measure.doubt import DOUBT
from skd_evaluator.errors import AssessmentError

FIGURES = json.loads(pathlib.Path("figures.json").read_text())

def assess(name, *, out, **options):  # tests/evaluator/test_library.py has the real one
    out.mkdir(parents=True)
    return SimpleNamespace(as_dict=lambda: FIGURES)

library.assess = assess
"""
TESTS = """
import pytest

def test_a_car_is_assessed_once(skd):
    first = skd.assess("basic", seed=1)
    assert first is skd.assess(seed=1)
    assert 0.0 <= first.hit_rate <= 1.0 and first.folder.is_dir()
    with pytest.raises(AttributeError, match="no figure 'magrin'"):
        first.magrin

def test_one_that_fails(skd):
    assert skd.assess(seed=1).margin > 100.0
"""


def test_cars_are_assessed_by_tests(tmp_path: Path, sweep: Path) -> None:
    shutil.copy(sweep / "synthetic" / "C_1" / "assessment.json", tmp_path / "figures.json")
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_cars.py").write_text(TESTS)
    words = ["-p", "skd_evaluator.pytest_plugin", "-p", "no:cacheprovider", "-q", "--skd-out", str(tmp_path / "kept")]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words, str(tmp_path)],
        cwd=tmp_path,
        env={**os.environ, "PYTEST_ADDOPTS": "", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "1 failed, 1 passed" in done.stdout, done.stdout + done.stderr
    assert "<basic, C = 1: somebody who strays" in done.stdout  # what failed says of which car
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["0"]


class MyCar:
    """A car whose name is all that is wanted."""


def test_a_class_is_named_by_its_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, Path]] = []
    rating = SimpleNamespace(as_dict=dict)
    monkeypatch.setattr(library, "assess", lambda name, *, out, **_options: asked.append((name, out)) or rating)
    skd = Skd(tmp_path)
    assert skd.assess(MyCar, seed=1) is skd.assess(MyCar, seed=1)
    assert skd.assess(MyCar, seed=2) is not skd.assess(MyCar, seed=1)
    assert asked == [(f"{__name__}:MyCar", tmp_path / "0"), (f"{__name__}:MyCar", tmp_path / "1")]


def test_an_earlier_result_that_does_not_compare_lets_no_car_pass(tmp_path: Path, sweep: Path) -> None:
    """`not mine.is_worse_than("released")` held where nothing can be said."""
    worse, better = (sweep / "synthetic" / name for name in ("C_0.5", "C_1"))
    shutil.copytree(better, tmp_path / "longer")
    (tmp_path / "longer" / MANIFEST).unlink()
    path = tmp_path / "longer" / "assessment.json"
    figures = json.loads(path.read_text())
    path.write_text(json.dumps({**figures, "scenario": {**figures["scenario"], "horizon": 99.0}}))
    mine = Assessed(SimpleNamespace(as_dict=dict), better)
    assert not mine.is_worse_than(worse)
    with pytest.raises(AssessmentError, match=r"^not compared; .* different encounters: horizon is 99.0 and 12.0"):
        mine.is_worse_than(tmp_path / "longer")


def test_a_car_whose_figures_are_in_doubt_passes_no_test(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their margin was held against its limit like any other."""
    rating = SimpleNamespace(as_dict=lambda: {"margin": 5.0, "warnings": ["harmless", f"{DOUBT}it counts"]})
    monkeypatch.setattr(library, "assess", lambda _name, **_options: rating)
    with pytest.raises(AssessmentError, match=f"MyCar: {DOUBT}it counts. See {tmp_path / '0'}"):
        Skd(tmp_path).assess(MyCar)
