"""A child: needs time to start, to turn and to stop, whatever it does, as φ as well."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from road_user_limits import beyond
from skd_adversary.crossing.road_users import check_kind, nearest_walked
from skd_evaluator.assessment.plausibility import ROUNDING, recompute
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim.errors import UsageError
from skd_sim.options.adversary import Objective
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import Episode, Mode, Outcome
from skd_sim.world.state import Trajectory

SCENARIO = load_scenario("child")
STEP = SCENARIO.time_step
STEADY = Trajectory(np.column_stack([4.0 - 1.39 * STEP * np.arange(16), np.zeros(16)]), STEP)  # 5 km/h
STARTS = Trajectory(np.column_stack([4.0 - 2.2 * STEP * np.maximum(0, np.arange(14) - 3), np.zeros(14)]), STEP)
"""Stands, and leaps to 2.2 m/s in one tick, as no child can."""


@given(*[st.floats(-3.0, 3.0) for _ in range(4)])
def test_nothing_that_it_could_do_comes_nearer_to_what_is_wanted(vx: float, vy: float, wx: float, wy: float) -> None:
    x, y = nearest_walked(0.6, vx, vy, wx, wy)
    assert math.hypot(x - vx, y - vy) <= 0.6 + 1e-12
    away = math.hypot(wx - x, wy - y)
    assert away == pytest.approx(max(0.0, math.hypot(wx - vx, wy - vy) - 0.6), abs=1e-12)


@pytest.mark.parametrize("phi", [STEADY, STARTS], ids=["steady", "leaps"])
@pytest.mark.parametrize("objective", list(Objective))
def test_every_step_is_within_its_limits(phi: Trajectory, objective: Objective) -> None:
    assert (beyond("child", phi.positions, phi.positions, STEP) > 1.0) == (phi is STARTS)
    hits = 0
    for number in range(12):
        log = run_episode(
            Episode(
                SCENARIO, Mode.KAMIKAZE, 0, number, safe_trajectory=phi, simulations=300, objective=objective,
                multiplier=0.5,
            )
        )  # fmt: skip
        assert beyond("child", phi.positions, log.adversary, STEP) <= 1e-6, number
        assert recompute(log).deviation <= ROUNDING, recompute(log).where
        hits += log.outcome == Outcome.COLLISION
    assert hits >= 4


def test_it_comes_from_its_side_and_not_through_what_is_parked() -> None:
    arrived = 0
    for number in range(8):
        log = run_episode(Episode(SCENARIO, Mode.SAFE, 1, number, multiplier=1.15))
        assert log.adversary[0, 0] == 4.0
        if log.outcome == Outcome.ARRIVED:
            arrived += 1
            assert log.adversary[-1, 0] <= -2.0 < log.adversary[-2, 0]
        between = log.adversary[(log.adversary[:, 0] > 1.9) & (log.adversary[:, 0] < 3.72)]
        assert (np.abs(between[:, 1]) <= 0.75 + 1e-9).all()  # 1 m to each parked car, less its radius
    assert arrived >= 4


def test_a_kind_has_a_speed_and_a_shape() -> None:
    with pytest.raises(UsageError, match=r"adversary\.speed 9 m/s is more than any child does; give at most 8"):
        check_kind(replace(SCENARIO, adversary=replace(SCENARIO.adversary, speed=9.0)))
    with pytest.raises(UsageError, match=r"a cyclist is a box that points the way it moves"):
        check_kind(replace(SCENARIO, adversary=replace(SCENARIO.adversary, kind="cyclist")))
