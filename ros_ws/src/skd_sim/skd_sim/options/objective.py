"""What a kamikaze's plan is rewarded for, and its default budget. Light: the command line imports it at every start."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import Final, cast

from skd_sim.options.registry import Registry

DEFAULT_SIMULATIONS: Final = 1000
"""Simulations per decision: where more come no nearer to the clairvoyant kamikaze (docs/closeness.md)."""


class Objective(StrEnum):
    """What a kamikaze's plan is rewarded for: a member is one of SKD's own; others are registered, by their name."""

    PAPER = "paper"  # to collide as fast as possible, less each step's distance to φ
    DEVIATION = "deviation"  # to collide, less the greatest distance from where φ is at the same time
    FRECHET = "frechet"  # to collide, less the discrete Fréchet distance of the whole of ψ to φ

    def __reduce_ex__(self, protocol: object) -> tuple[type[Objective], tuple[str]]:
        """Pickle by value: a member that a package has registered is made anew where it is read."""
        return Objective, (str(self),)

    @classmethod
    def _missing_(cls, value: object) -> Objective:
        """Return the objective that an installed package has registered under a name.

        Raises:
            UsageError: none has.
        """
        OBJECTIVES.target(str(value))
        found = str.__new__(cls, value)
        found._name_, found._value_ = str(value), str(value)
        return cast(Objective, cls._value2member_map_.setdefault(value, found))


OBJECTIVES: Final = Registry(
    "objective", "skd.objectives", {str(one): f"skd_adversary.crossing.objective.{one}:OBJECTIVE" for one in Objective}
)
"""Where the model of each is made: above this package, which knows of it by name only."""


DEFAULT_OBJECTIVES: Final = (Objective.DEVIATION, Objective.PAPER)
"""Of an assessment, in this order: the one that ranks cars, and the paper's own."""
RANKING_OBJECTIVES: Final = (Objective.DEVIATION, Objective.FRECHET, Objective.PAPER)
SKD_OBJECTIVES: Final = (Objective.PAPER, Objective.FRECHET, Objective.DEVIATION)
"""Whose kamikazes the deviation and the SKD that are reported first are of: the first of these that ran."""
BOTH: Final = "both"
"""What the default objectives are called where one is chosen by name."""


def first_of(preferred: Sequence[Objective], ran: Iterable[Objective]) -> Objective:
    """Return the first of the preferred objectives that ran, else the first one that ran."""
    names = list(ran)
    return next((one for one in preferred if one in names), names[0])


def objectives_named(name: str) -> tuple[Objective, ...]:
    """Return the objectives that a name asks for: the default ones, or the one of that name."""
    return DEFAULT_OBJECTIVES if name == BOTH else (Objective(name),)
