"""The search tree as flat arrays: its nodes, which action to try (UCB1), which child an observation belongs to.

UCB1 (Auer, Cesa-Bianchi and Fischer, Machine Learning 47, 2002) has a constant in units of reward. Where none is given,
it is `_DEVIATIONS` times the mean absolute deviation of what an action of the root returned in this decision, of the
action for which that is greatest. Every action counts, however seldom it is tried: else a search that settles on an
action whose return is certain would find ever less reason to try others. What sets actions apart counts for nothing, so
one that is always a catastrophe does not hide what the others are worth, as it would in the range of the returns. A
catastrophe that seldom happens counts with its share, of which a standard deviation would take the root.

An observation belongs to the nearest child by Euclid (`nearest_child`), or to the one that says the same: its profile
is its likelihood in each of a few reference states, made to sum up to 1, and two observations with the same profile
tell the same of those states. The references of an action are the first next states that the search saw after it.
Profiles are compared by the Hellinger distance, 1 − Σ √(pᵢ qᵢ) being its square.
"""

from __future__ import annotations

import functools
import math
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.kernels.compilation import kernel, template, unbound
from skd_sim.world.state import FloatArray

Float32Array = npt.NDArray[np.float32]
Int32Array = npt.NDArray[np.int32]
IndexArray = npt.NDArray[np.uint32]
"""Numbers that index others. Without a sign: kernels need not see to what a negative index would mean."""

VALUE, VISITS = range(2)
CHILDREN, FIRST_CHILD = range(2)
BLOCK, KNOWN = range(2)


class SearchTree(NamedTuple):
    """Arrays of a tree of at most n nodes, a actions each, observations of d numbers. Node 0 is the root.

    A node is a history. What belongs to one (node, action) lies side by side, so that choosing an action reads one or
    two cache lines; single precision keeps it so, and its rounding is far below the noise of a mean of returns. Visits
    are exact up to 2²⁴.

    Cells by likelihood have m reference states of s numbers for each (node, action) that has
    children; they stand in the row of its oldest child. Elsewhere m = 0.
    """

    statistics: Float32Array  # n × a × 2: mean return, −∞ without any; number of visits
    links: IndexArray  # n × a × 2: number of children, first of them
    sibling: IndexArray  # n: next child of the same action
    total: Int32Array  # n: visits of all actions
    observation: FloatArray  # n × d: that led here, in full: a likelihood may be 0 where a number is not quite equal
    basis: Int32Array  # n × a × 2: row of the reference states, number of them so far
    references: FloatArray  # n × m × s: reference states
    likelihood: FloatArray  # n × m: of this node's observation in the reference states of the action that led here
    profile: Float32Array  # n × m: square roots of the same, made to sum up to 1


def empty_tree(nodes: int, actions: int, observation_dim: int, references: int = 0, state_dim: int = 0) -> SearchTree:
    """Return a tree that holds nothing but an unvisited root."""
    return SearchTree(
        statistics=np.zeros((nodes, actions, 2), np.float32),
        links=np.zeros((nodes, actions, 2), np.uint32),
        sibling=np.zeros(nodes, np.uint32),
        total=np.zeros(nodes, np.int32),
        observation=np.zeros((nodes, observation_dim)),
        basis=np.zeros((nodes if references else 0, actions, 2), np.int32),
        references=np.zeros((nodes, references, state_dim)),
        likelihood=np.zeros((nodes, references)),
        profile=np.zeros((nodes, references), np.float32),
    )


@kernel(inline=True)
def clear_node(tree: SearchTree, node: int) -> None:
    """Make a node unvisited and childless."""
    for action in range(tree.statistics.shape[1]):
        tree.statistics[node, action, VALUE] = -np.inf
        tree.statistics[node, action, VISITS] = 0.0
        tree.links[node, action, CHILDREN] = 0
    tree.total[node] = 0


@kernel(inline=True)
def note_value(tree: SearchTree, node: int, action: int, value: float) -> None:
    """Note what an action of a node returned once more: its visits and its mean return."""
    count = tree.statistics[node, action, VISITS] + np.float32(1.0)
    before = tree.statistics[node, action, VALUE] if count > 1.0 else np.float32(0.0)
    tree.statistics[node, action, VISITS] = count
    tree.statistics[node, action, VALUE] = before + (np.float32(value) - before) / count


@kernel(inline=True)
def best_mean(tree: SearchTree, node: int) -> np.float32:
    """Return the greatest mean return of a node's actions that were tried."""
    best = np.float32(-np.inf)
    for action in range(tree.statistics.shape[1]):
        mean = tree.statistics[node, action, VALUE]
        best = mean if mean > best else best
    return best


@kernel(inline=True)
def most_tried_mean(tree: SearchTree, node: int) -> np.float32:
    """Return the mean return of the action that was tried most; of several such, the greatest."""
    most = np.float32(0.0)
    best = np.float32(-np.inf)
    for action in range(tree.statistics.shape[1]):
        tried = tree.statistics[node, action, VISITS]
        mean = tree.statistics[node, action, VALUE]
        if tried > most or (tried == most and tried > 0.0 and mean > best):
            most = tried
            best = mean
    return best


@kernel(inline=True)
def add_child(tree: SearchTree, node: int, action: int, child: int, observation: FloatArray) -> None:
    """Hang a node below an action of another, as its newest child."""
    for k in range(observation.shape[0]):
        tree.observation[child, k] = observation[k]
    tree.sibling[child] = tree.links[node, action, FIRST_CHILD]
    tree.links[node, action, FIRST_CHILD] = child
    tree.links[node, action, CHILDREN] += 1


@kernel
def copy_subtree(tree: SearchTree, root: int, kept: SearchTree, room: int, origin: Int32Array) -> int:
    """Copy the subtree under `root` to the front of another tree, level by level while there is room.

    Children of an action then stand in the opposite order, which decides ties between them.

    Args:
        tree: the tree that is copied from.
        root: node that becomes node 0.
        kept: the tree that is copied to, and overwritten.
        room: nodes to copy at most, ≥ 1.
        origin: scratch, one entry per node of `kept`.

    Returns:
        Number of nodes copied.
    """
    origin[0] = root
    count = 1
    done = 0
    while done < count:
        old = origin[done]
        kept.total[done] = tree.total[old]
        for action in range(tree.statistics.shape[1]):
            kept.statistics[done, action, VALUE] = tree.statistics[old, action, VALUE]
            kept.statistics[done, action, VISITS] = tree.statistics[old, action, VISITS]
            children = 0
            candidate = tree.links[old, action, FIRST_CHILD]
            for _ in range(tree.links[old, action, CHILDREN]):
                if count < room:
                    origin[count] = candidate
                    kept.sibling[count] = kept.links[done, action, FIRST_CHILD] if children else 0
                    kept.links[done, action, FIRST_CHILD] = count
                    for k in range(tree.observation.shape[1]):
                        kept.observation[count, k] = tree.observation[candidate, k]
                    for k in range(tree.profile.shape[1]):
                        kept.likelihood[count, k] = tree.likelihood[candidate, k]
                        kept.profile[count, k] = tree.profile[candidate, k]
                    children += 1
                    count += 1
                candidate = tree.sibling[candidate]
            kept.links[done, action, CHILDREN] = children
            if children and tree.profile.shape[1]:
                _copy_basis(tree, old, action, kept, done, count - 1)
        done += 1
    return count


@kernel
def _copy_basis(tree: SearchTree, old: int, action: int, kept: SearchTree, node: int, row: int) -> None:
    source = tree.basis[old, action, BLOCK]
    kept.basis[node, action, BLOCK] = row
    kept.basis[node, action, KNOWN] = tree.basis[old, action, KNOWN]
    for i in range(tree.basis[old, action, KNOWN]):
        for k in range(tree.references.shape[2]):
            kept.references[row, i, k] = tree.references[source, i, k]


FOUND: Final = -1.0
"""Stands for an exploration that the search finds itself."""
_DEVIATIONS: Final = 2.0
RETURNS, MEAN, DEVIATIONS = range(3)
"""What is kept of an action's returns: their number, mean, sum of absolute deviations from the mean so far."""


class Tables(NamedTuple):
    """Functions of a number of visits, looked up rather than computed; the last entry stands for all beyond."""

    root_log: Float32Array  # √ln N
    inverse_root: Float32Array  # 1 / √N
    widening: Int32Array  # k·N^α, at least 1


@functools.cache
def tables_of(size: int, factor: float, exponent: float) -> Tables:
    """Return tables for trees of so many nodes."""
    count = np.maximum(np.arange(size), 1)
    widening = np.minimum(factor * count**exponent, np.iinfo(np.int32).max)
    return Tables(
        root_log=np.sqrt(np.log(count)).astype(np.float32),
        inverse_root=(1.0 / np.sqrt(count)).astype(np.float32),
        widening=np.maximum(widening, 1).astype(np.int32),
    )


@kernel(inline=True)
def forget_returns(seen: FloatArray) -> None:
    """Begin a decision."""
    for action in range(seen.shape[0]):
        for k in range(seen.shape[1]):
            seen[action, k] = 0.0


@kernel(inline=True)
def note_return(seen: FloatArray, action: int, value: float) -> None:
    """Note what a simulation returned at the root, and which action it began with."""
    seen[action, RETURNS] += 1.0
    seen[action, MEAN] += (value - seen[action, MEAN]) / seen[action, RETURNS]
    seen[action, DEVIATIONS] += abs(value - seen[action, MEAN])


@kernel(inline=True)
def exploration_from(given: float, seen: FloatArray) -> float:
    """Return UCB1's constant: the given one, or, where that is `FOUND`, from the returns so far.

    It is 1 while no action has returned two different numbers.
    """
    if given >= 0.0:
        return given
    most = 0.0
    for action in range(seen.shape[0]):
        if seen[action, RETURNS] > 0.0:
            most = max(most, seen[action, DEVIATIONS] / seen[action, RETURNS])
    return _DEVIATIONS * most if most > 0.0 else 1.0


@kernel(inline=True)
def choose(tree: SearchTree, node: int, exploration: float, tables: Tables, rng: np.random.Generator) -> int:
    """Return the action by UCB1; the untried come first, starting at a random one."""
    statistics = tree.statistics
    action_count = statistics.shape[1]
    last = tables.root_log.shape[0] - 1
    total = tree.total[node]
    scale = np.float32(exploration) * tables.root_log[min(total, last)]
    best = np.float32(-np.inf)
    action = 0
    untried = 0
    for a in range(action_count):  # without branches: which actions were tried, and which is best, is no pattern
        count = int(statistics[node, a, VISITS])  # negative: makes no sense here
        untried += 1 if count == 0 else 0
        score = statistics[node, a, VALUE] + scale * tables.inverse_root[max(0, min(count, last))]  # −∞: not tried
        action = a if score > best else action
        best = score if score > best else best
    if untried > 0:
        pick = int(rng.random() * untried)
        for a in range(action_count):
            if statistics[node, a, VISITS] == 0.0:
                if pick == 0:
                    return a
                pick -= 1
    return action


_likelihood = unbound


_SMALLEST: Final = float(np.finfo(np.float64).tiny)  # of likelihoods that explain: 1 / total is to be a finite number


@kernel(inline=True)
def nearest_child(tree: SearchTree, node: int, action: int, observation: Float32Array) -> tuple[int, float]:
    """Return (child whose observation is nearest, squared Euclidean distance to it); (−1, infinity) without a child."""
    nearest = -1
    least = np.float32(np.inf)
    candidate = tree.links[node, action, FIRST_CHILD]
    for _ in range(tree.links[node, action, CHILDREN]):
        apart = np.float32(0.0)
        for k in range(observation.shape[0]):
            delta = np.float32(tree.observation[candidate, k]) - observation[k]
            apart += delta * delta
        if apart < least:
            least = apart
            nearest = candidate
        candidate = tree.sibling[candidate]
    return nearest, float(least)


@kernel(inline=True)
def most_alike_child(
    tree: SearchTree, node: int, action: int, known: int, profile: Float32Array, observation: Float32Array
) -> tuple[int, float]:
    """Return (child whose profile is most like an observation's, squared Hellinger distance between the two).

    Where no reference state explains what was seen, it is the nearest child by Euclid, at distance 1.
    """
    alike = -1
    most = np.float32(0.0)
    candidate = tree.links[node, action, FIRST_CHILD]
    for _ in range(tree.links[node, action, CHILDREN]):
        overlap = np.float32(0.0)
        for k in range(known):
            overlap += tree.profile[candidate, k] * profile[k]
        if overlap > most:
            most = overlap
            alike = candidate
        candidate = tree.sibling[candidate]
    if alike < 0:
        alike, _ = nearest_child(tree, node, action, observation)
    return alike, 1.0 - float(most)


@kernel(inline=True)
def set_profile(tree: SearchTree, child: int, known: int) -> None:
    """Compute a child's profile from its likelihoods."""
    total = 0.0
    for k in range(known):
        total += tree.likelihood[child, k]
    scale = 1.0 / total if total >= _SMALLEST else 0.0
    for k in range(known):
        tree.profile[child, k] = math.sqrt(tree.likelihood[child, k] * scale)


@template
def profile_of(
    parameters: Any,
    tree: SearchTree,
    node: int,
    action: int,
    observation: FloatArray,
    reference: FloatArray,
    likelihood: FloatArray,
    profile: Float32Array,
) -> None:
    """Compute likelihoods and profile of an observation made after an action; `reference` is scratch for a state."""
    known = tree.basis[node, action, KNOWN]
    row = tree.basis[node, action, BLOCK]
    total = 0.0
    for i in range(known):
        for k in range(reference.shape[0]):
            reference[k] = tree.references[row, i, k]
        likelihood[i] = _likelihood(parameters, reference, action, observation)
        total += likelihood[i]
    scale = 1.0 / total if total >= _SMALLEST else 0.0
    for i in range(known):
        profile[i] = math.sqrt(likelihood[i] * scale)


@template
def add_reference(
    parameters: Any, tree: SearchTree, node: int, action: int, state: FloatArray, observation: FloatArray
) -> None:
    """Make a state one of an action's references, for the children that there are, too; `observation` is scratch."""
    known = tree.basis[node, action, KNOWN]
    row = tree.basis[node, action, BLOCK]
    for k in range(state.shape[0]):
        tree.references[row, known, k] = state[k]
    candidate = tree.links[node, action, FIRST_CHILD]
    for _ in range(tree.links[node, action, CHILDREN]):
        for k in range(observation.shape[0]):
            observation[k] = tree.observation[candidate, k]
        tree.likelihood[candidate, known] = _likelihood(parameters, state, action, observation)
        set_profile(tree, candidate, known + 1)
        candidate = tree.sibling[candidate]
    tree.basis[node, action, KNOWN] = known + 1
