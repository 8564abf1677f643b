"""What checks a command line lies beside the tests of scripts and containers, recorded pedestrians beside the adversary's."""

from __future__ import annotations

import sys
from pathlib import Path

for folder in ("packaging", "adversary"):
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / folder))
