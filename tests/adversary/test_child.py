"""A child: needs time to start, to turn and to stop, whatever it does, as φ as well."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_adversary.crossing.road_users import check_kind, nearest_walked
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import Episode, Mode, Outcome

SCENARIO = load_scenario("child")
"""Stands, and leaps to 2.2 m/s in one tick, as no child can."""


@given(*[st.floats(-3.0, 3.0) for _ in range(4)])
def test_nothing_that_it_could_do_comes_nearer_to_what_is_wanted(vx: float, vy: float, wx: float, wy: float) -> None:
    x, y = nearest_walked(0.6, vx, vy, wx, wy)
    assert math.hypot(x - vx, y - vy) <= 0.6 + 1e-12
    away = math.hypot(wx - x, wy - y)
    assert away == pytest.approx(max(0.0, math.hypot(wx - vx, wy - vy) - 0.6), abs=1e-12)


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
