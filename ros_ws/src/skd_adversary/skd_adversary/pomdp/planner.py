"""The search of a decision, compiled once per model, and its options: budget, depth, exploration, cells, backup.

POMCP over cells of observations: online tree search for listed actions and any observations.

A simulation follows one state, drawn from the belief, down the tree: UCB1 chooses actions, observations choose children
(POMCP, Silver and Veness, NIPS 2010). A continuous observation never comes twice, and a tree that makes a child of each
acts as if all were known one step ahead (QMDP; Sunberg and Kochenderfer, ICAPS 2018). So a node stands for a cell of
observations. Those that say nearly the same of the states share one (`Cells.LIKELIHOOD`), however far apart they are as
numbers: noise makes no cells. And children are widened progressively, at most k·N^α of them; beyond that an observation
goes to the child that is most alike.

A node's value is the mean over all that was tried there, as published: where leaves or rollouts see the state, the best
of an action's means is their optimism, and "ask later" always looks better than to ask. A new node's first try is the
default policy's.

`play` runs an episode in closed loop: decide, act, observe, update the belief. Why this planner: docs/decisions.md (1).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from skd_sim.kernels.compilation import bound, kernel, template, unbound
from skd_sim.kernels.stream import stream_of
from skd_sim.world.state import FloatArray

from skd_adversary.pomdp.belief import ParticleBelief, draw_sources
from skd_adversary.pomdp.model import Pomdp
from skd_adversary.pomdp.tree import (
    BLOCK,
    CHILDREN,
    FOUND,
    KNOWN,
    VALUE,
    VISITS,
    Float32Array,
    IndexArray,
    SearchTree,
    Tables,
    add_child,
    add_reference,
    best_mean,
    choose,
    clear_node,
    copy_subtree,
    empty_tree,
    exploration_from,
    forget_returns,
    most_alike_child,
    most_tried_mean,
    nearest_child,
    note_return,
    note_value,
    profile_of,
    set_profile,
    tables_of,
)


class Backup(IntEnum):
    """How the value of a node enters that of the node above it."""

    BEST = 0  # the best of its actions' means, as in ABT
    MEAN = 1  # the mean over all that was tried there, as in POMCP: exploration counts against it
    MOST_VISITED = 2  # the mean of the action tried most: a lucky first try does not count yet


class Cells(IntEnum):
    """Which observations share a node."""

    LIKELIHOOD = 0  # those that say nearly the same of the states
    NEAREST = 1  # those that are near each other, by Euclid


@dataclass(frozen=True)
class PlannerOptions:
    """Budget and shape of the search.

    Attributes:
        simulations: new simulations per decision: a count, never a time, so that results repeat.
        depth: longest look-ahead, steps.
        exploration: UCB1 constant, in units of reward; None: twice the mean absolute deviation of what an action of the
            root has returned in this decision, of the action for which that is greatest. See `tree`.
        observation_factor: k of the widening k·N^α; infinity: no limit but what `cells` asks for.
        observation_exponent: α of the widening.
        particles: size of the belief.
        backup: how the value of a node enters that of the node above it.
        keep_tree: whether the subtree of what was done and seen is kept for the next decision.
        cells: says which observations share a node.
        references: next states by whose likelihoods observations are distinguished (`Cells.LIKELIHOOD`).
        cell_distance: squared Hellinger distance of an observation's likelihoods from those of every cell that makes it
            a cell of its own (`Cells.LIKELIHOOD`).
    """

    simulations: int = 10_000
    depth: int = 25
    exploration: float | None = None
    observation_factor: float = 4.0
    observation_exponent: float = 0.25
    particles: int = 3000
    backup: Backup = Backup.MEAN
    keep_tree: bool = False
    cells: Cells = Cells.LIKELIHOOD
    references: int = 8
    cell_distance: float = 0.1

    @property
    def ucb_constant(self) -> float:
        """What the search takes for `exploration`."""
        return FOUND if self.exploration is None else self.exploration

    def __post_init__(self) -> None:
        for name in ("simulations", "depth", "particles", "references"):
            value = getattr(self, name)
            if value < 1 or value != int(value):
                raise ValueError(f"{name} must be a whole number of at least 1, got {value!r}")
        if self.exploration is not None and not self.exploration >= 0.0:
            raise ValueError(f"exploration must not be negative, got {self.exploration:g}")
        if not self.observation_factor > 0.0 or not 0.0 <= self.observation_exponent <= 1.0:
            raise ValueError("k·N^α needs observation_factor k > 0 and observation_exponent α in [0, 1]")


_step = _observe = _rollout_action = _leaf_value = _legal = unbound
_ACTIONS = _SEEN = 0
_HAS_LEAF_VALUE = _HAS_LEGAL = _BY_LIKELIHOOD = False
_BEST, _MEAN = int(Backup.BEST), int(Backup.MEAN)  # numba takes plain numbers


class SearchMemory(NamedTuple):
    """Memory of one simulation, for a model with states of s numbers, observations of d, and look-ahead h."""

    state: FloatArray  # s
    moved: FloatArray  # s
    observation: FloatArray  # d
    seen: Float32Array  # d: the observation, for distances
    path_node: IndexArray  # h
    path_action: IndexArray  # h
    path_reward: FloatArray  # h
    other_state: FloatArray  # s
    other_observation: FloatArray  # d
    likelihood: FloatArray  # m: of the observation in each reference state
    profile: Float32Array  # m
    returns: FloatArray  # actions × 3: what is kept of the decision's returns


@kernel(allocates=False)
def draw_roots(weights: FloatArray, roots: IndexArray, rng: np.random.Generator) -> None:
    """Draw a particle for each simulation, in random order."""
    draw_sources(weights, roots, rng)
    for i in range(roots.shape[0] - 1, 0, -1):
        j = int(rng.random() * (i + 1))
        roots[i], roots[j] = roots[j], roots[i]


@template(inline=False, allocates=False)
def _search(
    parameters: Any,
    leaf_parameters: Any,
    particles: FloatArray,
    roots: IndexArray,
    tree: SearchTree,
    node_count: int,
    tables: Tables,
    scratch: SearchMemory,
    exploration: float,
    discount: float,
    backup: int,
    cell_distance: float,
    rng: np.random.Generator,
) -> int:
    """Grow a tree of `node_count` nodes by one simulation per root particle; return the model steps made."""
    statistics, links = tree.statistics, tree.links
    state, moved, observation, seen = scratch.state, scratch.moved, scratch.observation, scratch.seen
    path_node, path_action, path_reward = scratch.path_node, scratch.path_action, scratch.path_reward
    likelihood, profile = scratch.likelihood, scratch.profile
    action_count = statistics.shape[1]
    if _ACTIONS > 0 and (action_count != _ACTIONS or seen.shape[0] != _SEEN):
        return -1  # never: it lets the compiler unroll the loops over them
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
            statistics[0, only, VALUE] = 0.0
            return steps
    forget_returns(scratch.returns)
    for i in range(roots.shape[0]):
        source = roots[i]
        for k in range(state.shape[0]):
            state[k] = particles[source, k]
        constant = exploration_from(exploration, scratch.returns)
        node = 0
        depth = 0
        tail = 0.0
        while depth < depth_limit:
            if tree.total[node] == 0:
                action = _rollout_action(parameters, state, rng)
            else:
                action = choose(tree, node, constant, tables, rng)
            reward, terminal = _step(parameters, state, action, moved, rng)
            steps += 1
            path_node[depth] = node
            path_action[depth] = action
            path_reward[depth] = reward
            depth += 1
            if terminal:
                break
            state, moved = moved, state  # to copy numbers that were written just now would wait for them
            _observe(parameters, state, action, observation, rng)
            for k in range(seen.shape[0]):
                seen[k] = observation[k]
            siblings = links[node, action, CHILDREN]
            known = 0
            if _BY_LIKELIHOOD:
                if siblings > 0:
                    known = tree.basis[node, action, KNOWN]
                    if known < profile.shape[0]:
                        add_reference(parameters, tree, node, action, state, scratch.other_observation)
                        known += 1
                    other = scratch.other_state
                    profile_of(parameters, tree, node, action, observation, other, likelihood, profile)
                child, apart = most_alike_child(tree, node, action, known, profile, seen)
                same = apart <= cell_distance and child >= 0
            else:
                child, apart = nearest_child(tree, node, action, seen)
                same = apart == 0.0
            room = siblings < tables.widening[min(int(statistics[node, action, VISITS]), last)]
            if same or not room or node_count == tree.total.shape[0]:
                node = child
                if node < 0:
                    break
                if _HAS_LEAF_VALUE and depth == depth_limit:
                    tail = _leaf_value(leaf_parameters, state)
                continue
            child = node_count
            node_count += 1
            clear_node(tree, child)
            if _HAS_LEGAL:
                _forbid(parameters, tree, child, state)
            add_child(tree, node, action, child, observation)
            if _BY_LIKELIHOOD:
                if siblings == 0:  # the oldest child's row holds the references
                    tree.basis[node, action, BLOCK] = child
                    tree.basis[node, action, KNOWN] = 0
                    add_reference(parameters, tree, node, action, state, scratch.other_observation)
                else:
                    for k in range(known):
                        tree.likelihood[child, k] = likelihood[k]
                    set_profile(tree, child, known)
            # --- the default policy from here on; its first action is the new node's first try
            first = -1
            if _HAS_LEAF_VALUE:
                if depth < depth_limit:
                    first = _rollout_action(parameters, state, rng)
                tail = _leaf_value(leaf_parameters, state)
            else:
                tail, first, made = _roll_out(parameters, state, moved, depth_limit - depth, discount, rng)
                steps += made
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
            note_value(tree, node, action, value)
            if level == 0 and exploration < 0.0:
                note_return(scratch.returns, action, value)
            if backup == _MEAN:
                continue
            value = float(best_mean(tree, node) if backup == _BEST else most_tried_mean(tree, node))
    return steps


@template
def _roll_out(
    parameters: Any, state: FloatArray, moved: FloatArray, steps: int, discount: float, rng: np.random.Generator
) -> tuple[float, int, int]:
    """Act by the default policy; both arrays are overwritten. Return (return, first action or −1, steps made)."""
    value, discounting = 0.0, 1.0
    first = -1
    made = 0
    while made < steps:
        action = int(_rollout_action(parameters, state, rng))
        if made == 0:
            first = action
        reward, terminal = _step(parameters, state, action, moved, rng)
        made += 1
        value += discounting * reward
        if terminal:
            break
        discounting *= discount
        state, moved = moved, state
    return value, first, made


@template
def _forbid(parameters: Any, tree: SearchTree, node: int, state: FloatArray) -> None:
    """Keep the search of a new node from actions that make no sense in its state."""
    for a in range(tree.statistics.shape[1]):
        if not _legal(parameters, state, a):
            tree.statistics[node, a, VISITS] = -1.0


_FUNCTIONS = ("_step", "_observe", "_rollout_action", "_leaf_value", "_legal", "_likelihood")


@functools.cache
def _search_kernel(name: str, actions: int, seen: int, *functions: Callable[..., Any] | None) -> Callable[..., Any]:
    """Return the search compiled around those of `_FUNCTIONS` that there are; with a likelihood, over cells of that."""
    given = {part: one for part, one in zip(_FUNCTIONS, functions, strict=True) if one is not None}
    parts = given | {
        "_ACTIONS": actions,
        "_SEEN": seen,
        "_HAS_LEAF_VALUE": "_leaf_value" in given,
        "_HAS_LEGAL": "_legal" in given,
        "_BY_LIKELIHOOD": "_likelihood" in given,
    }
    found: Callable[..., Any] = bound(_search, name, parts)
    return found


@functools.cache
def _profile_kernel(name: str, likelihood: Callable[..., Any]) -> Callable[..., Any]:
    found: Callable[..., Any] = bound(profile_of, name, {"_likelihood": likelihood})
    return found


class Planner:
    """Decides from a particle belief by tree search.

    Attributes:
        model_steps: steps of the model made so far, over all decisions.
    """

    def __init__(self, model: Pomdp, options: PlannerOptions, rng: np.random.Generator) -> None:
        """Prepare for `model`; all randomness of the search comes from `rng`."""
        self._by_likelihood = options.cells == Cells.LIKELIHOOD
        references = options.references if self._by_likelihood else 0
        nodes = 2 * options.simulations + 1  # half of them for what is kept
        tree, self._spare = (
            empty_tree(nodes, model.action_count, model.observation_dim, references, model.state_dim) for _ in range(2)
        )
        self._model = model
        self._options = options
        self._rng = stream_of(rng)
        self._tree = tree
        self._roots = np.zeros(options.simulations, np.uint32)
        self._returns = np.zeros((model.action_count, 3))
        self._search = _search_kernel(
            model.name,
            model.action_count,
            model.observation_dim,
            model.step,
            model.observe,
            model.rollout_action,
            model.leaf_value,
            model.legal,
            model.likelihood if self._by_likelihood else None,
        )
        self._origin = np.zeros(nodes, np.int32)
        self._tables = tables_of(nodes, options.observation_factor, options.observation_exponent)
        self._scratch = SearchMemory(
            state=np.empty(model.state_dim),
            moved=np.empty(model.state_dim),
            observation=np.empty(model.observation_dim),
            seen=np.empty(model.observation_dim, np.float32),
            path_node=np.empty(options.depth, np.uint32),
            path_action=np.empty(options.depth, np.uint32),
            path_reward=np.empty(options.depth),
            other_state=np.empty(model.state_dim),
            other_observation=np.empty(model.observation_dim),
            likelihood=np.empty(references),
            profile=np.empty(references, np.float32),
            returns=self._returns,
        )
        self._kept = 0  # nodes of the tree that `advance` has left
        self.model_steps = 0

    def plan(self, belief: ParticleBelief) -> int:
        """Return the action of highest estimated value at `belief`."""
        draw_roots(belief.weights, self._roots, self._rng)
        if self._kept == 0:  # then an action is taken without a search where no other is legal
            clear_node(self._tree, 0)
        options, model = self._options, self._model
        self.model_steps += self._search(
            model.parameters,
            model.leaves,
            belief.particles,
            self._roots,
            self._tree,
            max(1, self._kept),
            self._tables,
            self._scratch,
            options.ucb_constant,
            model.discount,
            int(options.backup),
            options.cell_distance,
            self._rng,
        )
        self._kept = 0
        best, decision = -math.inf, 0
        for action, (value, visits) in enumerate(self._tree.statistics[0].tolist()):  # for so few, faster than numpy
            if visits > 0.0 and value > best:
                best, decision = value, action
        return decision

    def advance(self, action: int, observation: FloatArray) -> None:
        """Keep of the tree what lies below an action that was taken and the observation made after it."""
        if not self._options.keep_tree:
            return
        child = self._child(action, observation)
        if child < 0:
            return
        self._kept = copy_subtree(self._tree, child, self._spare, self._options.simulations, self._origin)
        self._tree, self._spare = self._spare, self._tree

    def _child(self, action: int, observation: FloatArray) -> int:
        """Return the root's child whose cell an observation belongs to, −1 without a child."""
        tree, scratch, seen = self._tree, self._scratch, observation.astype(np.float32)
        if not self._by_likelihood:
            return int(nearest_child(tree, 0, action, seen)[0])
        if tree.links[0, action, CHILDREN] == 0:
            return -1
        _profile_kernel(self._model.name, self._model.likelihood)(
            self._model.parameters,
            tree,
            0,
            action,
            observation,
            scratch.other_state,
            scratch.likelihood,
            scratch.profile,
        )
        known = tree.basis[0, action, KNOWN]
        return int(most_alike_child(tree, 0, action, known, scratch.profile, seen)[0])

    @property
    def values(self) -> Float32Array:
        """Estimated value of each action at the last belief planned from."""
        values: Float32Array = np.where(self.visits > 0.0, self._tree.statistics[0, :, VALUE], np.float32(0.0))
        return values

    @property
    def visits(self) -> Float32Array:
        """Number of simulations through each action at the last belief planned from."""
        visits: Float32Array = np.maximum(self._tree.statistics[0, :, VISITS], 0.0)
        return visits

    @property
    def exploration(self) -> float:
        """UCB1's constant at the end of the last decision, in units of reward."""
        return float(exploration_from(self._options.ucb_constant, self._returns))


@dataclass(frozen=True)
class Played:
    """An episode that was played.

    Attributes:
        value: discounted return of the episode.
        actions: the actions that were taken, in order.
        ended: whether the model ended the episode, and not the limit of moves.
    """

    value: float
    actions: tuple[int, ...]
    ended: bool


def play(
    model: Pomdp, belief: ParticleBelief, planner: Planner, rng: np.random.Generator, *, moves: int = 1000
) -> Played:
    """Play an episode.

    Args:
        model: the world; the planner may plan with another model of the same states, such as one with leaf values.
        belief: belief at the beginning; it is updated in the episode.
        planner: chooses the actions; a policy with its methods `plan` and `advance` may take its place.
        rng: generator of what happens in the world.
        moves: greatest number of moves.

    Raises:
        ValueError: the belief is about states of another length.
    """
    if belief.particles.shape[1] != model.state_dim:
        raise ValueError(f"{model.name} has states of {model.state_dim} numbers, which the belief's have not")
    state, after, seen = np.empty(model.state_dim), np.empty(model.state_dim), np.empty(model.observation_dim)
    model.initial(model.parameters, state, rng)
    value, discount, ended = 0.0, 1.0, False
    actions: list[int] = []
    while not ended and len(actions) < moves:
        action = planner.plan(belief)
        actions.append(action)
        reward, ended = model.step(model.parameters, state, action, after, rng)
        value, discount, state[:] = value + discount * reward, discount * model.discount, after
        if not ended:
            model.observe(model.parameters, state, action, seen, rng)
            belief.predict(action)
            belief.correct(action, seen)
            planner.advance(action, seen)
    return Played(value, tuple(actions), bool(ended))
