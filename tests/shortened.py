"""What takes long and few tests look at: pictures, and more than one harmless run of each kind.

Pictures are files of the right name; what is drawn is put together all the same. Tests that look at pictures have the
fixture `pictures_drawn`.
"""

from pathlib import Path
from typing import Any

import vl_convert
from matplotlib.figure import Figure
from skd_evaluator.assessment.stages import price

DRAW = Figure.savefig
CHART = vl_convert.vegalite_to_png
RUNS = {name: getattr(price, name) for name in ("RUNS", "GRAPH_RUNS")}
EMPTY = b"\x89PNG\r\n\x1a\n"


def _leave_undrawn(_figure: Figure, path: Path, **_options: Any) -> None:
    path.write_bytes(EMPTY)


def shorten() -> None:
    """Draw nothing, and drive one harmless run of each kind, in this process and in those that are forked from it."""
    Figure.savefig = _leave_undrawn
    vl_convert.vegalite_to_png = lambda *_spec, **_options: EMPTY
    for name in RUNS:
        setattr(price, name, len(price.KINDS))
