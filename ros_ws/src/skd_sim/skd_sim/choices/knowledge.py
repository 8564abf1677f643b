"""What the adversary knows of the car, which every figure of planned kamikazes depends on. Light, as `objective`."""

from __future__ import annotations

from enum import StrEnum

from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.errors import UsageError


class Knowledge(StrEnum):
    """What a kamikaze plans with."""

    NOTHING = "nothing"  # the car is taken for a basic one, with any C
    LEARNED = "learned"  # a model that was fitted to logs of the car
    KNOWN = "known"  # the law by which the car brakes, and C
    ITSELF = "itself"  # copies of the car's own controller


def implied_knowledge(car: CarUnderTest, car_model: str) -> Knowledge:
    """Return what an episode is planned with that says nothing: its car model, C, or nothing.

    Args:
        car: the car under test.
        car_model: text of the model that the episode carries; empty: none.
    """
    if car_model:
        return Knowledge.LEARNED
    return Knowledge.KNOWN if car.is_known else Knowledge.NOTHING


def default_knowledge(car: CarUnderTest) -> Knowledge:
    """Return what a rating takes where nobody says another: C where it is known, else what logs teach."""
    return Knowledge.KNOWN if car.is_known else Knowledge.LEARNED


def check_knowledge(knowledge: Knowledge, car: CarUnderTest, *, model: bool) -> None:
    """Refuse knowledge that cannot be had.

    Args:
        knowledge: what the adversary knows of the car.
        car: the car under test.
        model: whether a car model is given.

    Raises:
        UsageError: C of a car that has none, or a car model that would not be used.
    """
    if model and knowledge != Knowledge.LEARNED:
        raise UsageError(f"a car model is knowledge {Knowledge.LEARNED}: leave out the model or knowledge {knowledge}")
    if knowledge == Knowledge.KNOWN and not car.is_known:
        raise UsageError(
            f"knowledge {Knowledge.KNOWN}: how car {car.controller} decides is not known to the adversary; "
            f"{Knowledge.LEARNED} finds out, {Knowledge.NOTHING} does without"
        )
