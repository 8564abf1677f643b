"""The search itself: one compiled function per model, which runs all simulations of a decision without allocation."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel, specialise, unbound

from skd_adversary.pomdp.learning_rollouts import learning_rollout_kernel
from skd_adversary.pomdp.observation_cells import (
    add_reference_kernel,
    most_alike_child,
    nearest_child,
    profile_kernel,
    set_profile,
)
from skd_adversary.pomdp.options import Backup
from skd_adversary.pomdp.pomdp import Pomdp
from skd_adversary.pomdp.rollouts import rollout_kernel
from skd_adversary.pomdp.search_tree import (
    BLOCK,
    CHILDREN,
    KNOWN,
    VALUE,
    VISITS,
    Float32Array,
    IndexArray,
    Int32Array,
    SearchTree,
    add_child,
    best_mean,
    clear_node,
    most_tried_mean,
    note_value,
)
from skd_adversary.pomdp.ucb import Tables, choose, exploration_from, forget_returns, note_return

_step = _observe = _leaf_value = _legal = _forbid = unbound
_first_try = _profile = _add_reference = _rollout = unbound
_ACTIONS = _SEEN = 0
_HAS_LEAF_VALUE = _HAS_LEGAL = _BY_LIKELIHOOD = False
_BEST, _MEAN = int(Backup.BEST), int(Backup.MEAN)  # numba takes plain numbers


class Scratch(NamedTuple):
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
    notes: Any  # of rollouts: an `Experience`
    returns: FloatArray  # actions × 3: what is kept of the decision's returns


class RootLog(NamedTuple):
    """What each of the last decision's simulations did at the root."""

    action: Int32Array
    value: FloatArray  # return from the root, as backed up
    cell: Int32Array  # child that the simulation went on in; −1: the episode ended


@kernel(allocates=False)
def draw_roots(weights: FloatArray, roots: IndexArray, rng: np.random.Generator) -> None:
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


def _search_template(
    parameters: Any,
    leaf_parameters: Any,
    particles: FloatArray,
    roots: IndexArray,
    tree: SearchTree,
    node_count: int,
    tables: Tables,
    scratch: Scratch,
    log: RootLog,
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
    elif tree.total[0] == 0:
        _forbid(parameters, tree, 0, state)
    forget_returns(scratch.returns)
    for i in range(roots.shape[0]):
        source = roots[i]
        for k in range(state.shape[0]):
            state[k] = particles[source, k]
        constant = exploration_from(exploration, scratch.returns)
        log.cell[i] = -1
        node = 0
        depth = 0
        tail = 0.0
        while depth < depth_limit:
            if tree.total[node] == 0:
                action = _first_try(parameters, state, rng)
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
                        _add_reference(parameters, tree, node, action, state, scratch.other_observation)
                        known += 1
                    other = scratch.other_state
                    _profile(parameters, tree, node, action, observation, other, likelihood, profile)
                child, apart = most_alike_child(tree, node, action, known, profile, seen)
                same = apart <= cell_distance and child >= 0
            else:
                child, apart = nearest_child(tree, node, action, seen)
                same = apart == 0.0
            room = siblings < tables.widening[min(int(statistics[node, action, VISITS]), last)]
            if same or not room or node_count == tree.total.shape[0]:
                if depth == 1:
                    log.cell[i] = child
                node = child
                if node < 0:
                    break
                if _HAS_LEAF_VALUE and depth == depth_limit:
                    tail = _leaf_value(leaf_parameters, state)
                continue
            child = node_count
            node_count += 1
            clear_node(tree, child)
            _forbid(parameters, tree, child, state)
            add_child(tree, node, action, child, observation)
            if depth == 1:
                log.cell[i] = child
            if _BY_LIKELIHOOD:
                if siblings == 0:  # the oldest child's row holds the references
                    tree.basis[node, action, BLOCK] = child
                    tree.basis[node, action, KNOWN] = 0
                    _add_reference(parameters, tree, node, action, state, scratch.other_observation)
                else:
                    for k in range(known):
                        tree.likelihood[child, k] = likelihood[k]
                    set_profile(tree, child, known)
            # --- the default policy from here on; its first action is the new node's first try
            first = -1
            if _HAS_LEAF_VALUE:
                if depth < depth_limit:
                    first = _first_try(parameters, state, rng)
                tail = _leaf_value(leaf_parameters, state)
            else:
                tail, first, made, _ = _rollout(
                    parameters, state, moved, scratch.notes, depth_limit - depth, discount, rng
                )
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
            if level == 0:
                log.action[i] = action
                log.value[i] = value
            if backup == _MEAN:
                continue
            value = float(best_mean(tree, node) if backup == _BEST else most_tried_mean(tree, node))
        if exploration < 0.0:
            note_return(scratch.returns, log.action[i], log.value[i])
    return steps


def search_kernel(model: Pomdp, by_likelihood: bool, learns: bool) -> Callable[..., Any]:
    """Return the search compiled around a model's functions."""
    likelihood = model.likelihood if by_likelihood else None
    return _search_kernel(
        model.name,
        model.step,
        model.observe,
        model.rollout_action,
        model.leaf_value,
        model.legal,
        likelihood,
        learns,
        model.action_count,
        model.observation_dim,
    )


@functools.cache
def _search_kernel(
    name: str,
    step: Callable[..., Any],
    observe: Callable[..., Any],
    rollout_action: Callable[..., Any],
    leaf_value: Callable[..., Any] | None,
    legal: Callable[..., Any] | None,
    likelihood: Callable[..., Any] | None,
    learns: bool,
    actions: int,
    seen: int,
) -> Callable[..., Any]:
    bound: dict[str, Any] = {
        "_step": step,
        "_observe": observe,
        "_first_try": rollout_action,
        "_ACTIONS": actions,
        "_SEEN": seen,
        "_forbid": forbid_kernel(name, legal),
    }
    if leaf_value is not None:
        name += "_leaves"
        bound |= {"_leaf_value": leaf_value, "_HAS_LEAF_VALUE": True}
    elif learns:
        bound |= {"_rollout": learning_rollout_kernel(name, step, rollout_action, legal)}
        name += "_learns"
    else:
        bound |= {"_rollout": rollout_kernel(name, step, rollout_action)}
    if legal is not None:
        bound |= {"_legal": legal, "_HAS_LEGAL": True}
    if likelihood is not None:
        bound |= {
            "_BY_LIKELIHOOD": True,
            "_profile": profile_kernel(name, likelihood),
            "_add_reference": add_reference_kernel(name, likelihood),
        }
        name += "_by_likelihood"
    return specialise(_search_template, name, bound, allocates=False)


def _forbid_template(parameters: Any, tree: SearchTree, node: int, state: FloatArray) -> None:
    """Keep the search of a new node from actions that make no sense in its state."""
    for a in range(tree.statistics.shape[1]):
        if not _legal(parameters, state, a):
            tree.statistics[node, a, VISITS] = -1.0


def _allow_all(parameters: Any, tree: SearchTree, node: int, state: FloatArray) -> None:
    pass


@functools.cache
def forbid_kernel(name: str, legal: Callable[..., Any] | None) -> Callable[..., Any]:
    """Return the kernel (parameters, tree, node, state) that keeps a new node from actions that make no sense there."""
    if legal is None:
        return kernel(inline=True)(_allow_all)
    return specialise(_forbid_template, name, {"_legal": legal}, inline=True)
