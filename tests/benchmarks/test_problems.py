"""The models of the planning benchmark against hand-computed cases, frequencies and other code."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from model_steps import step
from planning import PROBLEMS, run_episode
from problems import rock_sample
from problems.sub_hunt import NORTH, PING, sub_hunt
from skd_adversary.pomdp.model import Pomdp

Draws = dict[tuple[float, ...], float]
SIGMAS = 4.5  # binomial bounds: 7e-6 each, a few hundred of them


def _frequencies(model: Pomdp, state: list[float], action: int, count: int, entries: int | None = None) -> Draws:
    """Return next state (its first entries) → frequency."""
    rng = np.random.default_rng(1)
    begin, after = np.array(state, float), np.empty(model.state_dim)
    counts: dict[tuple[float, ...], int] = {}
    for _ in range(count):
        model.step(model.parameters, begin, action, after, rng)
        key = tuple(after[:entries].tolist())
        counts[key] = counts.get(key, 0) + 1
    return {key: value / count for key, value in counts.items()}


# --- RockSample


def _rover(size: int, count: int, x: int, y: int, bits: int, chance: float = 0.5) -> list[float]:
    return [float(x + size * y), float(bits), 0.0, *([chance] * count)]


def test_moves_and_rewards_of_rock_sample() -> None:
    model = rock_sample.rock_sample(7, 8)
    assert step(model, _rover(7, 8, 6, 2, 0), rock_sample.EAST)[:2] == (10.0, True)
    assert step(model, _rover(7, 8, 0, 2, 0), rock_sample.WEST)[:2] == (-100.0, False)
    assert step(model, _rover(7, 8, 3, 6, 0), rock_sample.NORTH)[:2] == (-100.0, False)
    assert step(model, _rover(7, 8, 3, 0, 0), rock_sample.SOUTH)[:2] == (-100.0, False)
    assert step(model, _rover(7, 8, 4, 4, 255), rock_sample.SAMPLE)[:2] == (-100.0, False)
    reward, terminal, after = step(model, _rover(7, 8, 2, 4, 255), rock_sample.SAMPLE)  # rock 4
    assert (reward, terminal, after[1], after[3 + 4]) == (10.0, False, 255.0 - 16.0, 0.0)
    assert step(model, _rover(7, 8, 2, 4, 255 - 16), rock_sample.SAMPLE)[0] == -10.0
    assert step(model, _rover(7, 8, 2, 4, 0), rock_sample.NORTH)[2][0] == 2 + 7 * 5


@pytest.mark.parametrize(("place", "distance"), [((0, 0), 2.0), ((2, 0), 0.0), ((6, 3), 5.0)])
def test_accuracy_of_a_check(place: tuple[int, int], distance: float) -> None:
    """Of rock 0 at (2, 0): halfway between certain and a coin at 20 cells."""
    model, count = rock_sample.rock_sample(7, 8), 6000
    accuracy = 0.5 * (1.0 + 0.5 ** (distance / 20.0))
    for bit in (0, 1):
        state = _rover(7, 8, *place, bit)
        draws = _frequencies(model, state, rock_sample.CHECK, count)
        share = sum(chance for after, chance in draws.items() if after[2] == (2.0 if bit else 1.0))
        assert abs(share - accuracy) <= SIGMAS * math.sqrt(accuracy * (1.0 - accuracy) / count) + 1e-12
        for after in draws:  # Bayes from an even prior
            assert after[3] == pytest.approx(accuracy if after[2] == 2.0 else 1.0 - accuracy)


@pytest.mark.parametrize("action", [rock_sample.EAST, rock_sample.SAMPLE, rock_sample.CHECK, rock_sample.CHECK + 3])
def test_advantage_is_what_an_action_gains_over_the_default_policy(action: int) -> None:
    """The mean of reward and discounted value of the next state, less the value of this one."""
    model = rock_sample.rock_sample(7, 8)
    planned = rock_sample.rock_sample(7, 8, advantages=True)
    chances = np.array([0.9, 0.2, 0.7, 0.5, 0.55, 0.0, 0.97, 0.4])
    rng, count = np.random.default_rng(11), 6000
    after = np.empty(model.state_dim)
    advantages, gains = set(), np.empty(count)
    assert model.leaf_value is not None
    for i in range(count):
        bits = (rng.random(8) < chances) @ (1 << np.arange(8))
        state = np.array([3 + 7 * 1, bits, 0.0, *chances])  # on rock 2
        reward, _ = model.step(model.parameters, state, action, after, rng)
        ahead = model.leaf_value(model.parameters, after)
        gains[i] = reward + 0.95 * ahead - model.leaf_value(model.parameters, state)
        advantages.add(round(planned.step(planned.parameters, state, action, after, rng)[0], 9))
    assert len(advantages) == 1  # whatever the rocks are and whatever is read
    assert abs(gains.mean() - advantages.pop()) <= SIGMAS * gains.std(ddof=1) / math.sqrt(count) + 1e-9


# --- all of them


def test_planner_on_rock_sample_4_4(monkeypatch: pytest.MonkeyPatch) -> None:
    """The optimum is 18.0 (HSVI; Smith and Simmons 2004, table 1); leaving at once is worth 8.1."""
    problem = PROBLEMS["rock_sample_7_8"]
    options = replace(problem.options, depth=25, particles=1000)
    small = replace(
        problem,
        make=lambda: rock_sample.rock_sample(4, 4),
        planning_model=lambda: rock_sample.rock_sample(4, 4, advantages=True),
        options=options,
        moves=40,
    )
    monkeypatch.setitem(PROBLEMS, "rock_sample_4_4", small)
    values = np.array([run_episode("rock_sample_4_4", 3000, seed).value for seed in range(24)])
    error = values.std(ddof=1) / math.sqrt(len(values))
    assert values.mean() <= 18.04 + 3.5 * error
    assert values.mean() >= 15.0 - 3.5 * error


MODEL = sub_hunt()


@pytest.mark.parametrize("action", [PING, NORTH])
def test_likelihood_is_the_density(action: int) -> None:
    """In proportion: the ratio of two states' likelihoods is that of the normal densities."""
    near, far = np.array([10.0, 10.0, 11.0, 12.0, 0.0, 1.0]), np.array([10.0, 10.0, 3.0, 15.0, 0.0, 1.0])

    def density(state: np.ndarray, seen: np.ndarray) -> float:
        distance = math.hypot(state[2] - state[0], state[3] - state[1])
        beam = 1 if state is near else 3
        means, sigmas = np.full(8, 20.0 if action == PING else 3.0), np.full(8, 0.5 if action == PING else 5.0)
        if action == PING or distance <= 3.0:
            means[beam], sigmas[beam] = distance, 0.5
        return float(np.prod(np.exp(-0.5 * ((seen - means) / sigmas) ** 2) / sigmas))

    rng, seen = np.random.default_rng(5), np.empty(8)
    for _ in range(20):
        seen[:] = rng.normal(15.0 if action == PING else 3.0, 3.0, 8)
        ours = [MODEL.likelihood(MODEL.parameters, state, action, seen) for state in (near, far)]
        theirs = [density(state, seen) for state in (near, far)]
        if min(theirs) > 1e-280:
            assert ours[0] / ours[1] == pytest.approx(theirs[0] / theirs[1], rel=1e-6)
