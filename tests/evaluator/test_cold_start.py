"""Compiled code is cached on disk and shared: two first runs at once neither disturb each other nor differ.

By a command without a planner: that takes minutes to compile on a busy machine, and is kept in no other way.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PROBE = ["probe", "--multiplier", "0.75", "--episodes", "5", "--workers", "1"]


def test_two_cold_starts_at_once_give_the_same_result(tmp_path: Path) -> None:
    environment = {**os.environ, "SKD_CACHE_DIR": str(tmp_path / "cache")}

    def start(name: str) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "skd_evaluator", *PROBE, "--out", str(tmp_path / name)]
        return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)

    for process in (start("one"), start("two")):
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors
    assert start("three").wait(timeout=300) == 0  # from what the two have left in the cache
    episodes = [(tmp_path / name / "episodes.npz").read_bytes() for name in ("one", "two", "three")]
    assert episodes[0] == episodes[1] == episodes[2]
    left = [path.name for path in (tmp_path / "cache" / "kernels").iterdir()]
    assert left
    assert all(name.endswith(".kernel") and not name.startswith(".") for name in left)
