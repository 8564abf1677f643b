"""The cars and the truth of the ranking benchmark against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cars.idm import IntelligentDriver, idm_acceleration
from hypothesis import given
from hypothesis import strategies as st
from ranking import kendall, least_time_to_collision
from skd_evaluator.campaign.runner import run_episode
from skd_sim.controllers import Controller
from skd_sim.encounter.road import HEADING_NORTH
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.state import CarState, PedestrianState
from skd_sim.trajectory import Trajectory
from wide_encounters import ALONG_THE_ROAD, EARLIER_OR_LATER, LONGEST_PAUSE, PACES, Car, encounters, walked

CROSSING = load_scenario("crossing")
ACROSS = Trajectory(np.column_stack([np.linspace(-3.5, 2.5, 9), np.zeros(9)]), CROSSING.time_step, "across")


@given(st.floats(0.1, 8.0), st.floats(8.1, 40.0))
def test_idm_keeps_its_speed_at_the_equilibrium_gap(speed, desired):
    """Their equation 5: s_e(v) = (s₀ + v·T) / √(1 − (v/v₀)⁴)."""
    gap = (2.0 + 1.6 * speed) / math.sqrt(1.0 - (speed / desired) ** 4)
    assert idm_acceleration(speed, desired, gap, 0.0) == pytest.approx(0.0, abs=1e-9)
    assert idm_acceleration(speed, desired, gap, 0.5) < 0.0 < idm_acceleration(speed, desired, 1.1 * gap, 0.0)


def test_idm_drives_freely_as_its_paper_says():
    assert idm_acceleration(0.0, 8.0, math.inf, 0.0) == 0.73
    assert idm_acceleration(8.0, 8.0, math.inf, 8.0) == 0.0


def test_idm_brakes_for_who_is_on_the_lane_ahead_and_for_nobody_else():
    car = IntelligentDriver()
    assert isinstance(car, Controller)
    car.reset(CROSSING, np.random.default_rng(0))
    state = CarState(0.0, 0.0, HEADING_NORTH, 8.0)
    ahead, beside, behind = ((0.0, 9.0), (2.0, 9.0), (0.0, -9.0))
    commands = [car.command(state, PedestrianState(x, y, 0.0, 0.0)) for x, y in (ahead, beside, behind)]
    assert commands[0] == -CROSSING.car.deceleration
    assert all(command > 0.0 for command in commands[1:])


def test_a_walk_is_delayed_quickened_and_moved():
    path = walked(ACROSS, delay=0.6, pace=2.0, along=1.5, ticks=40)
    np.testing.assert_allclose(path.positions[:3], [(-3.5, 1.5)] * 3)
    np.testing.assert_allclose(path.positions[3:7], ACROSS.positions[2::2] + np.array([0.0, 1.5]))
    assert path.positions[-1, 0] == 2.5
    assert len(walked(ACROSS, delay=0.6, pace=0.5, along=0.0, ticks=5)) == 6


def test_every_car_meets_the_same_pedestrians_within_the_stated_ranges():
    one = encounters(Car("one", "basic", 0.5, CROSSING), [ACROSS], 200, seed=3)
    other = encounters(Car("other", "basic", 1.5, CROSSING), [ACROSS], 200, seed=3)
    starts = []
    for first, second in zip(one, other, strict=True):
        assert first.safe_trajectory is not None
        assert second.safe_trajectory is not None
        np.testing.assert_array_equal(first.safe_trajectory.positions, second.safe_trajectory.positions)
        assert first.episode_id == second.episode_id
        walk = first.safe_trajectory.positions
        starts.append(walk[0, 1])
        steps = np.diff(walk[:, 0])
        assert steps.max() <= PACES[1] * 0.75 + 1e-9
        assert np.argmax(steps > 0.0) <= 2.0 * EARLIER_OR_LATER / CROSSING.time_step
    assert np.abs(starts).max() <= ALONG_THE_ROAD
    assert np.ptp(starts) > 1.8 * ALONG_THE_ROAD


def test_the_least_time_to_collision_is_that_of_the_last_tick():
    car = np.column_stack([np.zeros(3), [-20.0, -18.0, -16.0], np.full(3, 8.0)])
    standing = EpisodeLog(
        Episode(CROSSING, Mode.REPLAY, 0, 0, safe_trajectory=ACROSS), Outcome.ARRIVED, np.zeros((3, 2)), car
    )
    reach = CROSSING.car.front + CROSSING.pedestrian.radius
    assert least_time_to_collision(standing) == pytest.approx((18.0 - reach) / 8.0)
    hit = run_episode(Episode(CROSSING, Mode.REPLAY, 0, 0, multiplier=0.0, safe_trajectory=ACROSS))
    assert (least_time_to_collision(hit) == 0.0) == (hit.outcome == Outcome.COLLISION)


def test_kendall_counts_pairs():
    rows = [
        {"hit_rate": rate, "hit_rate_ci95": (rate - 0.06, rate + 0.06), "planned": value, "along": rate}
        for rate, value in ((0.5, 1.0), (0.4, 0.8), (0.1, 3.0))
    ]
    assert kendall(rows, "along") == pytest.approx(1.0)
    assert kendall(rows, "planned") == pytest.approx(1.0 / 3.0)  # two of three pairs agree
    assert kendall(rows, "planned", told_apart=True) == 1.0  # the third is within its intervals


def test_a_pace_that_changes_does_so_on_the_way():
    path = walked(ACROSS, delay=0.0, pace=1.0, along=0.0, ticks=40, change=(0.5, 0.5))
    np.testing.assert_allclose(path.positions[:5], ACROSS.positions[:5])
    np.testing.assert_allclose(path.positions[4:13:2], ACROSS.positions[4:])


def test_who_hesitates_stands_for_as_long_and_goes_on():
    path = walked(ACROSS, delay=0.0, pace=1.0, along=0.0, ticks=40, pause=(0.5, 2 * CROSSING.time_step))
    np.testing.assert_allclose(path.positions[:5], ACROSS.positions[:5])
    np.testing.assert_allclose(path.positions[4:7], [ACROSS.positions[4]] * 3)
    np.testing.assert_allclose(path.positions[6:11], ACROSS.positions[4:])


def test_the_ways_to_walk_share_their_other_draws():
    car = Car("one", "basic", 1.0, CROSSING)
    plain, hesitating = (encounters(car, [ACROSS], 50, seed=3, hesitating=way) for way in (False, True))
    for first, second in zip(plain, hesitating, strict=True):
        assert first.safe_trajectory is not None
        assert second.safe_trajectory is not None
        one, other = first.safe_trajectory.positions, second.safe_trajectory.positions
        assert one[0, 1] == other[0, 1]
        assert 0 <= len(other) - len(one) <= LONGEST_PAUSE / CROSSING.time_step + 1
        shared = min(len(one), len(other))
        assert (other[:shared, 0] <= one[:shared, 0] + 1e-9).all()
