"""The benchmark runs, and its figures are not absurd."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

BENCHMARK = Path(__file__).resolve().parents[2] / "benchmarks" / "rosless_roundtrip.py"


def test_the_benchmark_gives_figures() -> None:
    result = subprocess.run(
        [sys.executable, str(BENCHMARK), "--laps", "200", "--json"], capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0, result.stderr
    figures = json.loads(result.stdout)
    assert len(figures) == 2
    for row in figures.values():
        assert 10 < row["min_us"] <= row["median_us"] <= row["p99_us"]
        assert row["node_start_s"] > 0.01
