"""Helpers of other folders: what checks a command line, and recorded pedestrians."""

from __future__ import annotations

import sys
from pathlib import Path

for folder in ("packaging", "adversary"):
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / folder))
