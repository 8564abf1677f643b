"""With which side of a car a pedestrian was touched: against closed forms and shapely."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contacts import Run, run_of
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from shapely import box, distance, points
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

CROSSING = load_scenario("crossing")
STEADY = replace(
    CROSSING, car=replace(CROSSING.car, speed_noise=0.0, acceleration_noise=0.0, start_gap_range=0.0, start_gap=20.0)
)
"""The front is at −20 m and comes at 25/3 m/s."""
SPEED, HALF_WIDTH, RADIUS = 25.0 / 3.0, 0.9, 0.25


def crossing(speed: float, at: float, start: float = -3.5, delay: int = 0) -> Trajectory:
    """Return a pedestrian who crosses eastwards at a place along the road."""
    x = np.concatenate([np.full(delay, start), np.arange(start, 3.0, 0.3 * speed)])
    return Trajectory(np.column_stack([x, np.full(len(x), at)]), 0.3)


class NeverBrakes:
    def reset(self, scenario, rng):
        """Keep nothing."""

    def command(self, car, adversary):
        return 0.0


def run(phi: Trajectory, scenario=STEADY):
    return run_episode(EpisodeSpec(scenario, Mode.REPLAY, 0, 0, phi), NeverBrakes())


@given(st.floats(0.5, 3.5), st.floats(-8.0, 8.0), st.integers(0, 8))
@settings(max_examples=100, deadline=None)
def test_the_side_is_the_one_that_is_nearest_to_the_adversary_when_they_first_touch(speed, at, delay):
    """An unbraked car and a pedestrian who crosses: both move uniformly, so shapely finds the contact by bisection."""
    phi = crossing(speed, at, delay=delay)
    assume(len(phi) <= STEADY.ticks)
    log = run(phi)
    begin = 0.3 * (delay - 1 if delay else 0)

    def gap(time):
        """Return the distance from the car, and by how much the centre is ahead of the front."""
        x = np.interp(time, 0.3 * np.arange(len(phi)), phi.positions[:, 0])
        front = -20.0 + SPEED * time
        return distance(box(-HALF_WIDTH, front - 4.5, HALF_WIDTH, front), points(x, at)), at - front

    end = 0.3 * (len(phi) - 1)
    times = np.arange(begin, end, 0.001)
    gaps = gap(times)[0]
    touched = gaps <= RADIUS
    assume(np.abs(gaps.min() - RADIUS) > 0.02)  # a miss or a touch by less than the samples see
    assert (log.outcome == Outcome.COLLISION) == touched.any()
    if not touched.any():
        assert run_of(log) == Run.NONE
        return
    low, high = times[max(0, int(np.argmax(touched)) - 1)], times[int(np.argmax(touched))]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if gap(middle)[0] <= RADIUS else (middle, high)
    assert log.impact_time == pytest.approx(high, abs=1e-6)
    ahead = gap(high)[1]
    assume(min(abs(ahead), abs(ahead + 4.5)) > 1e-3)
    expected = Run.FRONT if ahead > 0.0 else Run.FLANK if ahead > -4.5 else Run.REAR
    assert run_of(log) == expected


def test_a_touch_of_a_car_slower_than_the_hit_speed_is_no_hit():
    creeps = replace(STEADY, car=replace(STEADY.car, start_speed=0.5, start_gap=1.0))
    stands = Trajectory(np.tile([[0.0, 0.0]], (20, 1)), 0.3)
    log = run(stands, creeps)
    assert (log.outcome, run_of(log)) == (Outcome.COLLISION, Run.SLOW)
    rolls = replace(STEADY, car=replace(STEADY.car, start_speed=0.6, start_gap=1.0))
    assert run_of(run(stands, rolls)) == Run.FRONT
