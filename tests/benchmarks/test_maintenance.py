"""A problem without an end, written by docs/your_pomdp.md alone, against its optimum.

A machine wears out unseen. It hums, which says little; to inspect it costs 1 and says much; to repair it costs 12.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import pytest
from skd_adversary.pomdp.belief import ParticleBelief
from skd_adversary.pomdp.model import Pomdp, check_model
from skd_adversary.pomdp.planner import Planner, PlannerOptions, play
from skd_sim.kernels.compilation import kernel

RUN, INSPECT, REPAIR = range(3)
GAMMA = 0.95


class Parameters(NamedTuple):
    wear: float = 0.1
    hum: float = 2.0
    gauge: float = 0.4


@kernel
def initial(p: Any, state: Any, rng: Any) -> None:
    state[0] = 0.0


@kernel
def step(p: Any, state: Any, action: int, after: Any, rng: Any) -> Any:
    after[0] = state[0]
    if action == INSPECT:
        return -1.0, False
    if action == REPAIR:
        after[0] = 0.0
        return -12.0, False
    if rng.random() < p.wear:
        after[0] = 1.0
    return (5.0 if state[0] == 0.0 else -5.0), False


@kernel
def observe(p: Any, after: Any, action: int, seen: Any, rng: Any) -> None:
    seen[0] = after[0] + (p.gauge if action == INSPECT else p.hum) * rng.standard_normal()


@kernel
def likelihood(p: Any, after: Any, action: int, seen: Any) -> float:
    error = (seen[0] - after[0]) / (p.gauge if action == INSPECT else p.hum)
    return math.exp(-0.5 * error * error)


@kernel
def rollout_action(p: Any, state: Any, rng: Any) -> int:
    return REPAIR if state[0] == 1.0 else RUN


@kernel
def reinvigorate(p: Any, state: Any, seen: Any, redrawn: Any, rng: Any) -> None:
    redrawn[0] = state[0]


MODEL = Pomdp(
    "test_maintenance", 1, 1, 3, GAMMA, Parameters(), initial, step, observe, likelihood, rollout_action, reinvigorate
)


def _optimum(*, inspect: bool = True) -> float:
    """Value iteration over the probability of wear, with Gauss and Hermite's quadrature over what is seen."""
    p, worn = Parameters(), np.linspace(0.0, 1.0, 401)
    nodes, weights = np.polynomial.hermite_e.hermegauss(41)
    weights = weights / weights.sum()

    def seeing(prior: Any, sigma: float, values: Any) -> Any:
        ahead = np.zeros_like(prior)
        for state, chance in ((0.0, 1.0 - prior), (1.0, prior)):
            seen = state + sigma * nodes
            odds = np.exp((seen - 0.5) / sigma**2)  # of wear, by the two densities
            posterior = prior[:, None] * odds / (prior[:, None] * odds + 1.0 - prior[:, None])
            ahead += chance * (np.interp(posterior, worn, values) @ weights)
        return ahead

    values = np.zeros_like(worn)
    for _ in range(300):
        run = 5.0 - 10.0 * worn + GAMMA * seeing(worn + (1.0 - worn) * p.wear, p.hum, values)
        look = -1.0 + GAMMA * seeing(worn, p.gauge, values) if inspect else -np.inf
        values = np.maximum(np.maximum(run, look), -12.0 + GAMMA * values[0])
    return float(values[0])


def test_the_planner_inspects_and_comes_near_the_optimum() -> None:
    """With default options, rollouts of a policy that sees the wear, and an end of every episode at 0.95⁶⁰ = 0.05."""
    check_model(MODEL)
    optimum = _optimum()
    assert optimum == pytest.approx(39.0, abs=0.2)
    assert _optimum(inspect=False) < optimum - 9.0
    values, inspections = [], []
    for seed in range(25):
        rng = np.random.default_rng(seed)
        planner = Planner(MODEL, PlannerOptions(simulations=500, depth=30, exploration=20.0), rng)
        played = play(MODEL, ParticleBelief(MODEL, 200, rng), planner, rng, moves=60)
        values.append(played.value)
        inspections.append(played.actions.count(INSPECT))
        assert (len(played.actions), played.ended) == (60, False)
    assert min(inspections) >= 1
    error = np.std(values, ddof=1) / math.sqrt(len(values))
    # What is left out beyond the last move is worth 0.05 · 39 or less; a tenth for what a short search loses.
    assert 0.9 * optimum - 0.05 * optimum - 3.5 * error <= np.mean(values) <= optimum + 3.5 * error
