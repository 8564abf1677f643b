"""An assessment that is on disk: its figures, and the vulnerability curve of its trajectories."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from skd_sim.episode import Mode, Outcome
from skd_sim.errors import UsageError
from skd_sim.objective import RANKING_OBJECTIVES, SKD_OBJECTIVES, first_of
from skd_sim.trajectory import Trajectory

from skd_evaluator.campaign.stored_episodes import IntArray, StoredEpisodes, read_episodes
from skd_evaluator.files import open_regular
from skd_evaluator.measure.skd import prefix_distances
from skd_evaluator.measure.statistics import FloatArray
from skd_evaluator.measure.vulnerability_curve import VulnerabilityCurve, vulnerability_curve

_LARGEST = 64 * 2**20  # bytes of an assessment.json


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
    stored = read_episodes(folder)
    deformations = stored.deformations_of(objective)
    curve = vulnerability_curve(deformations, eta_max)
    if curve is None or stated is None:
        raise UsageError(f"{folder}: no kamikaze ran, so there is no deformation")
    if abs(curve.area_above - float(stated)) > 1e-9 * max(1.0, eta_max):
        raise UsageError(
            f"{folder}: its trajectories give a mean deformation of {curve.area_above:.6f} m, and assessment.json says "
            f"{stated:.6f} m: they are not of one assessment"
        )
    of_skd, hit = stored.attempts(objective_of_skd), stored.hit.astype(np.float64)
    collided = stored.collided.astype(np.float64)
    # Where a maximum distance left some out, those that are there are not the pairs of SKD.
    limited = figures.get("maximum_distance") is not None
    distances, prefixes = _distances(stored, [mine[:0] for mine in of_skd] if limited else of_skd)
    runs = (stored.mode == Mode.REPLAY) & (stored.outcome != Outcome.ABORTED)
    groups = {
        "deformation": tuple(np.minimum(group, eta_max) for group in deformations),
        "deformation_success_rate": tuple(np.isfinite(group).astype(np.float64) for group in deformations),
        "skd": distances,
        "skd_prefix": prefixes,
        "kamikaze_success_rate": tuple(collided[mine] for mine in of_skd),
        "hit_rate": tuple(hit[runs & (stored.safe_index == index)] for index in range(len(stored.safe))),
        "collision_rate": tuple(collided[runs & (stored.safe_index == index)] for index in range(len(stored.safe))),
    }
    return StoredResult(folder, figures, stored.safe, curve, objective, groups)


def _distances(
    stored: StoredEpisodes, attempts: Sequence[IntArray]
) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    """Return per φ the Fréchet and the prefix distance of each pair of some attempts, m."""
    step, distances, prefixes = stored.time_step, [], []
    for phi, mine in zip(stored.safe, attempts, strict=True):
        hit = mine[stored.collided[mine]]
        psis = [Trajectory(stored.until_contact(number)[0], step) for number in hit.tolist()]
        distances.append(stored.frechet[hit])
        prefixes.append(prefix_distances(Trajectory(phi, step), psis))
    return tuple(distances), tuple(prefixes)
