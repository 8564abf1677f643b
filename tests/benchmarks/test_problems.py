"""The models of the planning benchmark against hand-computed cases, frequencies and other code."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from model_steps import step
from planning import PROBLEMS, run_episode
from problems import rock_sample
from problems.sub_hunt import EAST, ENGAGE, NORTH, PING, SOUTH, WEST, sub_hunt
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


def _outcomes(state: list[float], action: int, count: int) -> tuple[dict[Any, float], float, float]:
    """Return next target → frequency, mean reward and share of ends."""
    rng, after = np.random.default_rng(2), np.empty(6)
    counts: dict[Any, float] = {}
    total, ends = 0.0, 0
    for _ in range(count):
        reward, terminal = MODEL.step(MODEL.parameters, np.array(state), action, after, rng)
        total, ends = total + reward, ends + terminal
        if not terminal:
            key = tuple(after.astype(int).tolist())
            counts[key] = counts.get(key, 0.0) + 1.0 / count
    return counts, total / count, ends / count


@pytest.mark.parametrize(
    ("goal", "targets"),
    [
        (NORTH, {(5, 9): 0.5, (4, 8): 0.25, (6, 8): 0.25}),
        (EAST, {(7, 7): 0.5, (6, 8): 0.25, (6, 6): 0.25}),
        (SOUTH, {(5, 5): 0.5, (4, 6): 0.25, (6, 6): 0.25}),
        (WEST, {(3, 7): 0.5, (4, 8): 0.25, (4, 6): 0.25}),
    ],
)
def test_the_target_makes_for_its_edge(goal: int, targets: dict[Any, float]) -> None:
    count = 4000
    found, reward, ends = _outcomes([10.0, 10.0, 5.0, 7.0, goal, 0.0], PING, count)
    assert (reward, ends) == (0.0, 0.0)
    assert set(found) == {(10, 10, *target, goal, 1) for target in targets}  # a ping makes it aware
    for target, chance in targets.items():
        bound = SIGMAS * math.sqrt(chance * (1.0 - chance) / count)
        assert abs(found[10, 10, *target, goal, 1] - chance) <= bound


def test_engaging() -> None:
    count = 4000
    near, far = [10.0, 10.0, 10.0, 12.0, NORTH], [10.0, 10.0, 11.0, 12.0, NORTH]
    assert _outcomes([*near, 0.0], ENGAGE, 50)[1:] == (100.0, 1.0)
    assert _outcomes([*far, 0.0], ENGAGE, 50)[1:] == (0.0, 0.0)
    _, reward, ends = _outcomes([*near, 1.0], ENGAGE, count)
    assert reward == pytest.approx(100.0 * ends)
    assert abs(ends - 0.6) <= SIGMAS * math.sqrt(0.24 / count)


@pytest.mark.parametrize(
    ("target", "beam"),
    [
        ((13, 10), 7),  # due East is 2π, in the last beam
        ((13, 12), 0),
        ((10, 12), 1),
        ((8, 11), 3),
        ((7, 10), 3),
        ((9, 9), 4),
        ((10, 7), 5),
        ((11, 9), 6),
    ],
)
def test_beams(target: tuple[int, int], beam: int) -> None:
    """Beams of 45° from East, counterclockwise: (0°, 45°], … as the reference has them."""
    state = np.array([10.0, 10.0, *target, NORTH, 1.0])
    rng, seen = np.random.default_rng(3), np.empty((400, 8))
    for row in seen:
        MODEL.observe(MODEL.parameters, state, PING, row, rng)
    distance = math.hypot(target[0] - 10, target[1] - 10)
    expected = np.full(8, 20.0)
    expected[beam] = distance
    assert (np.abs(seen.mean(axis=0) - expected) <= SIGMAS * 0.5 / 20.0).all()
    for row in seen:
        MODEL.observe(MODEL.parameters, state, NORTH, row, rng)
    near = distance <= 3.0
    expected = np.full(8, 3.0)
    sigma = np.full(8, 5.0)
    if near:
        expected[beam], sigma[beam] = distance, 0.5
    assert (np.abs(seen.mean(axis=0) - expected) <= SIGMAS * sigma / 20.0).all()
    assert (np.abs(seen.std(axis=0) / sigma - 1.0) <= SIGMAS / math.sqrt(2.0 * 400.0)).all()


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
