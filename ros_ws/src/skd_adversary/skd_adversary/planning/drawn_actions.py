"""Actions that are drawn, not listed: a node's are widened progressively, as its observations are.

A node that was visited N times gets another at the next visit if it has no more than k·N^α (Couëtoux, Hoock,
Sokolovska, Teytaud and Bonnard, LION 2011; as in POMCPOW and PFT-DPW, Sunberg and Kochenderfer, ICAPS 2018). Each has a
slot in the tree; a slot that is not open yet is like an action that makes no sense. So whatever chooses among listed
actions chooses among these, and an action of the tree is the number of its slot: what the model's functions get is
taken from there.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel, specialise, unbound

from skd_adversary.planning.legality import forbid_kernel
from skd_adversary.planning.options import PlannerOptions
from skd_adversary.planning.pomdp import Action, Pomdp
from skd_adversary.planning.search_tree import VISITS, Int32Array, SearchTree
from skd_adversary.planning.ucb import tables_of

_draw = unbound


def slots_of(model: Pomdp, options: PlannerOptions, nodes: int) -> int:
    """Return for how many actions of a node there has to be room: listed ones, or as many as may be drawn."""
    return model.action_count or int(action_widening(options, nodes)[-1]) + 1


def action_widening(options: PlannerOptions, nodes: int) -> Int32Array:
    """Return k·N^α, at least 1, rounded down, of N = 0, 1, … visits."""
    return tables_of(nodes, options.action_factor, options.action_exponent).widening


def _close_all(parameters: Any, tree: SearchTree, node: int, state: FloatArray) -> None:
    tree.opened[node] = 0
    for slot in range(tree.statistics.shape[1]):
        tree.statistics[node, slot, VISITS] = -1.0


def _widen_template(
    parameters: Any,
    tree: SearchTree,
    node: int,
    depth: int,
    state: FloatArray,
    action: FloatArray,
    widening: Int32Array,
    rng: np.random.Generator,
) -> None:
    """Draw one more action where there may be one, of a state of the node; `action` is overwritten."""
    tried = tree.opened[node]
    if tried <= widening[min(tree.total[node], widening.shape[0] - 1)] and tried < tree.statistics.shape[1]:
        _draw(parameters, state, depth, tried, action, rng)
        for k in range(action.shape[0]):
            tree.drawn[node, tried, k] = action[k]
        tree.statistics[node, tried, VISITS] = 0.0
        tree.opened[node] = tried + 1


def _widen_nothing(
    parameters: Any,
    tree: SearchTree,
    node: int,
    depth: int,
    state: FloatArray,
    action: FloatArray,
    widening: Int32Array,
    rng: np.random.Generator,
) -> None:
    pass


def _take_drawn(tree: SearchTree, node: int, slot: int, action: FloatArray) -> FloatArray:
    for k in range(action.shape[0]):
        action[k] = tree.drawn[node, slot, k]
    return action


def _take_listed(tree: SearchTree, node: int, slot: int, action: FloatArray) -> int:
    return slot


@functools.cache
def action_kernels(
    name: str, draw_action: Callable[..., Any] | None, legal: Callable[..., Any] | None
) -> dict[str, Callable[..., Any]]:
    """Return what searches call, by the names that they call it by; where actions are listed, it costs nothing.

    `_forbid` (parameters, tree, node, state) begins a new node, `_widen` (parameters, tree, node, depth, state, action,
    widening, rng) opens another of its actions, and `_taken` (tree, node, slot, action) is what the model is given: the
    slot, or `action` with what was drawn in it.
    """
    if draw_action is None:
        return {
            "_forbid": forbid_kernel(name, legal),
            "_widen": kernel(inline=True)(_widen_nothing),
            "_taken": kernel(inline=True)(_take_listed),
        }
    return {
        "_forbid": kernel(inline=True)(_close_all),
        "_widen": specialise(_widen_template, name, {"_draw": draw_action}, inline=True),
        "_taken": kernel(inline=True)(_take_drawn),
    }


def action_in(model: Pomdp, tree: SearchTree, slot: int) -> Action:
    """Return an action of the root: its number, or what was drawn."""
    return slot if model.action_count else tree.drawn[0, slot].copy()
