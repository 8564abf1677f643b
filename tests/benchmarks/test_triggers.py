"""The three brakes of known order against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cars.triggers import MARGIN, EarlyTrigger, LateTrigger, MiddleTrigger
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.state import AdversaryState, CarState

SCENARIO = load_scenario("cut_in")
BRAKES = ((EarlyTrigger, 2.0), (MiddleTrigger, 1.2), (LateTrigger, 0.6))
NORTH = math.pi / 2.0
SPEED = 10.0  # m/s


def braked(kind: type[MiddleTrigger], gap: float, aside: float = 0.0, speed: float = 0.0, across: float = 0.0) -> bool:
    """Whether a new car at (0, 0) brakes for a car whose rear is so far (m) ahead of its front, and so far aside."""
    car = kind()
    car.reset(SCENARIO, np.random.default_rng(0))
    other = AdversaryState(aside, 2.25 + gap + 2.25, across, speed, NORTH)
    return car.command(CarState(0.0, 0.0, NORTH, SPEED), other) == -SCENARIO.car.deceleration


@pytest.mark.parametrize(("kind", "time"), BRAKES)
@pytest.mark.parametrize("speed", [0.0, 4.0])
def test_each_brakes_from_its_time_to_collision_on(kind: type[MiddleTrigger], time: float, speed: float) -> None:
    gap = time * (SPEED - speed)
    assert braked(kind, gap - 1e-6, speed=speed)
    assert not braked(kind, gap + 1e-6, speed=speed)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_only_whoever_is_on_its_strip_or_will_be_counts(side: float) -> None:
    edge = 0.9 + 0.9 + MARGIN
    assert braked(LateTrigger, 3.0, aside=side * (edge - 1e-6))
    assert not braked(LateTrigger, 3.0, aside=side * (edge + 1e-6))
    comes = -side * 3.0  # m/s, for 0.3 s until the front is there
    assert braked(LateTrigger, 3.0, aside=side * (edge + 0.9 - 1e-6), across=comes)
    assert not braked(LateTrigger, 3.0, aside=side * (edge + 0.9 + 1e-6), across=comes)
    assert not braked(LateTrigger, 3.0, speed=SPEED)  # it drives away


def test_it_brakes_until_the_strip_is_free_and_drives_on() -> None:
    car = MiddleTrigger()
    car.reset(SCENARIO, np.random.default_rng(0))
    ahead = AdversaryState(0.0, 14.0, 0.0, 0.0, NORTH)
    assert car.command(CarState(0.0, 0.0, NORTH, SPEED), ahead) == -SCENARIO.car.deceleration
    assert car.command(CarState(0.0, 0.0, NORTH, 1.0), ahead) == -SCENARIO.car.deceleration  # 9.5 s away now
    assert car.command(CarState(0.0, 0.0, NORTH, 1.0), ahead._replace(x=-5.0)) > 0.0


def test_curves_are_refused() -> None:
    with pytest.raises(UsageError, match="straight roads only"):
        LateTrigger().reset(load_scenario("right_turn"), np.random.default_rng(0))
