"""An assessment that is on disk: its figures, and the vulnerability curve of its trajectories."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.episode import Mode, Outcome, until_contact
from skd_sim.errors import UsageError
from skd_sim.objective import RANKING_OBJECTIVES, first_of

from skd_evaluator.arrays import Column, read_arrays
from skd_evaluator.files import open_regular
from skd_evaluator.measure.deformation import deformation_pairs
from skd_evaluator.measure.statistics import FloatArray
from skd_evaluator.measure.vulnerability_curve import VulnerabilityCurve, vulnerability_curve

_LARGEST = 64 * 2**20  # bytes of an assessment.json
_COLUMNS = {
    "positions": Column(np.float64, (-1, 2)),
    "offsets": Column(np.int64, (-1,)),
    "mode": Column(np.int8, (-1,)),
    "safe_index": Column(np.int32, (-1,)),
    "outcome": Column(np.int8, (-1,)),
    "impact_time": Column(np.float64, (-1,)),
    "objective": Column("U16", (-1,)),
    "time_step": Column(np.float64, ()),
}


@dataclass(frozen=True, eq=False)
class StoredResult:
    """An assessment read back.

    Attributes:
        folder: where it is.
        figures: content of its assessment.json.
        safe: positions of each φ, m.
        curve: of the kamikazes that rank the car.
    """

    folder: Path
    figures: Mapping[str, Any]
    safe: tuple[FloatArray, ...]
    curve: VulnerabilityCurve

    def same_safe(self, other: StoredResult) -> bool:
        """Return whether both are of the same φ."""
        return len(self.safe) == len(other.safe) and all(map(np.array_equal, self.safe, other.safe))


def read_result(folder: Path) -> StoredResult:
    """Read an assessment and compute its curve anew from its trajectories.

    Raises:
        UsageError: it is none, is damaged, has no attempt, or its trajectories give another deformation than it says.
    """
    path = folder / "assessment.json"
    try:
        with open_regular(path) as stream:
            figures = json.loads(stream.read(_LARGEST))
        eta_max, stated = float(figures["eta_max"]), figures["deformation"]
        objective = first_of(RANKING_OBJECTIVES, figures["objectives"])
        seed = int(figures["seed"])
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise UsageError(f"{path}: no assessment of this version ({type(error).__name__}: {error})") from error
    arrays = read_arrays(folder / "episodes.npz", _COLUMNS)
    safe, groups = _groups(arrays, objective, folder)
    curve = vulnerability_curve(groups, eta_max, seed=seed)
    if curve is None or stated is None:
        raise UsageError(f"{folder}: no kamikaze ran, so there is no deformation")
    if abs(curve.area_above - float(stated)) > 1e-9 * max(1.0, eta_max):
        raise UsageError(
            f"{folder}: its trajectories give a mean deformation of {curve.area_above:.6f} m, and assessment.json says "
            f"{stated:.6f} m: they are not of one assessment"
        )
    return StoredResult(folder, figures, safe, curve)


def _groups(
    arrays: Mapping[str, np.ndarray[Any, Any]], objective: str, folder: Path
) -> tuple[tuple[FloatArray, ...], list[FloatArray]]:
    """Return each φ, and per φ the deformation of each attempt, infinite where it failed."""
    parts = [arrays["positions"][low:high] for low, high in itertools.pairwise(arrays["offsets"].tolist())]
    if any(len(arrays[name]) != len(parts) for name in ("mode", "safe_index", "outcome", "impact_time", "objective")):
        raise UsageError(f"{folder / 'episodes.npz'}: its arrays do not go together")
    safe = tuple(parts[row] for row in np.flatnonzero(arrays["mode"] == Mode.SAFE))
    tried = (arrays["mode"] == Mode.KAMIKAZE) & (arrays["objective"] == objective)
    tried &= arrays["outcome"] != Outcome.ABORTED
    groups = []
    for index, phi in enumerate(safe):
        mine = tried & (arrays["safe_index"] == index)
        hits = np.flatnonzero(mine & (arrays["outcome"] == Outcome.COLLISION))
        durations = arrays["impact_time"][hits] / float(arrays["time_step"])
        try:
            psis = [until_contact(parts[row], time) for row, time in zip(hits, durations, strict=True)]
            found = deformation_pairs(phi, psis, durations)
        except ValueError as error:
            raise UsageError(f"{folder / 'episodes.npz'}: φ number {index}: {error}") from error
        groups.append(np.concatenate([found, np.full(int(mine.sum()) - len(hits), np.inf)]))
    return safe, groups
