"""The assessment: Safe-Kamikaze Distance of a car, and everything reported with it."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from skd_sim.aborts import counted_reasons
from skd_sim.episode import EpisodeLog, Outcome
from skd_sim.trajectory import Trajectory

from skd_evaluator.campaign import (
    EpisodeRunner,
    KamikazeSet,
    Plan,
    Progress,
    collision_runs,
    kamikaze_sets,
)
from skd_evaluator.skd import SkdResult, compute_skd
from skd_evaluator.statistics import FloatArray, mean, normal_interval, ratio_interval, wilson_interval
from skd_evaluator.version import version

BOUND_ETAS = (0.25, 0.5, 1.0)
"""Deformations η (m) for which Theorem 1's bound is reported."""


@dataclass(frozen=True)
class Assessment:
    """SKD and everything reported with it.

    Attributes:
        plan: what was assessed.
        safe: Φ.
        kamikaze: Ψ(φ) per φ.
        replays: runs of the car against a pedestrian that follows φ.
        skd: the measure over all pairs.
        seconds: wall-clock time it took.
        floors: of each pair, in the order of `skd.distances`, the distance of the clairvoyant kamikaze of its
            episode, m, nan where none collides; none: not asked for.
        left_out: what recordings held beside, and why it does not count, a line each.
        warnings: what is to be known of what counts, a line each.
    """

    plan: Plan
    safe: tuple[Trajectory, ...]
    kamikaze: tuple[KamikazeSet, ...]
    replays: tuple[EpisodeLog, ...]
    skd: SkdResult
    seconds: float
    floors: FloatArray | None = None
    left_out: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def attempts(self) -> int:
        """Kamikaze episodes run, aborted ones not counted."""
        return sum(kamikaze.attempts - kamikaze.aborted for kamikaze in self.kamikaze)

    @property
    def successes(self) -> int:
        """Kamikaze episodes that ended in a collision."""
        return sum(len(kamikaze.logs) for kamikaze in self.kamikaze)

    @property
    def episodes(self) -> int:
        """Episodes run, kamikaze and along φ, aborted ones included."""
        return sum(kamikaze.attempts for kamikaze in self.kamikaze) + len(self.replays)

    @property
    def reasons(self) -> list[str]:
        """Why episodes were aborted, one each."""
        of_replays = [log.reason for log in self.replays if log.outcome == Outcome.ABORTED]
        return [*(reason for kamikaze in self.kamikaze for reason in kamikaze.reasons), *of_replays]

    @property
    def clipped(self) -> list[int]:
        """Per episode in which the car was commanded more than it can do, how often."""
        of_replays = [log.clipped for log in self.replays if log.clipped]
        return [*(count for kamikaze in self.kamikaze for count in kamikaze.clipped), *of_replays]

    def hits(self) -> list[tuple[int, int]]:
        """Return of each safe trajectory how many runs along it ended in a collision, and of how many."""
        counts = {trajectory.positions.tobytes(): [0, 0] for trajectory in self.safe}
        for log in self.replays:
            along = log.episode.safe_trajectory
            if log.outcome != Outcome.ABORTED and along is not None:
                counts[along.positions.tobytes()][0] += log.outcome == Outcome.COLLISION
                counts[along.positions.tobytes()][1] += 1
        return [(hits, runs) for hits, runs in (counts[one.positions.tobytes()] for one in self.safe)]

    @property
    def completed_replays(self) -> int:
        """Runs along φ that were not aborted."""
        return sum(log.outcome != Outcome.ABORTED for log in self.replays)

    @property
    def collisions(self) -> int:
        """Runs along φ that ended in a collision."""
        return sum(log.outcome == Outcome.COLLISION for log in self.replays)

    @property
    def collision_rate(self) -> float | None:
        """Share of the runs along φ that ended in a collision."""
        return self.collisions / self.completed_replays if self.completed_replays else None

    def bounds(self) -> dict[str, float]:
        """Return η → Theorem 1's bound on P(d ≤ η), for those of BOUND_ETAS below SKD; none below two pairs."""
        skd = self.skd.skd
        if skd is None or self.skd.variance is None:
            return {}
        return {f"{eta:g}": self.skd.bound(eta) for eta in BOUND_ETAS if eta < skd}

    def floor_figures(self) -> dict[str, Any]:
        """Return floor, closeness and their intervals; each None where not asked for or not defined."""
        names = ("floor", "floor_ci95", "floor_missing", "closeness", "closeness_ci95")
        if self.floors is None:
            return dict.fromkeys(names)
        known = np.isfinite(self.floors)
        floors, distances = self.floors[known], self.skd.distances[known]
        floor = mean(floors) if floors.size else None
        return {
            "floor": floor,
            "floor_ci95": normal_interval(floors),
            "floor_missing": int(self.floors.size - floors.size),
            "closeness": mean(distances) / floor if floor else None,
            "closeness_ci95": ratio_interval(distances, floors) if floor else None,
        }

    def as_dict(self) -> dict[str, Any]:
        """Return the content of assessment.json."""
        result, plan = self.skd, self.plan
        rate = self.collision_rate
        speeds = [log.impact_speed for kamikaze in self.kamikaze for log in kamikaze.logs]
        per_safe = []
        per_row = zip(self.kamikaze, result.per_safe_trajectory, self.hits(), strict=True)
        for kamikaze, row, (hits, runs) in per_row:
            per_safe.append(
                {
                    "name": row.name,
                    "pairs": row.pairs,
                    "skd": row.mean_distance,
                    "skd_prefix": row.mean_prefix_distance,
                    "attempts": kamikaze.attempts,
                    "aborted": kamikaze.aborted,
                    "collision_rate": hits / runs if runs else None,
                }
            )
        return {
            "skd": result.skd,
            "skd_ci95": result.skd_ci95,
            "skd_ci95_clustered": result.skd_ci95_clustered,
            "skd_prefix": result.skd_prefix,
            "skd_prefix_ci95": result.skd_prefix_ci95,
            "variance": result.variance,
            **self.floor_figures(),
            "pairs": result.pairs,
            "discarded_by_distance": result.discarded_by_distance,
            "probability_bound": self.bounds(),
            "kamikaze_success_rate": self.successes / self.attempts if self.attempts else None,
            "kamikaze_attempts": self.attempts,
            "kamikaze_aborted": sum(kamikaze.aborted for kamikaze in self.kamikaze),
            "aborted_reasons": counted_reasons(self.reasons),
            "commands_clipped": {"commands": sum(self.clipped), "episodes": len(self.clipped)},
            "mean_impact_speed": float(np.mean(speeds)) if speeds else None,
            "collision_rate": rate,
            "collision_rate_ci95": wilson_interval(self.collisions, self.completed_replays)
            if rate is not None
            else None,
            "collision_runs": self.completed_replays,
            "left_out": list(self.left_out),
            "warnings": list(self.warnings),
            "per_safe_trajectory": per_safe,
            "seconds": round(self.seconds, 3),
            "seed": plan.seed,
            "controller": plan.controller,
            "multiplier": plan.multiplier if plan.controller == "basic" else None,
            "safe": plan.safe,
            "simulations": plan.simulations,
            "objective": plan.objective,
            "maximum_distance": plan.maximum_distance,
            "car_model": json.loads(plan.car_model) if plan.car_model else None,
            "scenario": plan.scenario.as_dict(),
            "version": version(),
        }


def judge(
    plan: Plan,
    safe: Sequence[Trajectory],
    kamikaze: Sequence[KamikazeSet],
    replays: Sequence[EpisodeLog],
    seconds: float,
) -> Assessment:
    """Compute the assessment from episodes that have been run, now or long ago."""
    pairs = [(group.safe_trajectory, [log.trajectory for log in group.logs]) for group in kamikaze]
    result = compute_skd(pairs, seed=plan.seed, maximum_distance=plan.maximum_distance)
    return Assessment(plan, tuple(safe), tuple(kamikaze), tuple(replays), result, seconds)


def assess(plan: Plan, safe: Sequence[Trajectory], runner: EpisodeRunner, progress: Progress) -> Assessment:
    """Run the kamikaze episodes and the runs along φ of a plan, and judge them."""
    begin = time.perf_counter()
    kamikaze = kamikaze_sets(plan, safe, runner, progress)
    replays = collision_runs(plan, safe, runner, progress)
    return judge(plan, safe, kamikaze, replays, time.perf_counter() - begin)
