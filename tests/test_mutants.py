"""The tool that puts faults into modules judges them: nothing else would tell if it did not."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

JUDGE = """
import sys
from pathlib import Path
from mutants import QuickestFirst, Target, outcome_of

target = Target(
    "skd_evaluator.measure.vulnerability_curve",
    ("tests/evaluator/test_vulnerability_curve.py",),
    ("-k", "eta_max_is_a_length"),
)
source = target.path.read_text(encoding="utf-8")
changed = source.replace("if not 0.0 < eta_max < math.inf", "if not 0.0 <= eta_max < math.inf")
assert changed != source
order = QuickestFirst(Path(sys.argv[1]))
print(*(outcome_of(target, one, 100.0, order)[0] for one in (source, changed)))
"""


def test_tests_pass_without_a_fault_and_notice_one(tmp_path):
    root = Path(__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", JUDGE, str(tmp_path / "times.json")],
        cwd=root,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(root / "tests")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ""
    assert done.stdout.split() == ["survived", "killed"]
