"""The assessment of a car by kamikazes of one objective: what they reached, and everything reported with it."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from skd_sim.episode import EpisodeLog, Outcome
from skd_sim.trajectory import Trajectory

from skd_evaluator.campaign.plan import (
    EpisodeRunner,
    KamikazeSet,
    Plan,
    Progress,
    collision_runs,
    kamikaze_sets,
)
from skd_evaluator.measure.clustered import Clustered
from skd_evaluator.measure.clustered_rate import clustered_rate
from skd_evaluator.measure.mean_deformation import Attempts, MeanDeformation, mean_deformation
from skd_evaluator.measure.measures import DEFORMATION, FRECHET, PREFIX, Measured, measure_pairs, pair_of
from skd_evaluator.measure.skd import SkdResult, compute_skd
from skd_evaluator.measure.statistics import (
    FloatArray,
    Interval,
    mean,
    normal_interval,
    ratio_interval,
    wilson_interval,
)

BOUND_ETAS = (0.25, 0.5, 1.0)
"""Distances η (m) for which Theorem 1's bound is reported."""
_ROUNDING = 1e-9  # m: a mean floor that is not above it is 0, where every kamikaze could have walked as φ
CONFIDENCE = 0.95
STANDING = 0.1
"""m/s below which a car stands when it is touched: then it was walked into."""


def standing_contacts(logs: Iterable[EpisodeLog]) -> int:
    """Return how many episodes ended with a pedestrian who walked into a standing car."""
    return sum(log.outcome == Outcome.COLLISION and log.impact_speed < STANDING for log in logs)


@dataclass(frozen=True)
class Assessment:
    """What the kamikazes of one objective reached, and everything reported with it.

    Attributes:
        plan: what was assessed.
        safe: Φ.
        kamikaze: Ψ(φ) per φ.
        replays: runs of the car against a pedestrian that follows φ.
        skd: discrete Fréchet distances of all pairs.
        deformation: deformations of all attempts.
        seconds: wall-clock time it took.
        floors: of each pair, in the order of `planned_distances`, that of the clairvoyant kamikaze of its episode, m,
            nan where none collides; none: not asked for.
        missed_floors: likewise of each attempt that failed, φ by φ, by objective `deformation`; nan where none collides
            within η_max.
        floor_gap: the least possible distances are no more than this below the floors, m: 0 where these are exact.
        floor_budget: of the search that found the floors, ticks per episode; they are then upper bounds on the floor.
            None: they are exact.
        measured: the further measures of all pairs, by name.
        confidence: of the intervals over φ; more than 95 % where it was looked at them before more φ were run.
    """

    plan: Plan
    safe: tuple[Trajectory, ...]
    kamikaze: tuple[KamikazeSet, ...]
    replays: tuple[EpisodeLog, ...]
    skd: SkdResult
    deformation: MeanDeformation
    seconds: float
    floors: FloatArray | None = None
    missed_floors: FloatArray | None = None
    floor_gap: float = 0.0
    floor_budget: int | None = None
    measured: Mapping[str, Measured] = field(default_factory=dict)
    confidence: float = CONFIDENCE

    @property
    def attempts(self) -> int:
        """Kamikaze episodes run, aborted ones not counted."""
        return sum(kamikaze.attempts - kamikaze.aborted for kamikaze in self.kamikaze)

    @property
    def successes(self) -> int:
        """Kamikaze episodes that ended in a collision."""
        return sum(len(kamikaze.logs) for kamikaze in self.kamikaze)

    @property
    def success_rate(self) -> float | None:
        """Share of the kamikaze episodes that ended in a collision; None where none was run."""
        return self.successes / self.attempts if self.attempts else None

    @property
    def clustered_success_rate(self) -> Clustered | None:
        """The success rate with what its error over φ is."""
        return clustered_rate(
            [(len(group.logs), group.attempts - group.aborted) for group in self.kamikaze], self.confidence
        )

    @property
    def reasons(self) -> list[str]:
        """Why kamikaze episodes were aborted, one each."""
        return [reason for kamikaze in self.kamikaze for reason in kamikaze.reasons]

    @property
    def planned_distances(self) -> FloatArray:
        """Of each pair of SKD, φ by φ, the distance that is planned for, m: its deformation or its Fréchet distance."""
        if not self.plan.limits_deformation:
            return self.skd.distances
        rows = zip(self.deformation.per_safe_trajectory, self.skd.per_safe_trajectory, strict=True)
        return np.concatenate([np.empty(0), *(deformed.distances[pairs.kept] for deformed, pairs in rows)])

    def bounds(self) -> dict[str, float]:
        """Return η → Theorem 1's bound on P(d ≤ η), for those of BOUND_ETAS below SKD; none below two pairs."""
        skd = self.skd.skd
        if skd is None or self.skd.variance is None:
            return {}
        return {f"{eta:g}": self.skd.bound(eta) for eta in BOUND_ETAS if eta < skd}

    def bound_intervals(self) -> dict[str, Interval | None]:
        """Return η → the interval over φ of the bound, for the η of `bounds`."""
        return {name: self.skd.bound_interval(float(name), self.confidence) for name in self.bounds()}

    def clustering(self) -> dict[str, Any]:
        """Return what is known of the error over φ of each figure, by its name."""
        found = {
            "deformation": self.deformation.clustered,
            "skd": self.skd.clustered,
            "skd_prefix": self.skd.prefix_clustered,
            "success_rate": self.clustered_success_rate,
        }
        return {name: one and one.as_dict() for name, one in found.items()}

    def floor_figures(self) -> dict[str, Any]:
        """Return floor, closeness and their intervals; each None where not asked for or not defined."""
        names = (
            "floor", "floor_ci95", "floor_missing", "floor_of_all", "floor_of_all_ci95", "floor_gap", "floor_budget",
            "closeness", "closeness_ci95",
        )  # fmt: skip
        if self.floors is None:
            return dict.fromkeys(names)
        known = np.isfinite(self.floors)
        floors, distances = self.floors[known], self.planned_distances[known]
        floor = mean(floors) if floors.size else None
        # Over all attempts, as the mean deformation: where nobody could have collided, it is η_max.
        of_all = np.empty(0)
        if self.plan.limits_deformation and self.missed_floors is not None:
            eta_max = self.plan.scenario.eta_max
            of_all = np.minimum(np.nan_to_num(np.concatenate([self.floors, self.missed_floors]), nan=eta_max), eta_max)
        return {
            "floor": floor,
            "floor_ci95": normal_interval(floors),
            "floor_missing": int(self.floors.size - floors.size),
            "floor_of_all": mean(of_all) if of_all.size else None,
            "floor_of_all_ci95": normal_interval(of_all),
            "floor_gap": self.floor_gap if math.isfinite(self.floor_gap) else None,
            "floor_budget": self.floor_budget,
            "closeness": mean(distances) / floor if floor and floor > _ROUNDING else None,
            "closeness_ci95": ratio_interval(distances, floors) if floor and floor > _ROUNDING else None,
        }

    def figures(self) -> dict[str, Any]:
        """Return all that is reported of these kamikazes: an entry under `objectives` of assessment.json."""
        skd, deformation = self.skd, self.deformation
        success = self.clustered_success_rate
        speeds = [log.impact_speed for kamikaze in self.kamikaze for log in kamikaze.logs]
        return {
            "deformation": deformation.mean,
            "deformation_ci95": deformation.ci95,
            "deformation_ci95_clustered": deformation.ci95_clustered,
            "deformation_of_successes": deformation.of_successes,
            "deformation_of_successes_ci95": deformation.of_successes_ci95,
            "skd": skd.skd,
            "skd_ci95": skd.skd_ci95,
            "skd_ci95_clustered": skd.skd_ci95_clustered,
            "skd_prefix": skd.skd_prefix,
            "skd_prefix_ci95": skd.skd_prefix_ci95,
            "skd_prefix_ci95_clustered": skd.prefix_clustered and skd.prefix_clustered.interval,
            "variance": skd.variance,
            "plans_deformation": self.plan.limits_deformation,
            **self.floor_figures(),
            "pairs": skd.pairs,
            "discarded_by_distance": skd.discarded_by_distance,
            "probability_bound": self.bounds(),
            "probability_bound_ci95_clustered": self.bound_intervals(),
            "clustering": self.clustering(),
            "measures": self._measures(),
            "success_rate": self.success_rate,
            "success_rate_ci95": wilson_interval(self.successes, self.attempts),
            "success_rate_ci95_clustered": success and success.interval,
            "attempts": self.attempts,
            "failed": sum(kamikaze.failed for kamikaze in self.kamikaze),
            "aborted": len(self.reasons),
            "mean_impact_speed": float(np.mean(speeds)) if speeds else None,
            "standing_contacts": standing_contacts(log for kamikaze in self.kamikaze for log in kamikaze.logs),
            "per_safe_trajectory": self._per_safe_trajectory(),
        }

    def _measures(self) -> dict[str, Any]:
        kept = [row.kept for row in self.skd.per_safe_trajectory]
        return {name: one.figures(kept, self.confidence) for name, one in self.measured.items()}

    def _per_safe_trajectory(self) -> list[dict[str, Any]]:
        rows = zip(self.kamikaze, self.skd.per_safe_trajectory, self.deformation.per_safe_trajectory, strict=True)
        return [
            {
                "name": distances.name,
                "deformation": deformations.mean,
                "deformation_of_successes": deformations.mean_of_successes,
                "skd": distances.mean_distance,
                "skd_prefix": distances.mean_prefix_distance,
                "pairs": distances.pairs,
                "attempts": kamikaze.attempts,
                "failed": kamikaze.failed,
                "aborted": kamikaze.aborted,
            }
            for kamikaze, distances, deformations in rows
        ]


def judge(
    plan: Plan,
    safe: Sequence[Trajectory],
    kamikaze: Sequence[KamikazeSet],
    replays: Sequence[EpisodeLog],
    seconds: float,
    confidence: float = CONFIDENCE,
) -> Assessment:
    """Compute the assessment from episodes that have been run, now or long ago.

    A maximum distance is one of the distance that the objective plans for: kamikazes of objective `deformation` are
    discarded by their deformation, others by their Fréchet distance. What is discarded counts in no SKD; the mean
    deformation is over all attempts, each with what it needed.
    """
    pairs = [(group.safe_trajectory, [pair_of(log) for log in group.logs]) for group in kamikaze]
    measured = measure_pairs(pairs)
    attempts = [
        Attempts(phi, [one.psi for one in mine], [one.duration for one in mine], group.failed, distances)
        for (phi, mine), group, distances in zip(pairs, kamikaze, measured[DEFORMATION].values, strict=True)
    ]
    deformation = mean_deformation(attempts, eta_max=plan.scenario.eta_max, confidence=confidence)
    result = compute_skd(
        [(one.phi, one.psis) for one in attempts],
        confidence=confidence,
        maximum_distance=plan.maximum_distance,
        limited=measured[DEFORMATION].values if plan.limits_deformation else None,
        measured=list(zip(measured[FRECHET].values, measured[PREFIX].values, strict=True)),
    )
    others = {name: one for name, one in measured.items() if not one.measure.headline}
    return Assessment(
        plan,
        tuple(safe),
        tuple(kamikaze),
        tuple(replays),
        result,
        deformation,
        seconds,
        measured=others,
        confidence=confidence,
    )


def assess(plan: Plan, safe: Sequence[Trajectory], runner: EpisodeRunner, progress: Progress) -> Assessment:
    """Run the kamikaze episodes and the runs along φ of a plan, and judge them."""
    begin = time.perf_counter()
    kamikaze = kamikaze_sets(plan, safe, runner, progress)
    replays = collision_runs(plan, safe, runner, progress)
    return judge(plan, safe, kamikaze, replays, time.perf_counter() - begin)
