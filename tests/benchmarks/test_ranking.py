"""The truths of the ranking benchmark, and how it counts: against closed forms, shapely and counts by hand."""

from dataclasses import replace

import numpy as np
import pytest
from cars.catalogue import CARS
from contacts import Run, run_of
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pair_orders import safer_of
from ranking_figures import FIGURES, Work
from shapely import box, distance, points
from skd_evaluator import deviation, run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_sim import EpisodeSpec, Mode, Outcome, Trajectory, load_scenario
from wide_scenarios import ALONG_THE_ROAD, EARLIER_OR_LATER, PACES, Manner, outcomes, scenarios

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


ACROSS = Trajectory(np.column_stack([np.linspace(-3.5, 2.5, 9), np.zeros(9)]), CROSSING.time_step, "across")
OFTEN = next(car for car in CARS if car.controller == "cars.collision_time:EarlyBrake")  # decides every 0.05 s


def test_every_car_meets_the_same_adversaries_within_the_stated_ranges():
    one = scenarios(CARS[0], [ACROSS], range(200), seed=3)
    other = scenarios(OFTEN, [ACROSS], range(200), seed=3)
    starts = []
    for first, second in zip(one, other, strict=True):
        np.testing.assert_array_equal(first.safe_trajectory.positions, second.safe_trajectory.positions)
        assert first.episode_id == second.episode_id
        assert second.scenario.control_duration == pytest.approx(0.05)
        walk = first.safe_trajectory.positions
        starts.append(walk[0, 1])
        steps = np.diff(walk[:, 0])
        assert steps.max() <= PACES[1] * 0.75 + 1e-9
        assert np.argmax(steps > 0.0) <= 2.0 * EARLIER_OR_LATER / CROSSING.time_step
    assert np.abs(starts).max() <= ALONG_THE_ROAD
    assert np.ptp(starts) > 1.8 * ALONG_THE_ROAD


def test_a_car_with_a_clock_of_its_own_gets_a_letter_a_run_that_no_number_of_workers_changes():
    with InProcessRunner(2, isolated=True) as runner:
        letters = outcomes(OFTEN, [ACROSS], 120, 3, Manner.HESITATING, runner)
    episodes = scenarios(OFTEN, [ACROSS], range(120), 3, Manner.HESITATING)
    assert letters == "".join(run_of(run_episode(episode)) for episode in episodes)
    assert len(set(letters)) > 1


def test_of_two_cars_the_one_is_safer_that_a_sign_test_says_so_of():
    """Of six runs in which they differ all must speak for the same car: 2 · 2⁻⁶ < 0.05 < 2 · 2⁻⁵."""
    none, five, six = (np.array([True] * hits + [False] * (20 - hits)) for hits in (0, 5, 6))
    assert (safer_of(none, six), safer_of(six, none), safer_of(none, five), safer_of(six, six)) == (0, 1, -1, -1)
    assert safer_of(six, np.roll(six, 6)) == -1


@pytest.mark.parametrize("car", [CARS[0], OFTEN], ids=lambda car: car.label)
def test_figures_are_means_over_all_trials_a_miss_counting_as_the_most(car):
    with InProcessRunner(1, isolated=True) as runner:
        work = Work(car, [ACROSS], 4, 0, runner)
        names = ("planned_generic", "along", "margin")
        needed, hits, margins = (FIGURES[name].compute(work)["values"] for name in names)
    plan = work.plan()
    for trial, value in enumerate(needed[0]):
        log = run_episode(plan.episode(Mode.KAMIKAZE, 0, trial, ACROSS))
        if log.outcome == Outcome.COLLISION and log.impact_speed >= 0.556:
            ticks = log.impact_time / CROSSING.time_step
            assert value == min(5.0, deviation(ACROSS.positions, log.trajectory.positions, ticks))
        else:
            assert value == 5.0
    assert set(hits[0]) <= {0.0, 1.0}
    assert (np.array(margins) <= np.array(needed) + 1e-9).all()  # none is better than the best
    assert np.mean(margins) < 1.0
