"""The search tree as flat arrays, written once per decision and kept from one to the next."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel

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

    Cells by likelihood (`observation_cells`) have m reference states of s numbers for each (node, action) that has
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
