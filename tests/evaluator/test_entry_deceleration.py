"""The deceleration that would have kept a car off somebody, against the closed form of stopping in a distance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from skd_evaluator.metrics.contact_place import deceleration_at_entry
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

CROSSING, CUT_IN = load_scenario("crossing"), load_scenario("cut_in")
STEP = CROSSING.time_step
EDGE = 0.9 + 0.25  # half of the car, and the disc


def log_of(scenario: Scenario, adversary: np.ndarray, car: np.ndarray, impact_time: float) -> EpisodeLog:
    phi = Trajectory(np.array(adversary), STEP)
    episode = EpisodeSpec(scenario, Mode.KAMIKAZE, 0, 0, safe_trajectory=phi)
    return EpisodeLog(
        episode, Outcome.COLLISION, np.array(adversary), np.insert(np.array(car), 2, 0.0, axis=1), impact_time, 5.0
    )


def crosses(speed: float, y: float, velocity: float = 2.0, drift: float = 0.0) -> EpisodeLog:
    """Somebody crosses at y + drift·t, and a car at constant speed comes from −20 m."""
    times = STEP * np.arange(9)
    adversary = np.column_stack([-3.5 + velocity * times, y + drift * times])
    car = np.column_stack([np.zeros(9), -20.0 + speed * times, np.full(9, speed)])
    return log_of(CROSSING, adversary, car, 8 * STEP - 0.01)


@pytest.mark.parametrize("drift", [0.0, 1.5, -1.5])
def test_a_car_that_brakes_so_hard_just_does_not_touch(drift: float) -> None:
    """By the closed form of uniform motion: the gap at which both are equally fast is zero."""
    log = crosses(6.0, 5.0, drift=drift)
    tick = math.ceil((3.5 - EDGE) / 2.0 / STEP)  # the first at which −3.5 + 2t ≥ −EDGE
    gap = (5.0 + drift * tick * STEP - 0.25) - (-20.0 + 6.0 * tick * STEP + 2.25)
    found = deceleration_at_entry(log)
    closing = 6.0 - drift
    time = closing / found
    assert gap - closing * time + 0.5 * found * time**2 == pytest.approx(0.0, abs=1e-9)


def test_where_it_is_not_defined_or_nothing_is_needed() -> None:
    assert math.isnan(deceleration_at_entry(crosses(6.0, -16.0)))  # beside the car when it comes into the way
    assert math.isnan(deceleration_at_entry(crosses(6.0, 5.0, velocity=0.5)))  # never in the way at a tick
    assert deceleration_at_entry(crosses(1.0, 5.0, drift=1.5)) == 0.0  # goes ahead faster than the car drives
