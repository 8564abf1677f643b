"""Pictures at which no test looks: files of the right name, for to draw them takes longer than a small assessment.

What is drawn is put together all the same. Tests that look at pictures have the fixture `pictures_drawn`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import vl_convert
from matplotlib.figure import Figure

DRAW = Figure.savefig
CHART = vl_convert.vegalite_to_png
EMPTY = b"\x89PNG\r\n\x1a\n"


def _leave_undrawn(_figure: Figure, path: Path, **_options: Any) -> None:
    path.write_bytes(EMPTY)


def leave_undrawn() -> None:
    """Let no picture be drawn in this process, nor in those that are forked from it."""
    Figure.savefig = _leave_undrawn
    vl_convert.vegalite_to_png = lambda *_spec, **_options: EMPTY
