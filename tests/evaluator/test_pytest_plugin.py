"""The plug-in of pytest, in a pytest of its own."""

import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from common import run_program
from report_support import edited
from skd_evaluator import AssessmentError, library
from skd_evaluator.assessment.compare.gate import Check
from skd_evaluator.margin import common_trajectories
from skd_evaluator.metrics.aborted import NOT_CREDIBLE
from skd_evaluator.pytest_plugin import Assessed, Assessor

CONFTEST = """
import json, pathlib
from types import SimpleNamespace
from skd_evaluator import AssessmentError, library
from skd_evaluator.metrics.aborted import NOT_CREDIBLE

SKD = SimpleNamespace(distances=SimpleNamespace(mean=1.0))
FIGURES = json.loads(pathlib.Path("figures.json").read_text())

def assess(name, *, out, **options):  # tests/evaluator/test_library.py has the real one
    out.mkdir(parents=True)
    return SimpleNamespace(as_dict=lambda: FIGURES, for_skd=SimpleNamespace(skd=SKD))

library.assess = assess
"""
TESTS = """
import os
import pytest

def test_that_goes_elsewhere_first(tmp_path):
    os.chdir(tmp_path)

def test_a_car_is_assessed_once(skd):
    first = skd.assess("basic", seed=1)
    assert first is skd.assess(seed=1)
    assert 0.0 <= first.nominal_collision_rate <= 1.0 and first.folder.is_dir()
    with pytest.raises(AttributeError, match="no figure 'magrin'; did you mean 'margin'?"):
        first.magrin

def test_one_that_fails(skd):
    assert skd.assess(seed=1).margin > 100.0

def test_a_wrong_folder(skd):
    assert not skd.assess(seed=1).is_worse_than("nowhere")
"""
HAS_SKD = SimpleNamespace(skd=SimpleNamespace(distances=SimpleNamespace(mean=1.0)))


def test_cars_are_assessed_by_tests(tmp_path: Path, sweep: Path) -> None:
    shutil.copy(sweep / "synthetic" / "C_1" / "assessment.json", tmp_path / "figures.json")
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_cars.py").write_text(TESTS)
    words = [sys.executable, "-m", "pytest", "-p", "skd_evaluator.pytest_plugin", "-p", "no:cacheprovider", "-q"]
    variables = {"PYTEST_ADDOPTS": "", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    done = run_program(*words, "--skd-out", "kept", tmp_path, cwd=tmp_path, **variables)
    assert "2 failed, 2 passed" in done.stdout, done.stdout + done.stderr
    assert "test_cars.py:19: UsageError" in done.stdout
    assert "check_folder" not in done.stdout  # of SKD's own code nothing is shown
    assert "<Safety margin " in done.stdout  # what failed says of which car
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["0"]


class MyCar:
    """A car whose name is all that is wanted."""


@pytest.mark.filterwarnings("ignore:compared with")
def test_an_earlier_result_that_does_not_compare_lets_no_car_pass(
    tmp_path: Path, sweep: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`not mine.is_worse_than("released")` held where nothing can be said."""
    worse, better = (sweep / "synthetic" / name for name in ("C_0.5", "C_1"))
    scenario = json.loads((better / "assessment.json").read_text())["scenario"]
    edited(better, tmp_path / "longer", scenario={**scenario, "horizon": 99.0})
    mine = Assessed({}, better)
    assert not mine.is_worse_than(worse)
    with pytest.raises(AssessmentError, match=r"longer: not compared; .* scenarios: horizon is 99.0 and 12.0"):
        mine.is_worse_than(tmp_path / "longer")
    found = Check("", "less safe: margin -0.346 m", failed=True, remarks=("at most",))
    monkeypatch.setattr(common_trajectories, "check_not_worse", lambda *_results: found)
    with pytest.warns(UserWarning, match=f"compared with {worse}: at most"):
        assert mine.is_worse_than(worse) == found.text  # which a failed assert shows


def test_a_car_whose_figures_are_not_credible_passes_no_test(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their margin was held against its limit like any other."""
    figures = {"margin": 5.0, "warnings": ["harmless", f"{NOT_CREDIBLE}it counts"]}
    rating = SimpleNamespace(as_dict=lambda: figures, for_skd=HAS_SKD)
    monkeypatch.setattr(library, "assess", lambda _name, **_options: rating)
    with pytest.raises(AssessmentError, match=f"MyCar: {NOT_CREDIBLE}it counts. See {tmp_path / '0'}"):
        Assessor(tmp_path).assess(MyCar)


def test_a_car_without_margin_and_skd_passes_no_test(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`skd assess` ends with exit code 1 as well; a margin alone is enough."""
    paper = {"trials": 3, "aborted": 0}
    figures = {"margin": None, "skd": None, "discarded_by_distance": 3, "objectives": {"paper": paper}}
    figures["aborted_reasons"] = {}
    rating = SimpleNamespace(as_dict=lambda: figures)
    monkeypatch.setattr(library, "assess", lambda _name, **_options: rating)
    skd = Assessor(tmp_path)
    for _ in range(2):
        with pytest.raises(AssessmentError, match=r"MyCar: all 3 are further than.*; SKD is not defined. See"):
            skd.assess(MyCar)
    figures |= {"skd": 1.0, "margin_note": "it was not requested"}
    with pytest.raises(AssessmentError, match="margin is not known: it was not requested"):
        _ = Assessed(figures, tmp_path).margin
    figures["margin"] = 5.0
    assert Assessor(tmp_path).assess(MyCar).figures["margin"] == 5.0
