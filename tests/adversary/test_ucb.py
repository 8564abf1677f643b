"""UCB1's constant where the search finds it itself."""

from __future__ import annotations

import numpy as np
from models import OPEN_LEFT, OPEN_RIGHT, tiger
from skd_adversary.pomdp.belief import ParticleBelief
from skd_adversary.pomdp.planner import Planner, PlannerOptions


def _decided(scale: float) -> Planner:
    model = tiger(listen=-scale, wrong=-100.0 * scale, right=10.0 * scale)
    rng = np.random.default_rng(3)
    planner = Planner(model, PlannerOptions(simulations=800, depth=8), rng)
    planner.plan(ParticleBelief(model, 200, rng))
    return planner


def test_rewards_in_another_unit_change_no_decision() -> None:
    """By a power of two, so that no number is rounded otherwise."""
    planner, other = _decided(1.0), _decided(1024.0)
    assert other.visits.tolist() == planner.visits.tolist()
    assert other.values.tolist() == (1024.0 * planner.values).tolist()
    assert other.exploration == 1024.0 * planner.exploration
    assert planner.visits.min() >= 1
    assert 1.0 < planner.exploration < 440.0  # no deviation is greater than the range, 110 at a step and the discount


def test_a_certain_catastrophe_is_not_tried_over_and_over() -> None:
    """It is known after a single try; the range of the returns as constant would try that door 7 times in 1,000."""
    model = tiger(wrong=-1000.0)
    rng = np.random.default_rng(5)
    planner, belief = Planner(model, PlannerOptions(simulations=1000, depth=1), rng), ParticleBelief(model, 400, rng)
    belief.particles[:, 0] = 1.0
    assert planner.plan(belief) == OPEN_LEFT
    assert planner.visits[OPEN_RIGHT] == 1
