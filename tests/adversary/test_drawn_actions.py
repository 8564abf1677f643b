"""Planners of models whose actions are drawn, and velocities that road users can draw."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from models import tiger
from skd_adversary.model.car.basic import known_basic_car
from skd_adversary.model.composer import compose, road_user_interfaces
from skd_adversary.model.objective import paper
from skd_adversary.model.parts import RoadUserModel
from skd_adversary.model.road_user import car, child, cyclist, pedestrian
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.general.closed_loop import play
from skd_adversary.planning.general.model_check import ModelError, check_model
from skd_adversary.planning.general.pft_dpw import PftDpw, PftDpwOptions
from skd_adversary.planning.general.pomcpow import Pomcpow, PomcpowOptions
from skd_adversary.planning.options import Backup, Cells, PlannerOptions
from skd_adversary.planning.planner import Planner
from skd_adversary.planning.pomdp import Pomdp
from skd_adversary.planning.tree_planner import TreePlanner
from skd_sim.choices.actions import Actions
from skd_sim.encounter.scenario import load_scenario
from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import kernel

# --- A place on a line, N(2, 2²) at first, is moved by the action, then seen to within 0.1; a step costs its square


class LineParameters(NamedTuple):
    mean: float = 2.0
    spread: float = 2.0
    sigma: float = 0.1
    reach: float = 4.0


@kernel
def initial(p: LineParameters, state: np.ndarray, rng: np.random.Generator) -> None:
    state[0] = p.mean + p.spread * rng.standard_normal()


@kernel
def step(
    p: LineParameters, state: np.ndarray, action: np.ndarray, after: np.ndarray, rng: np.random.Generator
) -> tuple[float, bool]:
    after[0] = state[0] + action[0]
    return -after[0] * after[0], False


@kernel
def observe(
    p: LineParameters, state: np.ndarray, action: np.ndarray, seen: np.ndarray, rng: np.random.Generator
) -> None:
    seen[0] = state[0] + p.sigma * rng.standard_normal()


@kernel
def likelihood(p: LineParameters, state: np.ndarray, action: np.ndarray, seen: np.ndarray) -> float:
    error = (seen[0] - state[0]) / p.sigma
    return math.exp(-0.5 * error * error)


@kernel
def rollout_action(p: LineParameters, state: np.ndarray, action: np.ndarray, rng: np.random.Generator) -> None:
    action[0] = 0.0


@kernel
def draw_action(
    p: LineParameters, state: np.ndarray, depth: int, tried: int, action: np.ndarray, rng: np.random.Generator
) -> None:
    action[0] = p.reach * (2.0 * rng.random() - 1.0) if tried > 0 else 0.0


@kernel
def reinvigorate(
    p: LineParameters, state: np.ndarray, seen: np.ndarray, redrawn: np.ndarray, rng: np.random.Generator
) -> None:
    redrawn[0] = seen[0] + p.sigma * rng.standard_normal()


LINE = Pomdp(
    "test_line", 1, 1, 0, 0.9, LineParameters(), initial, step, observe, likelihood, rollout_action, reinvigorate,
    action_dim=1, draw_action=draw_action,
)  # fmt: skip
COMMON: dict[str, Any] = {"simulations": 3000, "depth": 2, "action_factor": 3.0, "action_exponent": 0.3}
MAKERS = {
    "cells": lambda rng, **more: Planner(LINE, PlannerOptions(**COMMON | more), rng),
    "nearest": lambda rng, **more: Planner(
        LINE, PlannerOptions(**COMMON | {"cells": Cells.NEAREST, "keep_tree": True} | more), rng
    ),
    "pomcpow": lambda rng, **more: Pomcpow(LINE, PomcpowOptions(**COMMON | more), rng),
    "pft": lambda rng, **more: PftDpw(LINE, PftDpwOptions(**COMMON | more), rng),
}


def _planned(name: str, seed: int, **more: Any) -> tuple[TreePlanner, ParticleBelief, np.ndarray]:
    rng = np.random.default_rng([7, seed])
    belief = ParticleBelief(LINE, 2000, rng)
    planner: TreePlanner = MAKERS[name](rng, **more)
    return planner, belief, planner.plan(belief)


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize(("factor", "exponent", "simulations"), [(3.0, 0.3, 3000), (2.0, 0.5, 1000), (7.5, 0.0, 50)])
def test_a_node_has_tried_as_many_actions_as_the_widening_says(
    name: str, factor: float, exponent: float, simulations: int
) -> None:
    """The last visit found N = simulations − 1 before it: one more action than k·N^α, rounded down."""
    planner, _, taken = _planned(
        name, 0, action_factor=factor, action_exponent=exponent, simulations=simulations, depth=1
    )
    root = planner.root()
    assert len(root) == math.floor(factor * (simulations - 1) ** exponent) + 1
    assert sum(row.visits for row in root) == simulations
    assert min(row.visits for row in root) >= 1
    drawn = [row.action[0] for row in root]
    assert drawn[0] == 0.0  # as the model has it
    assert all(-4.0 <= one <= 4.0 for one in drawn)
    assert len(set(drawn)) == len(drawn)
    assert taken.tolist() == max(root, key=lambda row: row.value).action.tolist()


@pytest.mark.parametrize("name", MAKERS)
def test_one_step_is_worth_what_it_is(name: str) -> None:
    """The value of an action a is −(2 + a)² − 4, by the variance of the belief; the best one drawn is taken.

    A mean of n squares of N(m, σ²) has a standard error of √((4 m² σ² + 2 σ⁴) / n). Where a look says where it is, as
    here, POMCPOW goes on drawing about the same reward in each of few children, and PFT-DPW has 20 particles in each.
    """
    planner, belief, taken = _planned(name, 1, depth=1)
    mean, spread = belief.moments(0)
    checked = 0
    for row in planner.root():
        off = mean + row.action[0]
        count = row.visits if name not in ("pft", "pomcpow") else len(row.cells) * (20 if name == "pft" else 1)
        error = math.sqrt((4.0 * off * off * spread**2 + 2.0 * spread**4) / count)
        if count >= 8:
            checked += 1
            assert abs(row.value + off * off + spread**2) <= 5.0 * error + 1e-4
    assert checked >= 5
    assert abs(taken[0] + mean) < 1.0


@pytest.mark.parametrize("name", MAKERS)
def test_two_steps_use_what_is_seen_between_them(name: str) -> None:
    """To the middle of the belief, which leaves its variance, and then to where the place was seen: nearly nothing.

    The optimum is to go −2 and then wherever the belief's mean is (certainty equivalence); of the squared place the
    first leaves 4, and the second 0.01, the variance after a look, 1/(1/2² + 1/0.1²). Who sees nothing in between is
    left with 4 again. An action is the best of about 30 in [−4, 4]: that leaves as much as 0.1.
    """
    first, left = [], []
    for seed in range(12):
        rng = np.random.default_rng([8, seed])
        belief, planner = ParticleBelief(LINE, 1000, rng), MAKERS[name](rng, observation_factor=8.0)
        state, after, seen = (np.empty(1) for _ in range(3))
        initial(LINE.parameters, state, rng)
        for _ in range(2):
            action = planner.plan(belief)
            first.append(action[0])
            step(LINE.parameters, state, action, after, rng)
            observe(LINE.parameters, after, action, seen, rng)
            belief.predict(action)
            belief.correct(action, seen)
            planner.advance(action, seen)
            state[:] = after
        left.append(float(after[0] ** 2))
    assert np.mean((np.array(first[::2]) + 2.0) ** 2) < 1.0
    assert np.mean(left) < 0.5


@pytest.mark.parametrize("name", MAKERS)
def test_same_generator_same_decisions(name: str) -> None:
    def once(seed: int) -> list[float]:
        rng = np.random.default_rng(seed)
        planner = MAKERS[name](rng, simulations=200)
        return [one[0] for one in play(LINE, ParticleBelief(LINE, 200, rng), planner, rng, moves=4).actions]

    assert once(1) == once(1) != once(2)


def test_a_kept_tree_knows_what_was_done() -> None:
    planner, belief, taken = _planned("nearest", 3, backup=Backup.BEST)
    (chosen,) = [row for row in planner.root() if row.action[0] == taken[0]]
    seen = max(chosen.cells, key=lambda cell: cell.visits)
    planner.advance(taken, seen.observation)
    assert planner.tree.total[0] > 0
    assert planner.tree.opened[0] > 0
    kept = planner.tree.drawn[0, : planner.tree.opened[0], 0].tolist()
    planner.plan(belief)
    assert [row.action[0] for row in planner.root()][: len(kept)] == kept


def test_models_say_either_how_many_actions_or_how_to_draw_them() -> None:
    check_model(LINE)
    for wrong in (
        {"action_count": 3},
        {"draw_action": None},
        {"action_dim": 0},
        {"legal": likelihood},
        {"action_value": likelihood},
    ):
        with pytest.raises(ValueError, match=r"action_count|draws its actions"):
            replace(LINE, **wrong)
    with pytest.raises(ValueError, match="action_dim"):
        replace(tiger(), action_dim=1)
    with pytest.raises(ValueError, match="action_factor"):
        PlannerOptions(action_factor=0.0)


@kernel
def draws_nothing(
    p: LineParameters, state: np.ndarray, depth: int, tried: int, action: np.ndarray, rng: np.random.Generator
) -> None:
    pass


@kernel
def acts_nowhere(p: LineParameters, state: np.ndarray, action: np.ndarray, rng: np.random.Generator) -> None:
    action[0] = math.inf


@kernel
def too_sure(p: LineParameters, state: np.ndarray, action: np.ndarray, seen: np.ndarray) -> float:
    error = (seen[0] - state[0]) / (0.2 * p.sigma)
    return math.exp(-0.5 * error * error)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"draw_action": draws_nothing}, "draw_action leaves entries"),
        ({"rollout_action": acts_nowhere}, "rollout_action leaves entries"),
        ({"likelihood": too_sure}, "likelihood is not the density"),
    ],
)
def test_mistakes_of_models_whose_actions_are_drawn(change: dict[str, Any], what: str) -> None:
    with pytest.raises(ModelError, match=what):
        check_model(replace(LINE, name=f"test_line_{next(iter(change))}", **change))


# --- road users

KINDS: list[tuple[str, RoadUserModel, tuple[float, ...]]] = [
    # What docs/decisions.md allows a kind, m/s²: speeding up, braking, to the side; radius of its tightest circle, m.
    ("cut_in", car.ROAD_USER, (2.5, 6.0, 4.0, 5.5)),
    ("cyclist", cyclist.ROAD_USER, (1.0, 3.0, 3.0, 0.0)),
    # On foot: its velocity changes by so much, in whatever direction.
    ("child", child.ROAD_USER, (2.0,)),
    ("crossing", pedestrian.ROAD_USER, (math.inf,)),
]


@pytest.mark.parametrize(("name", "kind", "limits"), KINDS, ids=[name for name, *_ in KINDS])
def test_what_a_road_user_draws_is_within_its_limits_and_comes_near_to_them(
    name: str, kind: RoadUserModel, limits: tuple[float, ...]
) -> None:
    scenario, predicted, rng = load_scenario(name), known_basic_car(1.0), np.random.default_rng(5)
    model = compose(scenario, paper.OBJECTIVE, predicted, start=(-3.5, 0.0), gap=13.0, road_user=kind)
    interfaces = road_user_interfaces(kind.kernels, predicted.kernels)
    draw, row, own = interfaces["draw_velocity"], interfaces["USER_ROW"], kind.kernels.own_dim
    state, step, most = np.zeros(model.state_dim), scenario.time_step, scenario.adversary.speed
    worst, nearest = -math.inf, {"up": -math.inf, "down": -math.inf, "left": -math.inf}
    for _ in range(2000):
        speed, heading = most * rng.random(), math.tau * rng.random()
        wheeled = len(limits) > 1
        before = speed * np.array([math.cos(heading), math.sin(heading)])
        state[row : row + own] = ((heading, speed) if wheeled else before)[:own]
        after = np.array(draw(model.parameters, state, rng))
        reached = math.hypot(*after)
        worst = max(worst, reached - most)
        if not wheeled:
            changed = math.hypot(*(after - before)) / step
            worst = max(worst, changed - limits[0])
            nearest["up"] = max(nearest["up"], changed / limits[0] if limits[0] < math.inf else reached / most)
            continue
        up, down, lateral, radius = limits
        turned = math.remainder(math.atan2(after[1], after[0]) - heading, math.tau) if reached > 1e-9 else 0.0
        allowed = min(
            math.radians(30.0), lateral * step / max(reached, 1e-9), reached * step / radius if radius else 1.0
        )
        worst = max(worst, (reached - speed) / step - up, (speed - reached) / step - down, abs(turned) - allowed)
        nearest["up"] = max(nearest["up"], (reached - speed) / step / up)
        nearest["down"] = max(nearest["down"], (speed - reached) / step / down)
        nearest["left"] = max(nearest["left"], turned / allowed if allowed > 0.0 else 0.0)
    assert worst <= 1e-6
    assert min(nearest[key] for key in (nearest if len(limits) > 1 else ["up"])) > 0.97


def test_a_kind_whose_actions_are_listed_alone_draws_none() -> None:
    listed = replace(cyclist.ROAD_USER, kernels=replace(cyclist.ROAD_USER.kernels, draw_velocity=None))
    with pytest.raises(UsageError, match=r"actions drawn: of a cyclist actions are listed alone; use listed"):
        compose(
            load_scenario("cyclist"), paper.OBJECTIVE, known_basic_car(1.0), start=(-3.5, 0.0), gap=13.0,
            road_user=listed, actions=Actions.DRAWN,
        )  # fmt: skip
