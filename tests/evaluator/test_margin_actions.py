"""What the adversary of the margin can do in a tick."""

from __future__ import annotations

import math

import numpy as np
import pytest
from skd_adversary.crossing import road_users
from skd_adversary.crossing.road_users import ACTION_COUNT, AS_PHI, STAY, action_velocity, road_user_named
from skd_evaluator.margin.actions import FIRST_HALF, MOVE_COUNT, move_velocity, velocities
from skd_sim.scenario.scenario import load_scenario

CROSSING, CYCLIST = load_scenario("crossing"), load_scenario("cyclist")
LIMITS = road_user_named("cyclist").parameters(CYCLIST)["own_limits"]
PHI = np.array([[-3.5, 0.0], [-3.2, 0.1], [-2.9, 0.1]])


def test_a_pedestrian_stays_or_goes_in_five_directions_at_two_paces_or_as_phi():
    found = velocities(CROSSING, PHI, 0)
    assert found.shape == (MOVE_COUNT, 2) == (12, 2)
    speeds = np.hypot(*found.T)
    assert np.delete(speeds, [STAY, AS_PHI]) == pytest.approx([2.5] * 5 + [1.25] * 5)
    assert speeds[STAY] == 0.0
    for action in range(ACTION_COUNT):
        assert tuple(found[action]) == action_velocity(action, 2.5)
    for action in range(STAY):
        assert found[FIRST_HALF + action] == pytest.approx(0.5 * found[action], abs=0.0)
    assert len(np.unique(np.round(found, 9), axis=0)) == 12
    assert found[AS_PHI] == pytest.approx([1.0, 1.0 / 3.0])
    assert velocities(CROSSING, PHI, 1)[AS_PHI] == pytest.approx([1.0, 0.0])
    assert velocities(CROSSING, PHI, 2)[AS_PHI] == pytest.approx([0.0, 0.0], abs=0.0)
    for way in range(MOVE_COUNT):
        assert tuple(found[way]) == move_velocity(way, PHI, 0, CROSSING.time_step, 2.5)


def test_a_cyclist_has_its_own_actions_from_its_own_state():
    step, most = CYCLIST.time_step, CYCLIST.adversary.speed
    straight = np.array([[-9.0 + 0.9 * k, 0.0] for k in range(8)])
    walked = straight[:2] + np.array([[0.0, 0.0], [0.0, 0.2]])
    found = velocities(CYCLIST, straight, 1, walked)
    heading, speed = math.atan2(0.2, 0.9), math.hypot(0.2, 0.9) / step
    expected = [road_users.ridden(LIMITS, heading, speed, action, most, step) for action in range(7)]
    assert found[:-1] == pytest.approx(np.array(expected))


def test_a_cyclist_goes_as_phi_as_far_as_it_can():
    step = CYCLIST.time_step
    straight = np.array([[-9.0 + 0.9 * k, 0.0] for k in range(8)])
    as_phi = velocities(CYCLIST, straight, 2, straight[:3])[-1]
    assert as_phi == pytest.approx([3.0, 0.0])
    # φ jumps aside: nobody rides so, whoever has been as φ before. 3 m/s is 1.8 m/s² less than √13 m/s and turns 33.7°.
    jump = straight.copy()
    jump[3:, 1] = 0.6
    bounded = velocities(CYCLIST, jump, 2, jump[:3])[-1]
    assert np.hypot(*bounded) == pytest.approx(3.0 + step * LIMITS.acceleration)
    turned = math.atan2(bounded[1], bounded[0])
    assert turned == pytest.approx(LIMITS.lateral * step / np.hypot(*bounded))
    # What is between its actions it can do.
    between = 2.8 * np.array([math.cos(0.1), math.sin(0.1)])
    reachable = np.vstack([straight[:3], straight[2] + step * between])
    assert velocities(CYCLIST, reachable, 2, straight[:3])[-1] == pytest.approx(between)
