"""Which of a node's children an observation belongs to.

By Euclid's distance (`nearest_child`), or by what it says: its profile is its likelihood in each of a few reference
states, made to sum up to 1, and two observations with the same profile tell the same of those states. The references of
an action are the first next states that the search saw after it. Profiles are compared by the Hellinger distance,
1 − Σ √(pᵢ qᵢ) being its square.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel, specialise, unbound

from skd_adversary.pomdp.search_tree import (
    BLOCK,
    CHILDREN,
    FIRST_CHILD,
    KNOWN,
    Float32Array,
    SearchTree,
)

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


def _profile_template(
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


def _add_reference_template(
    parameters: Any,
    tree: SearchTree,
    node: int,
    action: int,
    state: FloatArray,
    observation: FloatArray,
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


@functools.cache
def profile_kernel(name: str, likelihood: Callable[..., Any]) -> Callable[..., Any]:
    """Return the kernel that computes an observation's profile; see `_profile_template`."""
    return specialise(_profile_template, name, {"_likelihood": likelihood}, inline=True)


@functools.cache
def add_reference_kernel(name: str, likelihood: Callable[..., Any]) -> Callable[..., Any]:
    """Return the kernel that makes a state one of an action's references; see `_add_reference_template`."""
    return specialise(_add_reference_template, name, {"_likelihood": likelihood}, inline=True)
