"""SubHunt written by the docs is the SubHunt of the benchmarks, in fewer than 80 lines.

The same luck gives the same states, observations and default actions, so whatever plans on it earns the same.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import sub_hunt as example
from problems.sub_hunt import sub_hunt
from skd_adversary.pomdp.model import check_model
from skd_adversary.pomdp.planner import PlannerOptions

THEIRS = sub_hunt()
OURS = example.model
EVERY = [
    np.array([own_x, own_y, x, y, goal, aware], float)
    for own_x, own_y in ((10, 10), (2, 19), (20, 1))
    for x in (1, 2, 9, 10, 12, 19)
    for y in (2, 8, 10, 11, 19)
    for goal in range(4)
    for aware in (0, 1)
]


def test_it_is_short() -> None:
    code = Path(example.__file__).read_text(encoding="utf-8").split('"""', 2)[2].splitlines()
    assert len([line for line in code if line.strip() and not line.strip().startswith("#")]) < 80


def test_nothing_is_wrong_with_it() -> None:
    check_model(OURS)


def test_steps_and_observations_are_the_same() -> None:
    """From the same luck; likelihoods in the same proportion."""
    after = [np.empty(6), np.empty(6)]
    seen = [np.empty(8), np.empty(8)]
    for number, state in enumerate(EVERY):
        for action in range(6):
            outcomes = []
            for which, model in enumerate((OURS, THEIRS)):
                rng = np.random.default_rng(number)
                outcomes.append(model.step(model.parameters, state.copy(), action, after[which], rng))
                model.observe(model.parameters, state.copy(), action, seen[which], rng)
            assert outcomes[0] == outcomes[1]
            if not outcomes[0][1]:
                assert after[0].tolist() == after[1].tolist()
            assert seen[0].tolist() == seen[1].tolist()
            own, other = (
                [model.likelihood(model.parameters, s, action, seen[0]) for s in (state, EVERY[number - 1])]
                for model in (OURS, THEIRS)
            )
            assert own[1] / own[0] == pytest.approx(other[1] / other[0], rel=1e-9, abs=1e-200)


def test_it_starts_and_goes_on_as_the_other() -> None:
    """The default policy and what is drawn when no particle explains what was seen are the same, too."""
    states = np.empty((2, 6))
    for seed, state in enumerate(EVERY):
        for row, model in zip(states, (OURS, THEIRS), strict=True):
            model.initial(model.parameters, row, np.random.default_rng(seed))
        assert states[0].tolist() == states[1].tolist()
        for row, model in zip(states, (OURS, THEIRS), strict=True):
            model.reinvigorate(model.parameters, state, np.zeros(8), row, np.random.default_rng(seed))
        assert states[0].tolist() == states[1].tolist()
        rng = np.random.default_rng(seed)
        assert OURS.rollout_action(OURS.parameters, state, rng) == THEIRS.rollout_action(THEIRS.parameters, state, rng)


def test_an_episode_of_it() -> None:
    """It is played to the end: a kill after 3 to 20 moves, or the target has crossed the bay."""
    options = PlannerOptions(simulations=300, depth=20, exploration=100.0, particles=500)
    value = example.episode(3, options)
    assert value == 0.0 or value in [pytest.approx(100.0 * 0.99**moves) for moves in range(20)]
