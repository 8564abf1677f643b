"""How pictures are saved."""

from __future__ import annotations

import warnings
from pathlib import Path

from matplotlib.figure import Figure

DPI = 150
PAGE = 7.2
"""Width of a page between its margins, inches: a wider picture is printed smaller, with its type."""
TYPE = 8.0
"""Least size of type in a picture of that width, pt."""


def save_picture(figure: Figure, path: Path, dpi: int = DPI) -> None:
    """Save a picture; a letter that the font lacks is drawn as a box, without a word."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        figure.savefig(path, dpi=dpi)
