"""The models of the planning benchmark against facts from outside: hand-computed cases, frequencies, other code."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from model_steps import step
from planning_episode import run_episode
from planning_problems import PROBLEMS
from problems import laser_tag, light_dark, pursuit, rock_sample, sub_hunt, tag, tiger
from problems.crossing import crossing
from skd_adversary.planning.pomdp import Pomdp

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


def _agree(frequencies: Draws, expected: Draws, count: int) -> None:
    assert set(frequencies) <= set(expected)
    for key, chance in expected.items():
        bound = SIGMAS * math.sqrt(chance * (1.0 - chance) / count)
        assert abs(frequencies.get(key, 0.0) - chance) <= bound + 1e-12, key


# --- Tag


def _cell(x: int, y: int) -> float:
    return float(tag.CELLS.index((x, y)))


def test_floor_of_tag_is_the_published_one() -> None:
    rows = ["#####...##", "#####...##", "#####...##", "..........", ".........."]
    drawn = {(x, len(rows) - 1 - i) for i, row in enumerate(rows) for x, mark in enumerate(row) if mark == "."}
    assert set(tag.CELLS) == drawn
    assert len(tag.CELLS) == 29


@pytest.mark.parametrize(
    ("robot", "opponent", "expected"),
    [
        ((2, 0), (4, 1), {(5, 1): 0.4, (4, 1): 0.6}),  # flees East, has no way North, or stays
        ((6, 3), (6, 2), {(5, 2): 0.2, (7, 2): 0.2, (6, 1): 0.4, (6, 2): 0.2}),  # level in x: either way along x
        ((0, 0), (9, 1), {(9, 1): 1.0}),  # in the corner
        ((5, 1), (5, 1), {(4, 1): 0.2, (6, 1): 0.2, (5, 2): 0.2, (5, 0): 0.2, (5, 1): 0.2}),  # same cell, it moves on
    ],
)
def test_opponent_flees(robot: tuple[int, int], opponent: tuple[int, int], expected: dict[Any, float]) -> None:
    model, count = tag.tag(), 4000
    state = [_cell(*robot), _cell(*opponent), *[1.0 / 29.0] * 29]
    moved = (robot[0], robot[1] - 1)
    to = _cell(*moved) if moved in tag.CELLS else _cell(*robot)
    frequencies = _frequencies(model, state, pursuit.SOUTH, count, entries=2)
    _agree(frequencies, {(to, _cell(*cell)): chance for cell, chance in expected.items()}, count)


def test_rewards_of_tag() -> None:
    model, chances = tag.tag(), [1.0 / 29.0] * 29
    assert step(model, [3.0, 3.0, *chances], pursuit.TAG)[:2] == (10.0, True)
    assert step(model, [3.0, 4.0, *chances], pursuit.TAG)[:2] == (-10.0, False)
    assert step(model, [3.0, 3.0, *chances], pursuit.NORTH)[:2] == (-1.0, False)


def test_the_state_of_tag_knows_what_was_seen_and_no_more() -> None:
    """Of many states that were seen alike, the opponents are spread as each of them says."""
    model, count = tag.tag(), 20_000
    rng = np.random.default_rng(3)
    state, after = np.empty(model.state_dim), np.empty(model.state_dim)
    unseen = np.zeros(29)
    said = np.empty(29)
    for _ in range(count):
        model.initial(model.parameters, state, rng)
        state[tag.ROBOT] = _cell(5, 1)
        for action in (pursuit.EAST, pursuit.NORTH, pursuit.NORTH, pursuit.WEST):
            model.step(model.parameters, state, action, after, rng)
            state[:] = after
            if state[tag.ROBOT] == state[tag.OPPONENT]:
                assert state[tag.CHANCES + int(state[tag.ROBOT])] == 1.0
                break
        else:
            unseen[int(state[tag.OPPONENT])] += 1
            said[:] = state[tag.CHANCES :]
    total = unseen.sum()
    assert said.sum() == pytest.approx(1.0)
    assert (np.abs(unseen / total - said) <= SIGMAS * np.sqrt(said * (1.0 - said) / total) + 1e-12).all()


def test_values_of_a_pursuit_that_is_seen() -> None:
    """A corridor of two cells: the opponent at its end stays (0.2 + blocked moves), so it is caught in two moves."""
    cells = ((0, 0), (1, 0))
    values, actions = pursuit.fully_observable_solution(pursuit.robot_moves(cells), pursuit.opponent_moves(cells))
    assert values[1, 1] == pytest.approx(10.0)
    assert actions[1, 1] == pursuit.TAG
    assert values[0, 1] == pytest.approx(-1.0 + 0.95 * 10.0)
    assert actions[0, 1] == pursuit.EAST


# --- LaserTag

FLOOR = tuple((x, y) for x in range(11) for y in range(7) if (x, y) not in {(5, 0), (2, 2)})


def test_beams_on_a_floor_by_hand() -> None:
    ranges = laser_tag.laser_ranges(FLOOR)
    index = {cell: i for i, cell in enumerate(FLOOR)}
    # N, E, S, W, NE, SE, SW, NW of (0, 0): wall after 7; obstacle 5 cells off; walls; NE obstacle at (2, 2)
    assert ranges[index[0, 0], index[10, 6]].tolist() == [7, 5, 1, 1, 2, 1, 1, 1]
    assert ranges[index[0, 0], index[0, 3]].tolist() == [3, 5, 1, 1, 2, 1, 1, 1]  # the opponent stops a beam
    assert ranges[index[4, 4], index[6, 6]].tolist() == [3, 7, 5, 5, 2, 5, 2, 3]


@pytest.mark.parametrize("distance", [1.0, 4.0, 11.0, math.sqrt(2.0), 5.0 * math.sqrt(2.0)])
def test_chances_of_readings(distance: float) -> None:
    chances = laser_tag.reading_chances(np.array([distance]))[0]
    assert chances.sum() == pytest.approx(1.0, abs=1e-12)
    count = 40_000
    noise = 2.5 * np.random.default_rng(2).standard_normal(count)
    readings = np.floor(np.maximum(distance - np.abs(noise), 0.0)).astype(int)
    counts = np.bincount(readings, minlength=len(chances)) / count
    assert (np.abs(counts - chances) <= SIGMAS * np.sqrt(chances * (1.0 - chances) / count) + 1e-12).all()


def _pursuers(robot: int, opponent: int) -> np.ndarray:
    return np.array([robot, opponent, *[1.0 / len(FLOOR)] * len(FLOOR)])


def test_laser_tag_remembers_by_bayes() -> None:
    model = laser_tag.laser_tag(FLOOR)
    state, seen = _pursuers(20, 50), np.empty(8)
    model.observe(model.parameters, state, pursuit.EAST, seen, np.random.default_rng(8))
    others = [cell for cell in range(len(FLOOR)) if cell != 20]
    chances = np.array([model.likelihood(model.parameters, _pursuers(20, cell), pursuit.EAST, seen) for cell in others])
    said = state[laser_tag.CHANCES :][others]
    np.testing.assert_allclose(said / said.sum(), chances / chances.sum(), rtol=1e-9)
    copy = _pursuers(20, 50)
    model.likelihood(model.parameters, copy, pursuit.EAST, seen)
    np.testing.assert_array_equal(copy, state)


def test_laser_tag_observes_as_likely_as_it_says() -> None:
    model = laser_tag.laser_tag(FLOOR)
    state = _pursuers(FLOOR.index((4, 4)), FLOOR.index((6, 6)))
    rng, count = np.random.default_rng(3), 4000
    seen = np.empty((count, 8))
    for row in seen:
        model.observe(model.parameters, state, pursuit.EAST, row, rng)
    steps = np.array([3, 7, 5, 5, 2, 5, 2, 3]) * np.array([1.0] * 4 + [math.sqrt(2.0)] * 4)
    single = laser_tag.reading_chances(steps)
    expected = math.prod(single[beam, int(seen[0, beam])] for beam in range(8))
    assert model.likelihood(model.parameters, state, pursuit.EAST, seen[0]) == pytest.approx(expected)
    mean = single @ np.arange(single.shape[1])
    variance = single @ np.arange(single.shape[1]) ** 2 - mean**2
    assert (np.abs(seen.mean(axis=0) - mean) <= SIGMAS * np.sqrt(variance / count)).all()


def test_laser_tag_sees_the_opponent_in_its_own_cell() -> None:
    model = laser_tag.laser_tag(FLOOR)
    here, seen = _pursuers(7, 7), np.empty(8)
    model.observe(model.parameters, here, pursuit.EAST, seen, np.random.default_rng(0))
    assert (seen == -1.0).all()
    assert model.likelihood(model.parameters, here, pursuit.EAST, seen) == 1.0
    assert model.likelihood(model.parameters, _pursuers(7, 8), pursuit.EAST, seen) == 0.0


def test_random_floors() -> None:
    cells = laser_tag.random_cells(np.random.default_rng(4))
    assert len(set(cells)) == 77 - 8
    assert all(0 <= x < 11 and 0 <= y < 7 for x, y in cells)


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


def test_leaf_value_of_tag_is_what_the_default_policy_gets() -> None:
    model = tag.tag()
    rng = np.random.default_rng(7)
    starts = np.empty((4000, model.state_dim))
    for start in starts:
        model.initial(model.parameters, start, rng)
    assert model.leaf_value is not None
    values = np.array([model.leaf_value(model.parameters, start) for start in starts])
    differences = _returns_of_the_default_policy(model, starts) - values
    assert abs(differences.mean()) <= SIGMAS * differences.std(ddof=1) / math.sqrt(len(differences)) + 0.05


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
        "tag": (tag.tag(), [4.0, 9.0, *[1.0 / 29.0] * 29], [-1.0, *map(float, range(29))], pursuit.NORTH),
        "rock_sample": (
            rock_sample.rock_sample(7, 8),
            [3.0, 5.0, 1.0, *[0.5] * 8],
            [0.0, 1.0, 2.0],
            rock_sample.CHECK,
        ),
    }[name]


@pytest.mark.parametrize("name", ["tiger", "tag", "rock_sample"])
def test_likelihoods_of_all_observations_sum_to_one(name: str) -> None:
    model, state, observations, action = _discrete_observations(name)
    total = sum(model.likelihood(model.parameters, np.array(state), action, np.array([seen])) for seen in observations)
    assert total == pytest.approx(1.0)


@pytest.mark.parametrize("name", ["tiger", "rock_sample", "tag", "light_dark", "sub_hunt", "crossing"])
def test_twins_for_pomdp_py_behave_alike(name: str) -> None:
    """Mean next state and mean reward of compiled and plain model from the same states."""
    pytest.importorskip("pomdp_py")
    import random

    from problems.pomdp_py_models import python_model

    model = {
        "tiger": tiger.tiger,
        "rock_sample": rock_sample.rock_sample,
        "tag": tag.tag,
        "light_dark": light_dark.light_dark,
        "sub_hunt": sub_hunt.sub_hunt,
        "crossing": crossing,
    }[name]()
    twin = python_model(name, model)
    random.seed(8)
    rng, count = np.random.default_rng(8), 1500
    state, after = np.empty(model.state_dim), np.empty(model.state_dim)
    for action in range(model.action_count):
        differences = []
        for _ in range(count):
            model.initial(model.parameters, state, rng)
            if name == "crossing":  # near the car, where there is something to hit
                state[:3] = rng.uniform(-1.5, 0.5), 0.0, rng.uniform(-7.0, 1.0)
            if name == "sub_hunt":  # close together, anywhere in the bay, aware or not
                state[:2] = rng.integers(1, 21, 2)
                state[2:4] = np.clip(state[:2] + rng.integers(-2, 3, 2), 1, 20)
                state[5] = rng.integers(2)
            extra = (0.0,) if name == "crossing" else ()
            reward, terminal = model.step(model.parameters, state, action, after, rng)
            begin = (*state.tolist(), *extra)
            other = twin.transition(begin, action)
            ended = len(other) < model.state_dim or (name == "crossing" and other[5] != 0.0)
            differences.append([reward - twin.reward(begin, action, other), float(terminal) - float(ended)])
            if not terminal and not ended:
                differences[-1] += [a - b for a, b in zip(after, other, strict=False)]
            else:
                differences[-1] += [0.0] * model.state_dim
        table = np.array(differences)
        bound = SIGMAS * table.std(axis=0, ddof=1) / math.sqrt(count) + 1e-9
        assert (np.abs(table.mean(axis=0)) <= bound).all(), action


def test_planner_on_rock_sample_4_4(monkeypatch: pytest.MonkeyPatch) -> None:
    """The optimum is 18.0 (HSVI; Smith and Simmons 2004, table 1); leaving at once is worth 8.1."""
    from dataclasses import replace

    problem = PROBLEMS["rock_sample_7_8"]
    options = replace(problem.options, depth=25, particles=1000)
    small = replace(
        problem,
        make=lambda _seed: rock_sample.rock_sample(4, 4),
        planning_model=lambda: rock_sample.rock_sample(4, 4, advantages=True),
        options=options,
        moves=40,
    )
    monkeypatch.setitem(PROBLEMS, "rock_sample_4_4", small)
    values = np.array([run_episode("rock_sample_4_4", seed, 3000).value for seed in range(60)])
    error = values.std(ddof=1) / math.sqrt(len(values))
    assert values.mean() <= 18.04 + 3.5 * error
    assert values.mean() >= 15.0 - 3.5 * error
