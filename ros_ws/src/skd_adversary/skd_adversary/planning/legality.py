"""What a search does not try: actions that make no sense in a node."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel, specialise, unbound

from skd_adversary.planning.search_tree import VISITS, SearchTree

_legal = unbound


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
