"""What a start does without: libraries that take long to import and that it does not need."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize(
    ("program", "without"),
    [
        ("import skd_evaluator.cli.results", "scipy.special scipy.optimize matplotlib vl_convert"),
        ("from skd_evaluator.cli.parser import make_parser; make_parser()", "numpy numba pydantic rich yaml"),
        ("from skd_evaluator.cli.main import main; main(['compare', '--difference', '0.5'])", "matplotlib"),
    ],
    ids=["assess", "help", "plan"],
)
def test_a_start_imports_no_library_that_it_does_not_need(program: str, without: str) -> None:
    said = f"import sys\n{program}\nprint([name for name in {without.split()} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
