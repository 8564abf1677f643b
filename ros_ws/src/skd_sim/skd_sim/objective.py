"""What a kamikaze's plan is rewarded for, and its default budget. Light: the command line imports it at every start."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

DEFAULT_SIMULATIONS: Final = 500
"""Simulations per decision: where the closeness to the clairvoyant kamikaze stops to grow (benchmarks/closeness.py)."""


class Objective(StrEnum):
    """What a kamikaze's plan is rewarded for."""

    PAPER = "paper"  # to collide as fast as possible, less each step's distance to φ
    FRECHET = "frechet"  # to collide, less the discrete Fréchet distance of the whole of ψ to φ
