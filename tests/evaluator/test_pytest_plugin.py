"""The plug-in of pytest, in a pytest of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

CAR = """
class Asleep:
    def reset(self, scenario, rng): ...
    def command(self, car, adversary): return 0.0
"""
SMALL = (
    "safe_count=1, kamikaze_count=1, collision_runs=2, simulations=5, knowledge='nothing', margin_limit=0, "
    "behaviour='none', workers=1"
)
TESTS = f"""
import pytest
from my_cars import Asleep

SMALL = dict({SMALL})

def test_who_is_asleep_hits(skd):
    assert skd.assess(Asleep, **SMALL).hit_rate == 1.0

def test_it_is_assessed_once(skd):
    first = skd.assess(Asleep, **SMALL)
    assert first is skd.assess("my_cars:Asleep", **SMALL)
    assert (first.folder / "assessment.json").exists()
    with pytest.raises(AttributeError, match="no figure 'magrin'"):
        first.magrin

def test_one_that_fails(skd):
    assert skd.assess(Asleep, **SMALL).hit_rate < 0.5
"""


def test_cars_are_assessed_by_tests(tmp_path: Path) -> None:
    (tmp_path / "my_cars.py").write_text(CAR)
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
    assert "1 failed, 2 passed" in done.stdout, done.stdout + done.stderr
    assert "<my_cars:Asleep: the margin is not known" in done.stdout  # what failed says of which car
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["0"]
