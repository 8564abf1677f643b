"""What a kamikaze's plan is rewarded for, and its default budget. Light: the command line imports it at every start."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

DEFAULT_SIMULATIONS: Final = 1000
"""Simulations per decision: where more come no nearer to the clairvoyant kamikaze (benchmarks/closeness.py)."""

DEFAULT_FLOOR_BUDGET: Final = 1000
"""Ticks of the car that the search for a floor may simulate in an episode, where the floor is not known exactly: on the
basic car the mean is then within 5 % of the exact floor (benchmarks/deformation_closeness.py)."""


class Objective(StrEnum):
    """What a kamikaze's plan is rewarded for."""

    PAPER = "paper"  # to collide as fast as possible, less each step's distance to φ
    DEFORMATION = "deformation"  # to collide, less the greatest distance from where φ is at the same time
    FRECHET = "frechet"  # to collide, less the discrete Fréchet distance of the whole of ψ to φ


DEFAULT_OBJECTIVES: Final = (Objective.DEFORMATION, Objective.PAPER)
"""Of an assessment, in this order: the one that ranks cars, and the paper's own."""
RANKING_OBJECTIVES: Final = (Objective.DEFORMATION, Objective.FRECHET, Objective.PAPER)
SKD_OBJECTIVES: Final = (Objective.PAPER, Objective.FRECHET, Objective.DEFORMATION)
"""Whose kamikazes the deformation and the SKD that are reported first are of: the first of these that ran."""
BOTH: Final = "both"
"""What the default objectives are called where one is chosen by name."""


def objectives_named(name: str) -> tuple[Objective, ...]:
    """Return the objectives that a name asks for: the default ones, or the one of that name."""
    return DEFAULT_OBJECTIVES if name == BOTH else (Objective(name),)
