"""An assessment that is on disk: its figures, and the vulnerability curve of its trajectories."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from skd_sim.episode import Mode, Outcome, until_contact
from skd_sim.errors import UsageError
from skd_sim.objective import RANKING_OBJECTIVES, SKD_OBJECTIVES, first_of
from skd_sim.trajectory import Trajectory

from skd_evaluator.arrays import Column, read_arrays
from skd_evaluator.files import open_regular
from skd_evaluator.measure.deformation import deformation_pairs
from skd_evaluator.measure.frechet import discrete_frechet_pairs
from skd_evaluator.measure.skd import prefix_distances
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
            m; `skd` and `skd_prefix`, the Fréchet and the prefix distance of each pair of the kamikazes that SKD is of,
            m; `collision_rate`, 1 for each run along φ that hit, else 0; `deformation_success_rate` and
            `kamikaze_success_rate` likewise of the attempts of both.
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
    rows = _rows(arrays, folder)
    safe = tuple(rows.positions[row] for row in np.flatnonzero(arrays["mode"] == Mode.SAFE))
    deformations = _deformations(rows, safe, objective)
    curve = vulnerability_curve(deformations, eta_max)
    if curve is None or stated is None:
        raise UsageError(f"{folder}: no kamikaze ran, so there is no deformation")
    if abs(curve.area_above - float(stated)) > 1e-9 * max(1.0, eta_max):
        raise UsageError(
            f"{folder}: its trajectories give a mean deformation of {curve.area_above:.6f} m, and assessment.json says "
            f"{stated:.6f} m: they are not of one assessment"
        )
    distances, prefixes = _distances(rows, safe, objective_of_skd, limited=figures.get("maximum_distance") is not None)
    runs = (arrays["mode"] == Mode.REPLAY) & (arrays["outcome"] != Outcome.ABORTED)
    groups = {
        "deformation": tuple(np.minimum(group, eta_max) for group in deformations),
        "deformation_success_rate": tuple(np.isfinite(group).astype(np.float64) for group in deformations),
        "skd": distances,
        "skd_prefix": prefixes,
        "kamikaze_success_rate": tuple(rows.hit[mine] for mine in rows.attempts(objective_of_skd, len(safe))),
        "collision_rate": tuple(rows.hit[runs & (arrays["safe_index"] == index)] for index in range(len(safe))),
    }
    return StoredResult(folder, figures, safe, curve, objective, groups)


@dataclass(frozen=True, eq=False)
class _Rows:
    """The trajectories of an episodes.npz.

    Attributes:
        path: of the file.
        arrays: its columns.
        positions: of each trajectory, m.
        hit: 1 where it ended in a collision, else 0.
    """

    path: Path
    arrays: Mapping[str, np.ndarray[Any, Any]]
    positions: list[FloatArray]
    hit: FloatArray

    @property
    def time_step(self) -> float:
        """Time step, s."""
        return float(self.arrays["time_step"])

    def attempts(self, objective: str, count: int) -> list[npt.NDArray[np.int64]]:
        """Return the rows of the attempts on each φ, in the order of their numbers."""
        tried = (self.arrays["mode"] == Mode.KAMIKAZE) & (self.arrays["objective"] == objective)
        tried &= self.arrays["outcome"] != Outcome.ABORTED
        return [np.flatnonzero(tried & (self.arrays["safe_index"] == index)) for index in range(count)]

    def contacts(self, rows: npt.NDArray[np.int64]) -> tuple[list[FloatArray], FloatArray]:
        """Return each ψ up to its contact (m), and when that was (ticks), of rows that collided."""
        durations: FloatArray = self.arrays["impact_time"][rows] / self.time_step
        pairs = zip(rows.tolist(), durations.tolist(), strict=True)
        return [until_contact(self.positions[row], time) for row, time in pairs], durations


def _rows(arrays: Mapping[str, np.ndarray[Any, Any]], folder: Path) -> _Rows:
    parts = [arrays["positions"][low:high] for low, high in itertools.pairwise(arrays["offsets"].tolist())]
    if any(len(arrays[name]) != len(parts) for name in ("mode", "safe_index", "outcome", "impact_time", "objective")):
        raise UsageError(f"{folder / 'episodes.npz'}: its arrays do not go together")
    hit = (arrays["outcome"] == Outcome.COLLISION).astype(np.float64)
    return _Rows(folder / "episodes.npz", arrays, parts, hit)


def _deformations(rows: _Rows, safe: Sequence[FloatArray], objective: str) -> list[FloatArray]:
    """Return per φ the deformation of each attempt, m, infinite where it failed."""
    found = []
    for index, (phi, mine) in enumerate(zip(safe, rows.attempts(objective, len(safe)), strict=True)):
        hit = rows.hit[mine] > 0.0
        needed = np.full(len(mine), np.inf)
        with _said(rows, index):
            needed[hit] = deformation_pairs(phi, *rows.contacts(mine[hit]))
        found.append(needed)
    return found


def _distances(
    rows: _Rows, safe: Sequence[FloatArray], objective: str, *, limited: bool
) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    """Return per φ the Fréchet and the prefix distance of each pair, m; none where a maximum distance left some out."""
    distances, prefixes = [], []
    for index, (phi, mine) in enumerate(zip(safe, rows.attempts(objective, len(safe)), strict=True)):
        with _said(rows, index):
            psis, _ = rows.contacts(mine[rows.hit[mine] > 0.0]) if not limited else ([], None)
            step = rows.time_step
            distances.append(discrete_frechet_pairs(phi, psis))
            prefixes.append(prefix_distances(Trajectory(phi, step), [Trajectory(psi, step) for psi in psis]))
    return tuple(distances), tuple(prefixes)


@contextmanager
def _said(rows: _Rows, index: int) -> Iterator[None]:
    """Say of which φ a damaged trajectory is."""
    try:
        yield
    except ValueError as error:
        raise UsageError(f"{rows.path}: φ number {index}: {error}") from error
