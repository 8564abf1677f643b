"""The expected return beyond the tree where there are no leaf values: that of a rollout from there."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel, specialise, unbound

_step = _rollout_action = _act = _note = unbound


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
    one. `notes` are the rule's own. Returns (return, the first action or −1, steps made, whether the episode
    ended).
    """
    value, discounting = 0.0, 1.0
    first = -1
    made = 0
    terminal = False
    while made < steps:
        action = _act(parameters, state, notes, made, rng)
        if made == 0:
            first = action
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


def no_note(notes: Any, made: int, action: int, reward: float) -> None:
    """Note nothing."""


@functools.cache
def roll_out_kernel(
    name: str, step: Callable[..., Any], act: Callable[..., Any], note: Callable[..., Any]
) -> Callable[..., Any]:
    """Return the kernel of a rollout; see `_roll_out_template`.

    Args:
        name: name of model and rule.
        step: kernel that advances the model by one step.
        act: (parameters, state, notes, steps made, rng) → action.
        note: (notes, steps made before, action, reward): called after each step.
    """
    bound = {"_step": step, "_act": act, "_note": note}
    return specialise(_roll_out_template, name, bound, inline=True)


@functools.cache
def rollout_kernel(name: str, step: Callable[..., Any], rollout_action: Callable[..., Any]) -> Callable[..., Any]:
    """Return the kernel of a rollout by the default policy; see `_roll_out_template`. It keeps no notes."""
    act = specialise(_default_act_template, name, {"_rollout_action": rollout_action}, inline=True)
    return roll_out_kernel(name, step, act, kernel(inline=True)(no_note))
