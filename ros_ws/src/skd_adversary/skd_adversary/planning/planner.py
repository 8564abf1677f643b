"""POMCP with nearest-observation widening: online tree search for discrete actions and any observations.

A simulation follows one state, drawn from the belief, down the tree: UCB1 chooses actions, observations choose children
(POMCP, Silver and Veness, NIPS 2010). A continuous observation never comes twice, and a tree that makes a child of each
acts as if all were known one step ahead (QMDP; Sunberg and Kochenderfer, ICAPS 2018). So children are widened
progressively, at most k·N^α of them, and beyond that an observation goes to the child whose own is nearest: a node then
stands for a cell of observations, which can be told apart from the others.

A node's value is, by default, the best of its actions' means, as in ABT, not the mean over all that was tried there; a
new node's first try is the default policy's. The subtree of the action taken and the observation made is kept.

docs/decisions.md says why this planner.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from skd_sim.compilation import kernel, specialise

from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.pomdp import FloatArray, Pomdp
from skd_adversary.planning.search_tree import (
    CHILDREN,
    FIRST_CHILD,
    VALUE,
    VISITS,
    Float32Array,
    Int32Array,
    SearchTree,
    clear_node,
    copy_subtree,
    empty_tree,
    nearest_child,
)


def _unbound(*_arguments: Any) -> Any:
    raise NotImplementedError("bound to the model's kernel by `specialise`")


_step = _observe = _rollout_action = _leaf_value = _legal = _unbound
_HAS_LEAF_VALUE = _HAS_LEGAL = False


class Backup(IntEnum):
    """What a node is worth to the node above it."""

    BEST = 0  # the best of its actions' means, as in ABT
    MEAN = 1  # the mean over all that was tried there, as in POMCP: exploration counts against it
    MOST_VISITED = 2  # the mean of the action tried most: a lucky first try does not count yet


_BEST, _MEAN = int(Backup.BEST), int(Backup.MEAN)  # numba takes plain numbers


@dataclass(frozen=True)
class PlannerOptions:
    """Budget and shape of the search.

    Attributes:
        simulations: new simulations per decision: a count, never a time, so that results repeat.
        depth: longest look-ahead, steps.
        exploration: UCB1 constant, in units of reward.
        observation_factor: k of the widening k·N^α; infinity: every observation gets a child of its own.
        observation_exponent: α of the widening.
        particles: size of the belief.
        backup: what a node is worth to the node above it.
        keep_tree: whether the subtree of what was done and seen is kept for the next decision.
    """

    simulations: int = 1000
    depth: int = 25
    exploration: float = 1.0
    observation_factor: float = 4.0
    observation_exponent: float = 0.25
    particles: int = 300
    backup: Backup = Backup.BEST
    keep_tree: bool = True


class _Tables(NamedTuple):
    """Functions of a number of visits, looked up rather than computed; the last entry stands for all beyond."""

    root_log: Float32Array  # √ln N
    inverse_root: Float32Array  # 1 / √N
    widening: Int32Array  # k·N^α, at least 1


@functools.cache
def _tables(size: int, factor: float, exponent: float) -> _Tables:
    count = np.maximum(np.arange(size), 1)
    widening = np.minimum(factor * count**exponent, np.iinfo(np.int32).max)
    return _Tables(
        root_log=np.sqrt(np.log(count)).astype(np.float32),
        inverse_root=(1.0 / np.sqrt(count)).astype(np.float32),
        widening=np.maximum(widening, 1).astype(np.int32),
    )


class _Scratch(NamedTuple):
    """Memory of one simulation, for a model with states of s numbers, observations of d, and look-ahead h."""

    state: FloatArray  # s
    moved: FloatArray  # s
    observation: FloatArray  # d
    seen: Float32Array  # d: the observation as the tree keeps it
    path_node: Int32Array  # h
    path_action: Int32Array  # h
    path_reward: FloatArray  # h


@kernel(allocates=False)
def _draw_roots(weights: FloatArray, roots: Int32Array, rng: np.random.Generator) -> None:
    """Draw a particle for each simulation, systematically, in random order: each gets the share that is its due."""
    count = roots.shape[0]
    offset = rng.random()
    cumulative = weights[0]
    source = 0
    for i in range(count):
        position = (i + offset) / count
        while cumulative < position and source < weights.shape[0] - 1:
            source += 1
            cumulative += weights[source]
        roots[i] = source
    for i in range(count - 1, 0, -1):
        j = int(rng.random() * (i + 1))
        roots[i], roots[j] = roots[j], roots[i]


@kernel(inline=True)
def _choose(tree: SearchTree, node: int, exploration: float, tables: _Tables, rng: np.random.Generator) -> int:
    """Return the action by UCB1; the untried come first, starting at a random one."""
    statistics = tree.statistics
    action_count = statistics.shape[1]
    last = tables.root_log.shape[0] - 1
    total = tree.total[node]
    scale = np.float32(exploration) * tables.root_log[min(total, last)]
    best = np.float32(-np.inf)
    action = 0
    untried = 0
    for a in range(action_count):
        count = int(statistics[node, a, VISITS])
        if count < 0:  # makes no sense here
            continue
        if count == 0:
            untried += 1
            continue
        score = statistics[node, a, VALUE] + scale * tables.inverse_root[min(count, last)]
        if score > best:
            best = score
            action = a
    if untried > 0:
        pick = int(rng.random() * untried)
        for a in range(action_count):
            if statistics[node, a, VISITS] == 0.0:
                if pick == 0:
                    return a
                pick -= 1
    return action


def _search_template(
    parameters: Any,
    particles: FloatArray,
    roots: Int32Array,
    tree: SearchTree,
    node_count: int,
    tables: _Tables,
    scratch: _Scratch,
    exploration: float,
    discount: float,
    backup: int,
    rng: np.random.Generator,
) -> int:
    """Grow a tree of `node_count` nodes by one simulation per root particle; return the model steps made."""
    statistics, links = tree.statistics, tree.links
    state, moved, observation, seen, path_node, path_action, path_reward = scratch
    action_count = statistics.shape[1]
    depth_limit = path_node.shape[0]
    last = tables.widening.shape[0] - 1
    steps = 0

    if _HAS_LEGAL and tree.total[0] == 0:
        for k in range(state.shape[0]):
            state[k] = particles[roots[0], k]
        choices = 0
        only = 0
        for a in range(action_count):
            statistics[0, a, VISITS] = -1.0
            if _legal(parameters, state, a):
                statistics[0, a, VISITS] = 0.0
                choices += 1
                only = a
        if choices == 1:  # no search finds another
            statistics[0, only, VISITS] = 1.0
            return steps
    for i in range(roots.shape[0]):
        for k in range(state.shape[0]):
            state[k] = particles[roots[i], k]
        node = 0
        depth = 0
        tail = 0.0
        while depth < depth_limit:
            if tree.total[node] == 0:
                action = _rollout_action(parameters, state, rng)
            else:
                action = _choose(tree, node, exploration, tables, rng)
            reward, terminal = _step(parameters, state, action, moved, rng)
            steps += 1
            path_node[depth] = node
            path_action[depth] = action
            path_reward[depth] = reward
            depth += 1
            if terminal:
                break
            for k in range(state.shape[0]):
                state[k] = moved[k]
            _observe(parameters, state, action, observation, rng)
            for k in range(seen.shape[0]):
                seen[k] = observation[k]
            child, apart = nearest_child(tree, node, action, seen)
            known = links[node, action, CHILDREN]
            room = known < tables.widening[min(int(statistics[node, action, VISITS]), last)]
            if apart == 0.0 or not room or node_count == tree.total.shape[0]:
                node = child
                if node < 0:
                    break
                if _HAS_LEAF_VALUE and depth == depth_limit:
                    tail = _leaf_value(parameters, state)
                continue
            child = node_count
            node_count += 1
            clear_node(tree, child)
            if _HAS_LEGAL:
                for a in range(action_count):
                    if not _legal(parameters, state, a):
                        statistics[child, a, VISITS] = -1.0
            for k in range(seen.shape[0]):
                tree.observation[child, k] = seen[k]
            tree.sibling[child] = links[node, action, FIRST_CHILD]
            links[node, action, FIRST_CHILD] = child
            links[node, action, CHILDREN] = known + 1
            # --- the default policy from here on; its first action is the new node's first try
            first = -1
            if _HAS_LEAF_VALUE:
                if depth < depth_limit:
                    first = _rollout_action(parameters, state, rng)
                tail = _leaf_value(parameters, state)
            else:
                discounting = 1.0
                for _ in range(depth, depth_limit):
                    action = _rollout_action(parameters, state, rng)
                    if first < 0:
                        first = action
                    reward, terminal = _step(parameters, state, action, moved, rng)
                    steps += 1
                    tail += discounting * reward
                    if terminal:
                        break
                    discounting *= discount
                    for k in range(state.shape[0]):
                        state[k] = moved[k]
            if first >= 0:
                tree.total[child] = 1
                statistics[child, first, VISITS] = 1.0
                statistics[child, first, VALUE] = tail
            break
        # --- backup
        value = tail
        for level in range(depth - 1, -1, -1):
            node, action = path_node[level], path_action[level]
            value = path_reward[level] + discount * value
            tree.total[node] += 1
            count = statistics[node, action, VISITS] + np.float32(1.0)
            statistics[node, action, VISITS] = count
            statistics[node, action, VALUE] += (np.float32(value) - statistics[node, action, VALUE]) / count
            if backup == _MEAN:
                continue
            most = np.float32(0.0)
            best = np.float32(-np.inf)
            for a in range(action_count):
                tried = statistics[node, a, VISITS]
                mean = statistics[node, a, VALUE]
                if backup == _BEST:
                    if tried > 0.0 and mean > best:
                        best = mean
                elif tried > most or (tried == most and tried > 0.0 and mean > best):
                    most = tried
                    best = mean
            value = float(best)
    return steps


@functools.cache
def _search_kernel(
    name: str,
    step: Callable[..., Any],
    observe: Callable[..., Any],
    rollout_action: Callable[..., Any],
    leaf_value: Callable[..., Any] | None,
    legal: Callable[..., Any] | None,
) -> Callable[..., Any]:
    bound: dict[str, Any] = {"_step": step, "_observe": observe, "_rollout_action": rollout_action}
    if leaf_value is not None:
        bound |= {"_leaf_value": leaf_value, "_HAS_LEAF_VALUE": True}
    if legal is not None:
        bound |= {"_legal": legal, "_HAS_LEGAL": True}
    return specialise(_search_template, name, bound, allocates=False)


class Planner:
    """Decides from a particle belief by tree search.

    Attributes:
        model_steps: steps of the model made so far, over all decisions.
    """

    def __init__(self, model: Pomdp, options: PlannerOptions, rng: np.random.Generator) -> None:
        """Prepare for `model`; all randomness of the search comes from `rng`."""
        if options.simulations < 1 or options.depth < 1:
            raise ValueError("a planner needs at least one simulation and a depth of one")
        self._model = model
        self._options = options
        self._rng = rng
        self._search = _search_kernel(
            model.name, model.step, model.observe, model.rollout_action, model.leaf_value, model.legal
        )
        nodes = 2 * options.simulations + 1  # half of them for what is kept
        self._tree = empty_tree(nodes, model.action_count, model.observation_dim)
        self._spare = empty_tree(nodes, model.action_count, model.observation_dim)
        self._origin = np.zeros(nodes, np.int32)
        self._roots = np.zeros(options.simulations, np.int32)
        self._tables = _tables(nodes, options.observation_factor, options.observation_exponent)
        self._scratch = _Scratch(
            state=np.empty(model.state_dim),
            moved=np.empty(model.state_dim),
            observation=np.empty(model.observation_dim),
            seen=np.empty(model.observation_dim, np.float32),
            path_node=np.empty(options.depth, np.int32),
            path_action=np.empty(options.depth, np.int32),
            path_reward=np.empty(options.depth),
        )
        self._kept = 0  # nodes of the tree that `advance` has left
        self.model_steps = 0

    def plan(self, belief: ParticleBelief) -> int:
        """Return the action of highest estimated value at `belief`, from what `advance` kept or from nothing.

        Where nothing was kept and but one action is legal, it is that one, without a search.
        """
        if self._kept == 0:
            clear_node(self._tree, 0)
        options = self._options
        _draw_roots(belief.weights, self._roots, self._rng)
        steps = self._search(
            self._model.parameters,
            belief.particles,
            self._roots,
            self._tree,
            max(1, self._kept),
            self._tables,
            self._scratch,
            options.exploration,
            self._model.discount,
            int(options.backup),
            self._rng,
        )
        self.model_steps += steps
        self._kept = 0
        return int(np.argmax(np.where(self.visits > 0, self.values, -np.inf)))

    def advance(self, action: int, observation: FloatArray) -> None:
        """Keep of the tree what lies below an action that was taken and the observation made after it."""
        child, _ = nearest_child(self._tree, 0, action, observation.astype(np.float32))
        if child < 0 or not self._options.keep_tree:
            return
        self._kept = copy_subtree(self._tree, child, self._spare, self._options.simulations, self._origin)
        self._tree, self._spare = self._spare, self._tree

    @property
    def values(self) -> Float32Array:
        """Estimated value of each action at the last belief planned from."""
        values: Float32Array = self._tree.statistics[0, :, VALUE]
        return values

    @property
    def visits(self) -> Float32Array:
        """Number of simulations through each action at the last belief planned from."""
        visits: Float32Array = np.maximum(self._tree.statistics[0, :, VISITS], 0.0)
        return visits
