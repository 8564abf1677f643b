"""What the adversary knows of the car: every figure of planned kamikazes depends on it. Light, as `objective`."""

from __future__ import annotations

from enum import StrEnum

from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import CarUnderTest


class Knowledge(StrEnum):
    """What a kamikaze knows of the car."""

    NOTHING = "nothing"  # the car is taken for a basic one, with any C
    LEARNED = "learned"  # a model that was fitted to logs of the car
    KNOWN = "known"  # the law by which the car brakes, and C


def implied_knowledge(car: CarUnderTest, car_model: str) -> Knowledge:
    """Return the knowledge of an episode that states none: learned with a car model, known where C is, else nothing.

    Args:
        car: the car under test.
        car_model: text of the model that the episode carries; empty: none.
    """
    if car_model:
        return Knowledge.LEARNED
    return Knowledge.KNOWN if car.is_known else Knowledge.NOTHING


def default_knowledge(car: CarUnderTest) -> Knowledge:
    """Return the knowledge of an assessment by default: known where C is, else learned."""
    return Knowledge.KNOWN if car.is_known else Knowledge.LEARNED


def check_knowledge(knowledge: Knowledge, car: CarUnderTest, *, model: bool) -> None:
    """Refuse knowledge that this car does not allow.

    Args:
        knowledge: what the adversary knows of the car.
        car: the car under test.
        model: whether a car model is given.

    Raises:
        UsageError: C of a car that has none, or a car model that would not be used.
    """
    if model and knowledge != Knowledge.LEARNED:
        raise UsageError(
            f"a car model goes with knowledge {Knowledge.LEARNED}: leave out the model, or knowledge {knowledge}"
        )
    if knowledge == Knowledge.KNOWN and not car.is_known:
        raise UsageError(
            f"knowledge {Knowledge.KNOWN}: how car {car.controller} decides is not known to the adversary; "
            f"{Knowledge.LEARNED} finds out, {Knowledge.NOTHING} does without"
        )
