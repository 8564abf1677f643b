"""The models of the planning benchmark against facts from outside: hand-computed cases, frequencies, other code."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from model_steps import step
from planning import PROBLEMS, run_episode
from problems import rock_sample, tiger
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


def test_rock_sample_remembers_by_bayes() -> None:
    model = rock_sample.rock_sample(7, 8)
    rng = np.random.default_rng(5)
    state, after = np.array(_rover(7, 8, 0, 3, 37)), np.empty(model.state_dim)
    odds = np.ones(8)
    for rock, _ in itertools.product(range(8), range(3)):
        model.step(model.parameters, state, rock_sample.CHECK + rock, after, rng)
        accuracy = model.parameters.accuracy[21, rock]
        odds[rock] *= accuracy / (1.0 - accuracy) if after[2] == 2.0 else (1.0 - accuracy) / accuracy
        state[:] = after
    np.testing.assert_allclose(state[3:], odds / (1.0 + odds), rtol=1e-12)


def _returns_of_the_default_policy(model: Pomdp, starts: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(6)
    after = np.empty(model.state_dim)
    returns = np.zeros(len(starts))
    for i, state in enumerate(starts):
        discount, terminal = 1.0, False
        while not terminal:
            action = model.rollout_action(model.parameters, state, rng)
            reward, terminal = model.step(model.parameters, state, action, after, rng)
            returns[i] += discount * reward
            discount *= model.discount
            state[:] = after
    return returns


def test_leaf_value_of_rock_sample_is_what_the_default_policy_gets() -> None:
    model = rock_sample.rock_sample(7, 8)
    chances = np.array([0.9, 0.2, 0.7, 0.5, 0.55, 0.0, 0.97, 0.4])
    rng = np.random.default_rng(6)
    starts = np.array(
        [[21, (rng.random(8) < chances) @ (1 << np.arange(8)), 0.0, *chances] for _ in range(4000)], dtype=float
    )
    assert model.leaf_value is not None
    value = model.leaf_value(model.parameters, starts[0])
    returns = _returns_of_the_default_policy(model, starts)
    assert abs(returns.mean() - value) <= SIGMAS * returns.std(ddof=1) / math.sqrt(len(returns))


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


def test_actions_that_make_sense_cost_no_penalty() -> None:
    model = rock_sample.rock_sample(7, 8)
    rng, after = np.random.default_rng(9), np.empty(model.state_dim)
    refused = 0
    for _ in range(300):
        state = np.array([rng.integers(49), rng.integers(256), 0.0, *rng.choice([0.0, 0.3, 0.5, 0.6, 0.99], 8)])
        for action in range(model.action_count):
            reward, _terminal = model.step(model.parameters, state, action, after, rng)
            if rock_sample.legal(model.parameters, state, action):
                assert reward > -100.0
            elif action < rock_sample.SAMPLE:
                assert reward == -100.0  # no move within the map is refused
            refused += not rock_sample.legal(model.parameters, state, action)
    assert refused > 0


# --- all of them


def _discrete_observations(name: str) -> tuple[Pomdp, list[float], list[float], int]:
    return {
        "tiger": (tiger.tiger(), [1.0], [0.0, 1.0], tiger.LISTEN),
        "rock_sample": (
            rock_sample.rock_sample(7, 8),
            [3.0, 5.0, 1.0, *[0.5] * 8],
            [0.0, 1.0, 2.0],
            rock_sample.CHECK,
        ),
    }[name]


@pytest.mark.parametrize("name", ["tiger", "rock_sample"])
def test_likelihoods_of_all_observations_sum_to_one(name: str) -> None:
    model, state, observations, action = _discrete_observations(name)
    total = sum(model.likelihood(model.parameters, np.array(state), action, np.array([seen])) for seen in observations)
    assert total == pytest.approx(1.0)


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
    values = np.array([run_episode("rock_sample_4_4", 3000, seed).value for seed in range(60)])
    error = values.std(ddof=1) / math.sqrt(len(values))
    assert values.mean() <= 18.04 + 3.5 * error
    assert values.mean() >= 15.0 - 3.5 * error
