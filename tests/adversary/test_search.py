"""The search, simulation by simulation, against one that is written for reading: nodes are objects, not rows of arrays.

Both draw the same random numbers in the same order, so every visit and every mean must agree, whatever the options.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from models import ring, tiger
from skd_adversary import ParticleBelief, Planner, PlannerOptions, Pomdp
from skd_adversary.pomdp.planner import Backup, Cells
from skd_sim.kernels.compilation import kernel

F32 = np.float32


@dataclass
class Arm:
    """One action at a history."""

    legal: bool = True
    visits: int = 0
    mean: Any = field(default_factory=lambda: F32(0.0))
    children: list[tuple[Any, Node]] = field(default_factory=list)
    references: list[Any] = field(default_factory=list)


@dataclass
class Node:
    arms: list[Arm]
    visits: int = 0


class ReadableSearch:
    """POMCP over cells of observations, as the module docstring of the planner says it."""

    def __init__(self, model: Pomdp, options: PlannerOptions, rng: np.random.Generator) -> None:
        self.model, self.options, self.rng = model, options, rng
        self.root: Node | None = None
        self.nodes = 0
        self.steps = 0
        self.returned: list[tuple[int, float, float]] = []  # this decision's, by action: number, mean, deviations

    def plan(self, belief: ParticleBelief) -> int:
        count = self.options.simulations
        cumulative = np.cumsum(belief.weights)
        offset = self.rng.random()
        roots = [min(int((cumulative < (i + offset) / count).sum()), len(cumulative) - 1) for i in range(count)]
        for i in reversed(range(1, count)):
            j = int(self.rng.random() * (i + 1))
            roots[i], roots[j] = roots[j], roots[i]
        if self.root is None:
            self.root, self.nodes = self.new_node(None), 1
        self.returned = [(0, 0.0, 0.0)] * self.model.action_count
        for source in roots:
            if self.root.visits == 0 and self.model.legal is not None:
                self.root = self.new_node(belief.particles[source])
            self.simulate(belief.particles[source].copy())
        tried = [(arm.mean, -number) for number, arm in enumerate(self.root.arms) if arm.visits > 0]
        return -max(tried)[1]

    def advance(self, action: int, observation: Any) -> None:
        arm = self.root.arms[action]
        if not arm.children or not self.options.keep_tree:
            self.root = None
        elif self.options.cells == Cells.LIKELIHOOD:
            self.root = self.most_alike(arm, action, observation)[0]
        else:
            self.root = self.nearest(arm.children, observation.astype(F32))[0]
        self.keep_what_there_is_room_for()

    def keep_what_there_is_room_for(self) -> None:
        """Half of the nodes, level by level; children then stand in the opposite order, which decides ties."""
        kept = [] if self.root is None else [self.root]
        for node in kept:
            for arm in node.arms:
                room = self.options.simulations - len(kept)
                arm.children = arm.children[::-1][: max(room, 0)]
                kept += [child for _, child in arm.children]
                if not arm.children:
                    arm.references.clear()
        self.nodes = len(kept)

    def new_node(self, state: Any) -> Node:
        model = self.model
        legal = [
            state is None or model.legal is None or bool(model.legal(model.parameters, state, action))
            for action in range(model.action_count)
        ]
        return Node([Arm(one) for one in legal])

    def nearest(self, children: list[tuple[Any, Node]], seen: Any) -> tuple[Node, float]:
        apart = [float(((one.astype(F32) - seen) ** 2).sum(dtype=F32)) for one, _ in children]
        # The newest is looked at first, and wins a tie.
        best = min(range(len(children)), key=lambda k: (apart[k], -k))
        return children[best][1], apart[best]

    def profile(self, arm: Arm, action: int, observation: Any) -> Any:
        """What an observation says of the reference states, as shares of 1."""
        model = self.model
        likelihoods = np.array([model.likelihood(model.parameters, s, action, observation) for s in arm.references])
        total = likelihoods.sum()
        # A sum that is no normal number says no more than 0: its reciprocal is infinite.
        return likelihoods / total if total >= np.finfo(float).tiny else np.zeros_like(likelihoods)

    def most_alike(self, arm: Arm, action: int, observation: Any) -> tuple[Node, float]:
        ours = np.sqrt(self.profile(arm, action, observation)).astype(F32)
        overlaps = []
        for seen, _ in arm.children:
            theirs = np.sqrt(self.profile(arm, action, seen)).astype(F32)
            overlap = F32(0.0)
            for one, other in zip(theirs, ours, strict=True):
                overlap += one * other
            overlaps.append(float(overlap))
        best = min(range(len(overlaps)), key=lambda k: (-overlaps[k], -k))
        if overlaps[best] == 0.0:
            return self.nearest(arm.children, observation.astype(F32))[0], 1.0
        return arm.children[best][1], 1.0 - overlaps[best]

    def cell(self, arm: Arm, action: int, state: Any, observation: Any) -> tuple[Node | None, bool]:
        """Return the child that an observation belongs to, and whether that is where it has to go."""
        if self.options.cells == Cells.LIKELIHOOD:
            if len(arm.references) < self.options.references:
                arm.references.append(state.copy())
            if not arm.children:
                return None, False
            child, apart = self.most_alike(arm, action, observation)
            return child, apart <= self.options.cell_distance
        child, apart = self.nearest(arm.children, observation.astype(F32)) if arm.children else (None, math.inf)
        return child, apart == 0.0

    def exploration(self) -> float:
        """Twice the mean absolute deviation of an action's returns so far, the greatest; 1 where there is none."""
        if self.options.exploration is not None:
            return self.options.exploration
        return 2.0 * max(deviations / max(number, 1) for number, _, deviations in self.returned) or 1.0

    def choose(self, node: Node, state: Any) -> int:
        if node.visits == 0:
            return int(self.model.rollout_action(self.model.parameters, state, self.rng))
        untried = [number for number, arm in enumerate(node.arms) if arm.legal and arm.visits == 0]
        if untried:
            return untried[int(self.rng.random() * len(untried))]
        most = 2 * self.options.simulations  # visits that count, of a tree that was kept again and again
        scale = F32(self.exploration()) * F32(math.sqrt(math.log(min(node.visits, most))))
        scores = [
            (arm.mean + scale * F32(1.0 / math.sqrt(min(arm.visits, most))), -number)
            for number, arm in enumerate(node.arms)
            if arm.legal
        ]
        return -max(scores)[1]

    def step(self, state: Any, action: int) -> tuple[float, bool, Any]:
        after = np.empty_like(state)
        reward, terminal = self.model.step(self.model.parameters, state, action, after, self.rng)
        self.steps += 1
        return reward, terminal, after

    def simulate(self, state: Any) -> None:
        model, options = self.model, self.options
        node: Node | None = self.root
        path: list[tuple[Node, int, float]] = []
        tail = 0.0
        while node is not None and len(path) < options.depth:
            action = self.choose(node, state)
            reward, terminal, after = self.step(state, action)
            path.append((node, action, reward))
            if terminal:
                break
            state = after
            observation = np.empty(model.observation_dim)
            model.observe(model.parameters, state, action, observation, self.rng)
            arm = node.arms[action]
            most = max(
                1, int(min(options.observation_factor * max(1, arm.visits) ** options.observation_exponent, 2e9))
            )
            child, same = self.cell(arm, action, state, observation)
            if same or len(arm.children) >= most or self.nodes == 2 * options.simulations + 1:
                node = child
                if node is not None and model.leaf_value is not None and len(path) == options.depth:
                    tail = model.leaf_value(model.parameters, state)
                continue
            child = self.new_node(state)
            arm.children.append((observation, child))
            self.nodes += 1
            first, tail = self.roll_out(state, len(path))
            if first is not None:
                child.visits = child.arms[first].visits = 1
                child.arms[first].mean = F32(tail)
            break
        value = self.back_up(path, tail)
        number, mean, deviations = self.returned[path[0][1]]
        mean += (value - mean) / (number + 1)
        self.returned[path[0][1]] = number + 1, mean, deviations + abs(value - mean)

    def roll_out(self, state: Any, depth: int) -> tuple[int | None, float]:
        model, first = self.model, None
        if model.leaf_value is not None:
            if depth < self.options.depth:
                first = int(model.rollout_action(model.parameters, state, self.rng))
            return first, model.leaf_value(model.parameters, state)
        value, weight = 0.0, 1.0
        for _ in range(self.options.depth - depth):
            action = int(model.rollout_action(model.parameters, state, self.rng))
            first = action if first is None else first
            reward, terminal, state = self.step(state, action)
            value += weight * reward
            if terminal:
                break
            weight *= model.discount
        return first, value

    def back_up(self, path: list[tuple[Node, int, float]], tail: float) -> float:
        value = gained = tail
        for node, action, reward in reversed(path):
            value = gained = reward + self.model.discount * value
            node.visits += 1
            arm = node.arms[action]
            arm.visits += 1
            arm.mean = arm.mean + (F32(value) - arm.mean) / F32(arm.visits)
            tried = [one for one in node.arms if one.visits > 0]
            if self.options.backup == Backup.BEST:
                value = float(max(one.mean for one in tried))
            elif self.options.backup == Backup.MOST_VISITED:
                value = float(max(tried, key=lambda one: (one.visits, one.mean)).mean)
        return gained


@kernel
def ring_value(parameters: Any, state: Any) -> float:
    return -0.1 * state[0]


@kernel
def ring_legal(parameters: Any, state: Any, action: int) -> bool:
    return action != 2


@kernel
def ring_reward_step(parameters: Any, state: Any, action: int, after: Any, rng: np.random.Generator) -> Any:
    after[0] = state[0]
    if rng.random() < parameters.forward:
        after[0] = (state[0] + action) % parameters.cells
    return float(after[0]) - 0.3 * action, after[0] == 0.0 and rng.random() < parameters.stop


@kernel
def ring_any_rollout(parameters: Any, state: Any, rng: np.random.Generator) -> int:
    return 1 if rng.random() < 0.7 else 3


RING = replace(ring(), name="test_search_ring", step=ring_reward_step, rollout_action=ring_any_rollout)
MODELS = {
    "tiger": tiger(),
    "gaussian": tiger(gaussian=True),
    "ring": RING,
    "bounded": replace(RING, name="test_search_bounded", leaf_value=ring_value, legal=ring_legal, discount=0.8),
}
SMALL = PlannerOptions(
    simulations=150, depth=6, exploration=8.0, particles=40, backup=Backup.BEST, cells=Cells.NEAREST, keep_tree=True
)
OPTIONS = {
    "nearest": SMALL,
    "mean": replace(SMALL, backup=Backup.MEAN),
    "most-visited": replace(SMALL, backup=Backup.MOST_VISITED),
    "one-step": replace(SMALL, depth=1),
    "narrow": replace(SMALL, depth=2, observation_factor=1.0, observation_exponent=0.6),
    "no-widening": replace(SMALL, observation_factor=math.inf, simulations=60),
    "default": PlannerOptions(simulations=150, depth=6, particles=40),
    "one-reference": replace(SMALL, cells=Cells.LIKELIHOOD, references=1, cell_distance=0.0),
    "many-references": replace(SMALL, cells=Cells.LIKELIHOOD, observation_factor=1.0, references=20),
}


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_every_visit_and_every_mean_is_that_of_the_readable_search(name: str, options: PlannerOptions) -> None:
    model = MODELS[name]
    rng, other = np.random.default_rng(5), np.random.default_rng(5)
    planner = Planner(model, options, rng)
    readable = ReadableSearch(model, options, other)
    belief = ParticleBelief(model, options.particles, np.random.default_rng(6))
    belief.weights[:] = np.random.default_rng(7).dirichlet(np.full(options.particles, 0.4))
    for decision in range(3):
        action = planner.plan(belief)
        assert action == readable.plan(belief)
        assert planner.visits.tolist() == [arm.visits for arm in readable.root.arms]
        assert planner.values.tolist() == [float(arm.mean) for arm in readable.root.arms]
        assert planner.model_steps == readable.steps
        assert rng.random() == other.random()
        heard = np.array([0.3 * decision])
        planner.advance(action, heard)
        readable.advance(action, heard)
