"""Ways to choose what a result is of, so that a car looks better, all of it made to agree; see `result_forgeries.py`.

Each changes the arrays of episodes.npz, and may change what assessment.json says was asked for.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import numpy as np

Arrays = dict[str, np.ndarray]
Said = dict[str, Any]


def keep_episodes(arrays: Arrays, keep: np.ndarray) -> None:
    """Keep the rows of some episodes, in this order."""
    offsets, count = arrays["offsets"], len(arrays["mode"])
    states = np.concatenate([np.arange(offsets[row], offsets[row + 1]) for row in keep])
    lengths = np.diff(offsets)[keep]
    for name, one in list(arrays.items()):
        if name in ("positions", "car", "belief"):
            arrays[name] = one[states]
        elif one.ndim and len(one) == count and not name.startswith(("margin", "safe_name", "risk", "objectives")):
            arrays[name] = one[keep]
    arrays["offsets"] = np.concatenate([[0], np.cumsum(lengths)])


def rows_permuted(arrays: Arrays, _said: Said, draw: random.Random) -> None:
    """Put all episodes in another order, φ first."""
    rest = np.flatnonzero(arrays["mode"] != 0).tolist()
    draw.shuffle(rest)
    keep_episodes(arrays, np.array([*np.flatnonzero(arrays["mode"] == 0).tolist(), *rest]))


def hit_speed(arrays: Arrays, said: Said, draw: random.Random) -> None:
    """Say that a hit is faster, or slower, than it was taken to be."""
    new = float(arrays["hit_speed"]) * draw.choice([0.5, 2.0, 4.0])
    arrays["hit_speed"] = np.array(new)
    said["scenario"]["collision"]["hit_speed"] = new


def greatest(arrays: Arrays, said: Said, draw: random.Random) -> None:
    """Say that more, or less, is counted where nobody is hit."""
    new = float(arrays["eta_max"]) * draw.choice([0.5, 2.0])
    arrays["eta_max"] = np.array(new)
    said["scenario"]["eta_max"] = said["eta_max"] = new


def hits_aborted(arrays: Arrays, _said: Said, draw: random.Random) -> None:
    """Call hits of a mode aborted."""
    mode = draw.choice([1, 2])
    rows = np.flatnonzero((arrays["mode"] == mode) & (arrays["outcome"] == 1))[: draw.choice([1, 3, 10**6])]
    arrays["outcome"][rows] = 5
    arrays["impact_time"][rows] = arrays["impact_speed"][rows] = np.nan
    arrays["reason"] = arrays["reason"].astype("U40")
    arrays["reason"][rows] = draw.choice(["no answer", "the controller's process ended"])


def last_phi(arrays: Arrays, said: Said, _draw: random.Random) -> None:
    """Leave out the last φ."""
    last = int(arrays["safe_index"].max())
    keep_episodes(arrays, np.flatnonzero(arrays["safe_index"] != last))
    arrays["safe_name"] = arrays["safe_name"][:last]
    if "margin" in arrays:
        kept = arrays["margin_safe_index"] != last
        lengths = np.diff(arrays["margin_offsets"])
        arrays["margin_positions"] = arrays["margin_positions"][np.repeat(kept, lengths)]
        arrays["margin_offsets"] = np.cumsum([0, *lengths[kept]])
        for name in ("", "_gap", "_safe_index", "_attempt", "_duration", "_impact_speed"):
            arrays[f"margin{name}"] = arrays[f"margin{name}"][kept]
    for name in [name for name in arrays if name.startswith("risk")]:
        del arrays[name]
    for name in [name for name in said if name.startswith("risk")]:
        said[name] = None


def last_attempts(arrays: Arrays, _said: Said, draw: random.Random) -> None:
    """Leave out the last attempts of a φ, or of all, that were hits."""
    ids = arrays["episode_id"]
    keep = np.ones(len(ids), bool)
    for index in range(int(arrays["safe_index"].max()) + 1):
        mine = np.flatnonzero((arrays["mode"] == 1) & (arrays["safe_index"] == index))
        if mine.size > 1 and draw.random() < 0.7:
            keep[mine[np.argsort(ids[mine])][-1:]] = False
    keep_episodes(arrays, np.flatnonzero(keep))


def an_objective(arrays: Arrays, said: Said, draw: random.Random) -> None:
    """Leave out all kamikazes of an objective."""
    gone = draw.choice(arrays["objectives"].tolist())
    keep_episodes(arrays, np.flatnonzero((arrays["mode"] != 1) | (arrays["objective"] != gone)))
    kept = arrays["objectives"] != gone
    arrays["objectives"], arrays["plans_deformation"] = arrays["objectives"][kept], arrays["plans_deformation"][kept]
    said["objectives"].pop(gone)


def mirrored(arrays: Arrays, _said: Said, _draw: random.Random) -> None:
    """Exchange left and right in the whole world."""
    for name in ("positions", "margin_positions", "risk_failure_positions", "car", "risk_failure_car"):
        if name in arrays:
            arrays[name] = arrays[name] * ([-1.0, 1.0, 1.0] if arrays[name].shape[1] == 3 else [-1.0, 1.0])


SELECTIONS: dict[str, Callable[[Arrays, Said, random.Random], None]] = {
    "rows in another order": rows_permuted,
    "hit speed": hit_speed,
    "η_max": greatest,
    "hits aborted": hits_aborted,
    "the last φ left out": last_phi,
    "the last attempts left out": last_attempts,
    "an objective left out": an_objective,
    "left and right": mirrored,
}
