"""POMCPOW and PFT-DPW on problems with known optima, and what planners say of their root."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from models import (
    LISTEN,
    OPEN_LEFT,
    OPEN_RIGHT,
    TigerParameters,
    gaussian_likelihood,
    gaussian_observe,
    tiger,
)
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.general.pft_dpw import PftDpw, PftDpwOptions
from skd_adversary.planning.general.pomcpow import Pomcpow, PomcpowOptions, _collect, _drawn, _States
from skd_adversary.planning.general.tree_picture import tree_as_dot
from skd_adversary.planning.options import PlannerOptions
from skd_adversary.planning.planner import Planner
from skd_adversary.planning.pomdp import Pomdp
from skd_adversary.planning.tree_planner import TreePlanner
from skd_sim.kernels.compilation import kernel

GAMMA = 0.95
COMMON: dict[str, Any] = {"simulations": 2000, "depth": 10, "exploration": 60.0, "particles": 400}
MAKERS = {
    "cells": lambda model, rng, **more: Planner(model, PlannerOptions(**COMMON | more), rng),
    "pomcpow": lambda model, rng, **more: Pomcpow(model, PomcpowOptions(**COMMON | more), rng),
    "pft": lambda model, rng, **more: PftDpw(model, PftDpwOptions(node_particles=50, **COMMON | more), rng),
}


def _planner(name: str, model: Pomdp, p_right: float, seed: int, **more: Any) -> tuple[TreePlanner, ParticleBelief]:
    rng = np.random.default_rng([3, seed])
    belief = ParticleBelief(model, 400, rng)
    belief.particles[:, 0] = np.arange(400) < round(400 * p_right)
    belief.weights[:] = 1.0 / 400.0
    planner: TreePlanner = MAKERS[name](model, rng, **more)
    return planner, belief


def _worth_of_hearing(gaussian: bool) -> float:
    """Value of listening once from the even belief and then doing what is best; hearing as in the test below."""
    if not gaussian:
        return -1.0 + GAMMA * (0.97 * 10.0 - 0.03 * 100.0)
    heard = np.linspace(-5.0, 5.0, 4001)
    left, right = (np.exp(-0.5 * ((heard - centre) / 0.5) ** 2) for centre in (-1.0, 1.0))
    p_right, density = right / (left + right), 0.5 * (left + right) / (0.5 * math.sqrt(2.0 * math.pi))
    sure = np.maximum(p_right, 1.0 - p_right)
    best = np.maximum(10.0 * sure - 100.0 * (1.0 - sure), -1.0)
    return float(-1.0 + GAMMA * (density * best).sum() * (heard[1] - heard[0]))


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("gaussian", [False, True])
def test_asking_is_worth_what_the_answer_is_worth(name: str, gaussian: bool) -> None:
    """Two steps from the even belief: to listen and then to open wins 5; to open at once loses 45.

    It wins 7 where one hears better. Who takes the state for known after one step says −1 + γ·10 = 8.5; who cannot tell
    the answers apart says −1.95. Means stay below the optimum by what exploring costs.
    """
    optimum = _worth_of_hearing(gaussian)
    assert 4.0 < optimum < 8.0
    values = []
    for seed in range(5):
        more = {"depth": 2, "simulations": 8000, "exploration": 30.0}
        planner, belief = _planner(name, tiger(gaussian=gaussian, accuracy=0.97, sigma=0.5), 0.5, seed, **more)
        assert planner.plan(belief) == LISTEN
        values.append(float(planner.values[LISTEN]))
    error = np.std(values, ddof=1) / math.sqrt(5.0)
    assert 0.5 * optimum < np.mean(values) <= optimum + 4.0 * error


@pytest.mark.parametrize("name", MAKERS)
def test_values_of_one_step_are_the_expected_rewards(name: str) -> None:
    """P(right) = 0.6: listening −1; the left door 0.6 · 10 − 0.4 · 100 = −34, the right one −56."""
    planner, belief = _planner(name, tiger(), 0.6, 1, depth=1, simulations=6000)
    planner.plan(belief)
    for action, (expected, spread) in enumerate([(-1.0, 0.0), (-34.0, 54.0), (-56.0, 54.0)]):
        if planner.visits[action] >= 100:
            error = spread / math.sqrt(planner.visits[action])
            if name == "pft":  # a few beliefs of 50 particles are all that is ever drawn
                error = spread / math.sqrt(50.0)
            assert abs(planner.values[action] - expected) <= 4.5 * error + 1e-5
    assert planner.visits.sum() == 6000


@pytest.mark.parametrize("name", MAKERS)
def test_same_generator_same_decision(name: str) -> None:
    def once(seed: int) -> bytes:
        planner, belief = _planner(name, tiger(gaussian=True), 0.5, seed)
        planner.plan(belief)
        return planner.values.tobytes() + planner.visits.tobytes()

    assert once(1) == once(1) != once(2)


@kernel
def _observe_with_place(
    parameters: TigerParameters, state: np.ndarray, action: int, seen: np.ndarray, rng: np.random.Generator
) -> None:
    gaussian_observe(parameters, state, action, seen, rng)
    seen[1] = 0.1 * (1 + action)  # known for sure, and no number of single precision


@kernel
def _likelihood_with_place(parameters: TigerParameters, state: np.ndarray, action: int, seen: np.ndarray) -> float:
    return gaussian_likelihood(parameters, state, action, seen) if seen[1] == 0.1 * (1 + action) else 0.0


@pytest.mark.parametrize("name", MAKERS)
def test_what_is_known_for_sure_may_be_part_of_an_observation(name: str) -> None:
    """A likelihood of 0 where such a number is not quite equal makes no difference: it always is."""
    place = replace(
        tiger(gaussian=True),
        name="tiger_with_place",
        observation_dim=2,
        observe=_observe_with_place,
        likelihood=_likelihood_with_place,
    )
    values = []
    for model in (tiger(gaussian=True), place):
        planner, belief = _planner(name, model, 0.5, 5)
        planner.plan(belief)
        values.append(planner.values.tolist() + planner.visits.tolist())
    assert values[0] == values[1]


@kernel
def _shoot(p: float, state: np.ndarray, action: int, after: np.ndarray, rng: np.random.Generator) -> tuple[float, bool]:
    after[0] = state[0]
    return (10.0, True) if action == 0 and state[0] == 1.0 else (-1.0 * action, False)


@pytest.mark.parametrize("seen", [True, False])
def test_an_end_that_only_some_states_lead_to(seen: bool) -> None:
    """A shot ends the episode and is worth 10 where the target (probability 0.3) is there; a look costs 1.

    So a shot is worth 3 if it is the last step. With another step it is at most that, for a target that was not hit is
    not there, and at least 3 less a look where it was missed. A look and a shot are worth −1 + γ · 3 at most, whatever
    is seen in between.
    """
    model = replace(tiger(accuracy=0.8), name=f"shot_{seen}", step=_shoot, action_count=2)
    for depth, least in ((1, 3.0), (2, 3.0 - GAMMA * 0.7)):
        values = []
        for seed in range(8):
            more = {"depth": depth, "simulations": 4000, "ends_are_seen": seen}
            planner, belief = _planner("pomcpow", model, 0.3, seed, **more)
            planner.plan(belief)
            values.append(planner.values.copy())
        shoot, look = np.mean(values, axis=0)
        error = np.std(values, axis=0, ddof=1) / math.sqrt(8.0)
        assert error.max() < 0.5
        assert least - 5.0 * error[0] < shoot < 3.0 + 5.0 * error[0]
        if depth == 2:
            assert 0.0 < look < -1.0 + GAMMA * 3.0 + 5.0 * error[1]
        else:
            assert look == -1.0


def test_states_of_a_node_are_drawn_by_weight() -> None:
    count, rng = 200, np.random.default_rng(4)
    ints = lambda n: np.zeros(n, np.int32)  # noqa: E731
    states = _States(
        np.zeros((count, 1)),
        np.zeros(count),
        ints(count),
        np.zeros(count),
        *(ints(count) for _ in range(3)),
        *(ints(2) for _ in range(3)),
    )
    weights = rng.exponential(size=count) * (rng.random(count) < 0.7)
    weights[0] = 1.0
    node = np.arange(count) % 2  # two nodes, their entries mingled
    weights[1] = 1.0
    for entry in range(count):
        _collect(states, node[entry], entry, np.array([entry]), 0.5 * entry, 0, weights[entry], entry < 2)
    draws = 4_000
    for which in (0, 1):
        counts = np.bincount([_drawn(states, which, rng) for _ in range(draws)], minlength=count) / draws
        expected = np.where(node == which, weights, 0.0)
        expected /= expected.sum()
        assert (np.abs(counts - expected) <= 4.5 * np.sqrt(expected * (1.0 - expected) / draws) + 1e-12).all()


@pytest.mark.parametrize("name", MAKERS)
def test_the_root_says_what_was_tried_and_what_was_heard(name: str) -> None:
    planner, belief = _planner(name, tiger(), 0.5, 2)
    planner.plan(belief)
    root = planner.root()
    assert [row.action for row in root] == [LISTEN, OPEN_LEFT, OPEN_RIGHT]
    assert [row.visits for row in root] == planner.visits.tolist()
    assert [row.value for row in root] == planner.values.tolist()
    listen = root[LISTEN]
    # Returns lie within −110 and 200, and no spread is more than half of the range.
    assert 0.0 < listen.standard_error <= 155.0 / math.sqrt(listen.visits - 1)
    assert {cell.observation.tolist()[0] for cell in listen.cells} == {0.0, 1.0}
    if name != "pft":  # whose cells are of beliefs: several with the same observation
        assert len(listen.cells) == 2
    assert sum(cell.visits for cell in listen.cells) == listen.visits
    assert {cell.states for cell in listen.cells if cell.visits > 50} == {2}  # either tiger may be heard on either side


def test_the_root_of_an_untried_action() -> None:
    planner, belief = _planner("cells", tiger(), 0.5, 2, simulations=1)
    action = planner.plan(belief)
    for row in planner.root():
        assert row.visits == (row.action == action)
        assert math.isnan(row.standard_error)
        assert math.isnan(row.value) != (row.action == action)


def test_standard_errors_are_those_of_each_actions_own_returns() -> None:
    """With one step left a door is worth 10 or −100: its mean tells the share of either, and that the spread."""
    planner, belief = _planner("cells", tiger(), 0.5, 2, depth=1)
    smaller = ParticleBelief(tiger(), 100, np.random.default_rng(1))
    for one in (belief, smaller, belief):  # a belief may have another size than the one before
        planner.plan(one)
        listen, *doors = planner.root()
        assert listen.standard_error == 0.0
        for row in doors:
            share = (row.value + 100.0) / 110.0
            spread = 110.0 * math.sqrt(share * (1.0 - share) / (row.visits - 1))
            assert row.standard_error == pytest.approx(spread, rel=1e-4)


def test_picture_of_a_tree() -> None:
    planner, belief = _planner("cells", tiger(), 0.5, 2)
    planner.plan(belief)
    dot = tree_as_dot(planner.tree, actions=["listen", "left", "right"], depth=1)
    assert dot.count("{") == dot.count("}") == 1
    assert f"listen: {planner.values[LISTEN]:.1f}\\n{int(planner.visits[LISTEN])} visits" in dot
    assert dot.count(" -> ") == 3 + sum(len(row.cells) for row in planner.root())
    assert len(tree_as_dot(planner.tree, depth=2)) > len(dot)
    assert tree_as_dot(planner.tree, depth=2, least_visits=10**9).count(" -> ") == 3
    with pytest.raises(ValueError, match="3 actions, got 2 names"):
        tree_as_dot(planner.tree, actions=["a", "b"])


def test_a_belief_without_particles() -> None:
    with pytest.raises(ValueError, match="node_particles 0"):
        PftDpwOptions(node_particles=0)


def test_cells_without_references() -> None:
    with pytest.raises(ValueError, match="at least one reference"):
        PlannerOptions(references=0)
