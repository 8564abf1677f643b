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
from skd_sim.objective import RANKING_OBJECTIVES, SKD_OBJECTIVES, first_of

from skd_evaluator.arrays import Column, read_arrays
from skd_evaluator.files import open_regular
from skd_evaluator.measure.deformation import deformation_pairs
from skd_evaluator.measure.frechet import discrete_frechet_pairs
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
        objective: of these.
        groups: per φ, by figure: `deformation`, what each of their attempts counts as, in the order of their numbers,
            m; `skd`, the discrete Fréchet distance of each pair of the kamikazes that SKD is of, m; `collision_rate`, 1
            for each run along φ that hit, else 0.
    """

    folder: Path
    figures: Mapping[str, Any]
    safe: tuple[FloatArray, ...]
    curve: VulnerabilityCurve
    objective: str
    groups: Mapping[str, tuple[FloatArray, ...]]

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
        objective_of_skd = first_of(SKD_OBJECTIVES, figures["objectives"])
    except (ValueError, KeyError, TypeError, AttributeError, IndexError) as error:
        raise UsageError(f"{path}: no assessment of this version ({type(error).__name__}: {error})") from error
    arrays = read_arrays(folder / "episodes.npz", _COLUMNS)
    safe, deformations, distances = _groups(arrays, objective, folder)
    curve = vulnerability_curve(deformations, eta_max)
    if curve is None or stated is None:
        raise UsageError(f"{folder}: no kamikaze ran, so there is no deformation")
    if abs(curve.area_above - float(stated)) > 1e-9 * max(1.0, eta_max):
        raise UsageError(
            f"{folder}: its trajectories give a mean deformation of {curve.area_above:.6f} m, and assessment.json says "
            f"{stated:.6f} m: they are not of one assessment"
        )
    if objective_of_skd != objective:
        _, _, distances = _groups(arrays, objective_of_skd, folder)
    maximum = figures.get("maximum_distance")
    groups = {
        "deformation": tuple(np.minimum(group, eta_max) for group in deformations),
        "skd": tuple(group if maximum is None else np.empty(0) for group in distances),
        "collision_rate": _hits(arrays, len(safe)),
    }
    return StoredResult(folder, figures, safe, curve, objective, groups)


def _groups(
    arrays: Mapping[str, np.ndarray[Any, Any]], objective: str, folder: Path
) -> tuple[tuple[FloatArray, ...], list[FloatArray], list[FloatArray]]:
    """Return each φ, and per φ the deformation of each attempt, infinite where it failed, and its pairs' distances."""
    parts = [arrays["positions"][low:high] for low, high in itertools.pairwise(arrays["offsets"].tolist())]
    if any(len(arrays[name]) != len(parts) for name in ("mode", "safe_index", "outcome", "impact_time", "objective")):
        raise UsageError(f"{folder / 'episodes.npz'}: its arrays do not go together")
    safe = tuple(parts[row] for row in np.flatnonzero(arrays["mode"] == Mode.SAFE))
    tried = (arrays["mode"] == Mode.KAMIKAZE) & (arrays["objective"] == objective)
    tried &= arrays["outcome"] != Outcome.ABORTED
    deformations, distances = [], []
    for index, phi in enumerate(safe):
        mine = np.flatnonzero(tried & (arrays["safe_index"] == index))
        hit = arrays["outcome"][mine] == Outcome.COLLISION
        durations = arrays["impact_time"][mine[hit]] / float(arrays["time_step"])
        needed = np.full(len(mine), np.inf)
        try:
            psis = [until_contact(parts[row], time) for row, time in zip(mine[hit], durations, strict=True)]
            needed[hit] = deformation_pairs(phi, psis, durations)
            distances.append(discrete_frechet_pairs(phi, psis))
        except ValueError as error:
            raise UsageError(f"{folder / 'episodes.npz'}: φ number {index}: {error}") from error
        deformations.append(needed)
    return safe, deformations, distances


def _hits(arrays: Mapping[str, np.ndarray[Any, Any]], count: int) -> tuple[FloatArray, ...]:
    """Return per φ whether each run along it hit."""
    runs = (arrays["mode"] == Mode.REPLAY) & (arrays["outcome"] != Outcome.ABORTED)
    hit = (arrays["outcome"] == Outcome.COLLISION).astype(np.float64)
    return tuple(hit[runs & (arrays["safe_index"] == index)] for index in range(count))
