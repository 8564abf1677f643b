"""The deceleration that would have kept a car off somebody, against the closed form of stopping in a distance."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from skd_evaluator.metrics.contact_place import deceleration_at_entry
from skd_evaluator.metrics.measures import measure_pairs, pair_of
from skd_sim.scenario.road import Part, Road, road_pose
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


def test_along_a_curve_it_is_what_it_is_along_a_straight_road() -> None:
    road = Road(3.5, parts=(Part(60.0), Part(8.0 * math.pi, 16.0, "left"), Part(60.0)), origin=60.0)
    straight = crosses(6.0, 5.0)
    places = [road_pose(road.line, along) for along in straight.adversary[:, 1]]
    across = straight.adversary[:, 0]
    adversary = [
        (x + right * math.sin(heading), y - right * math.cos(heading))
        for (x, y, heading), right in zip(places, across, strict=True)
    ]
    car = [(*road_pose(road.line, along)[:2], speed) for _, along, _, speed in straight.car]
    bent = log_of(replace(CROSSING, road=road), np.array(adversary), np.array(car), straight.impact_time)
    assert deceleration_at_entry(bent) == pytest.approx(deceleration_at_entry(straight), rel=0.02)


def test_every_assessment_has_it() -> None:
    logs = [crosses(6.0, 5.0), crosses(6.0, -16.0), crosses(6.0, 6.0)]
    assert logs[0].episode.safe_trajectory is not None
    measured = measure_pairs([(logs[0].episode.safe_trajectory, list(map(pair_of, logs)))])[
        "required_deceleration_at_entry"
    ]
    found = measured.figures([np.arange(3)], 0.95)
    assert (found["unit"], found["pairs"], found["undefined"], found["error"]) == ("m/s²", 2, 1, None)
    assert found["mean"] == pytest.approx((deceleration_at_entry(logs[0]) + deceleration_at_entry(logs[2])) / 2.0)
