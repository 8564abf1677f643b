"""What a file of others holds: tracked objects, each with its way, as it was recorded."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError

from skd_evaluator.extensions.fusion.track import Track

_FEW = 8
_FARTHEST = 1e7  # m


@dataclass(frozen=True, eq=False)
class Found:
    """An object of a file.

    Attributes:
        name: what the file calls it.
        track: where it was, in the file's frame.
        kind: what the file says it is; empty where it does not say.
        frame: name of the frame; empty where it has none.
    """

    name: str
    track: Track
    kind: str = ""
    frame: str = ""


def track_of(times: Sequence[float] | FloatArray, places: FloatArray, where: str) -> Track:
    """Return a track of positions alone.

    Raises:
        UsageError: there are fewer than two, one is not finite or beyond all roads, or times do not increase.
    """
    at, where_at = np.asarray(times, np.float64), np.asarray(places, np.float64).reshape(-1, 2)
    if len(at) < 2:
        raise UsageError(f"{where}: {len(at)} position{'' if len(at) == 1 else 's'}; a way has at least two")
    if not (np.isfinite(at).all() and np.isfinite(where_at).all()):
        raise UsageError(f"{where}: has a time or a position that is no finite number")
    if (np.diff(at) <= 0.0).any():
        raise UsageError(f"{where}: times must increase strictly, in s")
    if np.abs(where_at).max() > _FARTHEST or np.abs(at).max() > 1e12:
        raise UsageError(f"{where}: has a position or a time beyond all roads; they must be in m and s")
    return Track(at, where_at, None, None, where)


def one_of(found: Sequence[Found], name: str | None, usual: str, option: str, where: str) -> Found:
    """Return the object with a name; without one the usual one, else the only one there is.

    Raises:
        UsageError: there is none, or several and none that is usual.
    """
    known = {one.name: one for one in found}
    if name is not None:
        if name not in known:
            raise UsageError(f"{where}: has no {name!r} that moves; it has {listed(list(known))}: name one by {option}")
        return known[name]
    if usual in known:
        return known[usual]
    if len(known) != 1:
        raise UsageError(f"{where}: has {listed(list(known))}: name one by {option}")
    return found[0]


def listed(names: Sequence[str]) -> str:
    """Return names in a few words."""
    shown = [re.sub(r"\s+", " ", one)[:40] for one in names[:_FEW]]
    more = f" and {len(names) - _FEW} more" if len(names) > _FEW else ""
    return (", ".join(map(repr, shown)) or "nobody who moves") + more
