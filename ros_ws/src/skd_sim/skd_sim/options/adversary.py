"""What the adversary knows of the car, and what its plan is rewarded for. Light: every command begins with it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import Final, cast

from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.options.registry import Registry


class AdversaryModel(StrEnum):
    """What a kamikaze knows of the car."""

    GENERIC = "generic"  # the car is taken for a basic one, with any C
    LEARNED = "learned"  # a model that was fitted to logs of the car
    EXACT = "exact"  # the law by which the car brakes, and C


def default_adversary_model(car: CarUnderTest, car_model: str) -> AdversaryModel:
    """Return the adversary model by default: learned with a car model, exact where C is known, else generic.

    Args:
        car: the car under test.
        car_model: text or path of the model that is given; empty: none.
    """
    if car_model:
        return AdversaryModel.LEARNED
    return AdversaryModel.EXACT if car.is_known else AdversaryModel.GENERIC


def check_adversary_model(adversary_model: AdversaryModel, car: CarUnderTest, *, model: bool) -> None:
    """Refuse an adversary model that this car does not allow.

    Args:
        adversary_model: what the adversary knows of the car.
        car: the car under test.
        model: whether a car model is given.

    Raises:
        UsageError: C of a car that has none, or a car model that would not be used.
    """
    if model and adversary_model != AdversaryModel.LEARNED:
        raise UsageError(
            f"a car model goes with adversary model {AdversaryModel.LEARNED}: leave out the car model, "
            f"or {adversary_model}"
        )
    if adversary_model == AdversaryModel.EXACT and not car.is_known:
        raise UsageError(
            f"adversary model {AdversaryModel.EXACT}: how car {car.controller} decides is not known to the adversary; "
            f"{AdversaryModel.LEARNED} finds out, {AdversaryModel.GENERIC} does without"
        )


DEFAULT_SIMULATIONS: Final = 1000
"""Simulations per decision: where more come no nearer to the clairvoyant kamikaze (docs/metrics.md)."""


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
    "objective",
    "skd.objectives",
    {
        "paper": "skd_adversary.crossing.objectives:PAPER",
        "deviation": "skd_adversary.crossing.kamikaze:DEVIATION",
        "frechet": "skd_adversary.crossing.objectives:FRECHET",
    },
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
