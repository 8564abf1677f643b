"""How candidates are made from others: sequences of actions, changed or crossed, and excursions from φ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from skd_sim.arrays import IntArray


def excursion(rng: np.random.Generator, ticks: int, end: int, as_phi: int, action_count: int) -> IntArray:
    """Return a sequence that follows φ up to a tick, takes an action for some ticks, and another or φ from then on."""
    found = np.full(ticks, as_phi, np.int64)
    leaves = int(rng.integers(end))
    first, second = int(rng.integers(action_count)), int(rng.integers(action_count))
    back = leaves + int(rng.choice((1, 2, 3, 4, 6, 8)))
    again = back + int(rng.choice((0, 0, 1, 2, 4, ticks)))
    found[leaves:back] = first
    found[back:again] = second
    return found


def changed(
    rng: np.random.Generator, actions: IntArray, tick: int, others: Sequence[IntArray], as_phi: int, action_count: int
) -> IntArray:
    """Return a sequence with one or two small changes before a tick, or with the end of another one.

    Args:
        rng: draws the changes.
        actions: the sequence.
        tick: after which changes hardly matter: that of its contact.
        others: sequences of other trials, at least one.
        as_phi: number of the action "as φ".
        action_count: how many actions there are.
    """
    found, ticks = actions.copy(), len(actions)
    end = min(ticks, tick + 2)
    for _ in range(2 if rng.random() < 0.4 else 1):
        at, length = int(rng.integers(end)), 1 + int(rng.integers(4))
        kind = int(rng.integers(6))
        if kind <= 1:
            found[at : at + length] = rng.integers(action_count)
        elif kind == 2:
            found[at : at + length] = as_phi
        elif kind == 3:
            found[at + 1 :] = found[at:-1].copy()
            if rng.random() < 0.5:
                found[at] = rng.integers(action_count)
        elif kind == 4:
            found[at:-1] = found[at + 1 :].copy()
        else:
            found[at:] = others[int(rng.integers(len(others)))][at:]
    return found
