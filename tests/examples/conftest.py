"""Examples and benchmarks are files beside the packages, not packages that are installed."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

sys.path[:0] = [str(ROOT / "examples" / name) for name in ("commonroad_planner", "idm", "sub_hunt", "sumo")]
sys.path.insert(0, str(ROOT / "benchmarks"))
