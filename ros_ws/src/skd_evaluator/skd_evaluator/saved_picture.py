"""How pictures are saved."""

from __future__ import annotations

import warnings
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.text import Text
from skd_sim.inputs.printable import printable

DPI = 150
PAGE = 7.2
"""Width of a page between its margins, inches: a wider picture is printed smaller, with its type."""
TYPE = 8.0
"""Least size of type in a picture of that width, pt."""


def save_picture(figure: Figure, path: Path, dpi: int = DPI) -> None:
    """Save a picture; what is no letter is drawn as an escape, and one that the font lacks as a box, without a word.

    Names of cars and of φ are anybody's.
    """
    for text in figure.findobj(Text):
        if isinstance(text, Text) and (shown := printable(text.get_text())) != text.get_text():
            text.set_text(shown)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        figure.savefig(path, dpi=dpi)
