"""SubHunt by its rules, and whether the planner asks."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from problems.sub_hunt import EAST, ENGAGE, NORTH, PING, SOUTH, WEST, sub_hunt

MODEL = sub_hunt()
SIGMAS = 4.5


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


def test_ours_goes_three_cells_and_stays_in_the_bay() -> None:
    for action, own in ((NORTH, (2, 20)), (EAST, (5, 19)), (SOUTH, (2, 16)), (WEST, (1, 19))):
        found, _, _ = _outcomes([2.0, 19.0, 10.0, 10.0, NORTH, 0.0], action, 50)
        assert {key[:2] for key in found} == {own}
        assert {key[5] for key in found} == {0}


def test_it_is_over_at_the_far_edge_without_a_reward() -> None:
    _, reward, ends = _outcomes([10.0, 10.0, 5.0, 19.0, NORTH, 0.0], NORTH, 50)
    assert (reward, ends) == (0.0, 1.0)
    count = 4000
    _, reward, ends = _outcomes([10.0, 10.0, 3.0, 5.0, WEST, 0.0], PING, count)
    assert reward == 0.0
    assert abs(ends - 0.5) <= SIGMAS * math.sqrt(0.25 / count)


def test_engaging() -> None:
    count = 4000
    near, far = [10.0, 10.0, 10.0, 12.0, NORTH], [10.0, 10.0, 11.0, 12.0, NORTH]
    assert _outcomes([*near, 0.0], ENGAGE, 50)[1:] == (100.0, 1.0)
    assert _outcomes([*far, 0.0], ENGAGE, 50)[1:] == (0.0, 0.0)
    _, reward, ends = _outcomes([*near, 1.0], ENGAGE, count)
    assert reward == pytest.approx(100.0 * ends)
    assert abs(ends - 0.6) <= SIGMAS * math.sqrt(0.24 / count)


def test_it_starts_anywhere_along_an_edge() -> None:
    rng, state = np.random.default_rng(1), np.empty(6)
    seen = set()
    for _ in range(3000):
        MODEL.initial(MODEL.parameters, state, rng)
        assert (state[0], state[1], state[5]) == (10.0, 10.0, 0.0)
        seen.add(tuple(state[2:5].astype(int).tolist()))
    along = range(1, 21)
    expected = {(a, 1, NORTH) for a in along} | {(a, 20, SOUTH) for a in along}
    assert seen == expected | {(1, a, EAST) for a in along} | {(20, a, WEST) for a in along}


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
