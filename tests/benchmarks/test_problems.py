"""The models of the planning benchmark against hand-computed cases, frequencies and other code."""

import math
from dataclasses import replace

import numpy as np
import pytest
from planning import PROBLEMS, run_episode
from problems import rock_sample
from problems.sub_hunt import sub_hunt
from skd_adversary.pomdp.model import Pomdp, check_model


def step(model: Pomdp, state: list[float], action: int) -> tuple[float, bool, list[float]]:
    """Return reward, whether it ends there, and the next state; what is drawn is the same each time."""
    after = np.empty(model.state_dim)
    reward, terminal = model.step(model.parameters, np.array(state, float), action, after, np.random.default_rng(0))
    return reward, terminal, after.tolist()


SIGMAS = 4.5  # binomial bounds: 7e-6 each, a few hundred of them


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


def test_the_models_of_the_benchmark_keep_the_rules() -> None:
    for model in (rock_sample.rock_sample(7, 8), sub_hunt()):
        check_model(model, episodes=5)
