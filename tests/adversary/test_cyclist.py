"""The cyclist: a box that rides where it points, and whose recordings are checked by what it can do."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_adversary.crossing import road_users
from skd_adversary.crossing.road_users import BRAKE_LEFT, BRAKE_RIGHT, CYCLIST, LEFT, RIGHT
from skd_evaluator.assessment.plausibility import ROUNDING, recompute
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim import EpisodeSpec, Mode, Outcome, Trajectory, load_scenario
from skd_sim.options.car_and_adversary import DEFAULT_OBJECTIVES, Objective

SCENARIO = load_scenario("cyclist")
ACCELERATION, DECELERATION, LATERAL_ACCELERATION = 1.0, 3.0, 3.0  # m/s², as docs/decisions.md (4) has them
LIMITS = CYCLIST.parameters(SCENARIO)["own_limits"]
ridden, nearest_ridden = (partial(kernel, LIMITS) for kernel in (road_users.ridden, road_users.nearest_ridden))
STEP, MOST = SCENARIO.time_step, SCENARIO.adversary.speed
ACROSS = Trajectory(np.column_stack([np.arange(-8.0, 4.0, 1.5), np.zeros(8)]), STEP)  # at 5 m/s


@given(
    heading=st.floats(-math.pi, math.pi),
    speed=st.floats(0.0, MOST),
    action=st.integers(0, CYCLIST.kernels.action_count - 1),
)
def test_it_rides_where_it_points_and_leans_no_further_than_it_can(heading: float, speed: float, action: int) -> None:
    vx, vy = ridden(heading, speed, action, MOST, STEP)
    after = math.hypot(vx, vy)
    assert 0.0 <= after <= MOST + 1e-12
    assert -DECELERATION * STEP - 1e-9 <= after - speed <= ACCELERATION * STEP + 1e-9
    if after > 1e-6:
        turned = math.remainder(math.atan2(vy, vx) - heading, 2.0 * math.pi)
        assert abs(turned) * after <= LATERAL_ACCELERATION * STEP + 1e-9
        side = {LEFT: 1.0, BRAKE_LEFT: 1.0, RIGHT: -1.0, BRAKE_RIGHT: -1.0}.get(action, 0.0)
        assert math.copysign(1.0, turned) == side if side else abs(turned) < 1e-9


@pytest.mark.parametrize("objective", DEFAULT_OBJECTIVES)
def test_it_hits_and_its_recordings_are_believed(objective: Objective) -> None:
    """Every step is one that it can ride; to a pedestrian, who goes at one speed, some are impossible."""
    hits = 0
    strange = False
    for number in range(8):
        how = {"multiplier": 0.75, "safe_trajectory": ACROSS, "simulations": 200, "objective": objective}
        log = run_episode(EpisodeSpec(SCENARIO, Mode.KAMIKAZE, 5, number, **how))
        hits += log.outcome == Outcome.COLLISION
        found = recompute(log)
        assert found.deviation <= ROUNDING, found.where
        on_foot = replace(SCENARIO, adversary=replace(SCENARIO.adversary, kind="pedestrian"))
        strange |= recompute(replace(log, episode=replace(log.episode, scenario=on_foot))).deviation > 1e-3
        jumped = log.adversary.copy()
        jumped[2] += (0.0, 0.4)  # aside, and back
        assert recompute(replace(log, adversary=jumped)).deviation > 0.1
    assert hits >= 6
    assert strange
