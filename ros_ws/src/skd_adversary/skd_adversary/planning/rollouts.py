"""The expected return beyond the tree: a leaf's value, or the return of a rollout from there."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel, specialise, unbound

_step = _rollout_action = _act = _number = _note = _rollout = _leaf_value = unbound
_HAS_LEAF_VALUE = False


def _roll_out_template(
    parameters: Any,
    state: FloatArray,
    moved: FloatArray,
    notes: Any,
    steps: int,
    discount: float,
    rng: np.random.Generator,
) -> tuple[float, int, int, bool]:
    """Act by a rule from a state; both arrays are overwritten.

    Where the episode goes on, its last state is in `state` after an even number of steps, and in `moved` after an odd
    one. `notes` are the rule's own. Returns (return, number of the first action or −1, steps made, whether the episode
    ended).
    """
    value, discounting = 0.0, 1.0
    first = -1
    made = 0
    terminal = False
    while made < steps:
        action = _act(parameters, state, notes, made, rng)
        if made == 0:
            first = _number(action)
        reward, terminal = _step(parameters, state, action, moved, rng)
        _note(notes, made, action, reward)
        made += 1
        value += discounting * reward
        if terminal:
            break
        discounting *= discount
        state, moved = moved, state
    return value, first, made, terminal


def _default_act_template(parameters: Any, state: FloatArray, notes: Any, made: int, rng: np.random.Generator) -> int:
    return int(_rollout_action(parameters, state, rng))


def _drawn_act_template(
    parameters: Any, state: FloatArray, notes: FloatArray, made: int, rng: np.random.Generator
) -> FloatArray:
    _rollout_action(parameters, state, notes, rng)
    return notes


def _listed_number(action: int) -> int:
    return action


def _no_number(action: FloatArray) -> int:
    return -1


def no_note(notes: Any, made: int, action: int, reward: float) -> None:
    """Note nothing."""


def _tail_template(
    parameters: Any,
    leaf_parameters: Any,
    state: FloatArray,
    moved: FloatArray,
    drawn: FloatArray,
    steps: int,
    discount: float,
    rng: np.random.Generator,
) -> float:
    """Return the leaf value of a state, or the return of the default policy from it; the arrays are overwritten."""
    if _HAS_LEAF_VALUE:
        return float(_leaf_value(leaf_parameters, state))
    value, _, _, _ = _rollout(parameters, state, moved, drawn, steps, discount, rng)
    return float(value)


@functools.cache
def roll_out_kernel(
    name: str, step: Callable[..., Any], act: Callable[..., Any], note: Callable[..., Any], *, drawn: bool = False
) -> Callable[..., Any]:
    """Return the kernel of a rollout; see `_roll_out_template`.

    Args:
        name: name of model and rule.
        step: kernel that advances the model by one step.
        act: (parameters, state, notes, steps made, rng) → action.
        note: (notes, steps made before, action, reward): called after each step.
        drawn: whether actions are drawn; then they have no number.
    """
    number = kernel(inline=True)(_no_number if drawn else _listed_number)
    bound = {"_step": step, "_act": act, "_note": note, "_number": number}
    return specialise(_roll_out_template, name, bound, inline=True)


@functools.cache
def rollout_kernel(
    name: str, step: Callable[..., Any], rollout_action: Callable[..., Any], *, drawn: bool = False
) -> Callable[..., Any]:
    """Return the kernel of a rollout by the default policy; see `_roll_out_template`.

    Its notes are an array for the action where actions are drawn, and nothing elsewhere.
    """
    template = _drawn_act_template if drawn else _default_act_template
    act = specialise(template, name, {"_rollout_action": rollout_action}, inline=True)
    return roll_out_kernel(name, step, act, kernel(inline=True)(no_note), drawn=drawn)


@functools.cache
def tail_kernel(
    name: str,
    step: Callable[..., Any],
    rollout_action: Callable[..., Any],
    leaf_value: Callable[..., Any] | None,
    drawn: bool = False,
) -> Callable[..., Any]:
    """Return the kernel that estimates the return beyond the tree; see `_tail_template`."""
    if leaf_value is None:
        rollout = rollout_kernel(name, step, rollout_action, drawn=drawn)
        return specialise(_tail_template, name, {"_rollout": rollout}, inline=True)
    return specialise(
        _tail_template, f"{name}_leaves", {"_leaf_value": leaf_value, "_HAS_LEAF_VALUE": True}, inline=True
    )
