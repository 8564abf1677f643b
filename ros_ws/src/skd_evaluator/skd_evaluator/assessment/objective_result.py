"""The assessment of a car by kamikazes of one objective: what they reached, and everything reported with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.world.episode import EpisodeLog, Outcome
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.figure_table import OF_OBJECTIVES, Of, entries
from skd_evaluator.assessment.plan import Plan, split_episode_id
from skd_evaluator.metrics.clustered import Clustered, GroupedMean, clustered_rate
from skd_evaluator.metrics.deviation import deviation_pairs, mean_deviation
from skd_evaluator.metrics.measures import Pair, measure_pairs, pair_of
from skd_evaluator.metrics.skd import Skd, bound_interval, compute_skd
from skd_evaluator.metrics.statistics import Interval, frechet_probability_bound

BOUND_ETAS = (0.25, 0.5, 1.0)
"""Distances η (m) for which Theorem 1's bound is reported."""
CONFIDENCE = 0.95


@dataclass(frozen=True)
class KamikazeSet:
    """The kamikaze episodes of one safe trajectory φ, in the order of their trials; those that collided are Ψ(φ).

    Attributes:
        safe_trajectory: the safe trajectory φ.
        episodes: all of them, those that failed or were aborted too.
    """

    safe_trajectory: Trajectory
    episodes: tuple[EpisodeLog, ...]

    @cached_property
    def finished(self) -> list[EpisodeLog]:
        """Episodes that ran to their end."""
        return [log for log in self.episodes if log.outcome != Outcome.ABORTED]

    @cached_property
    def logs(self) -> list[EpisodeLog]:
        """Episodes that collided."""
        return [log for log in self.finished if log.outcome == Outcome.COLLISION]

    @property
    def aborted(self) -> int:
        """Number of episodes that were aborted."""
        return len(self.episodes) - len(self.finished)


@dataclass(frozen=True)
class ObjectiveResult:
    """What the kamikazes of one objective reached, and everything reported with it.

    A maximum distance applies to the distance for which the objective plans: kamikazes of objective `deviation` are
    discarded by their deviation, others by their Fréchet distance. Discarded kamikazes do not count in SKD. The mean
    deviation is over all trials, each with the deviation that it needed. SKD counts all collisions, the deviation only
    hits by the moving car.

    Attributes:
        plan: what was assessed.
        kamikaze: the kamikazes of each φ.
        confidence: confidence of the intervals over φ; above 95 % if they were looked at before more φ were run.
    """

    plan: Plan
    kamikaze: tuple[KamikazeSet, ...]
    confidence: float = CONFIDENCE

    @cached_property
    def pairs(self) -> list[tuple[Trajectory, list[Pair]]]:
        """Each φ with its pairs (φ, ψ)."""
        return [(group.safe_trajectory, list(map(pair_of, group.logs))) for group in self.kamikaze]

    @cached_property
    def _distances(self) -> list[FloatArray]:
        """Deviation of each pair, by φ, m."""
        return [
            deviation_pairs(phi.positions, [one.psi.positions for one in mine], [one.duration for one in mine])
            for phi, mine in self.pairs
        ]

    @cached_property
    def skd(self) -> Skd:
        """Discrete Fréchet distances of all pairs."""
        return compute_skd(
            [(phi, [one.psi for one in mine]) for phi, mine in self.pairs],
            limited=self._distances if self.plan.limits_deviation else None,
            maximum_distance=self.plan.maximum_distance,
            confidence=self.confidence,
        )

    @cached_property
    def trial_deviations(self) -> list[FloatArray]:
        """Deviation of each trial that ran to its end, by φ, in the order of the trials, m; infinite without a hit."""
        found = []
        for group, distances in zip(self.kamikaze, self._distances, strict=True):
            of_collisions = iter(distances.tolist())
            of_trials = [next(of_collisions) if log.outcome == Outcome.COLLISION else np.inf for log in group.finished]
            found.append(np.where([log.hit for log in group.finished], of_trials, np.inf))
        return found

    @cached_property
    def _means(self) -> tuple[GroupedMean, GroupedMean]:
        return mean_deviation(self.trial_deviations, eta_max=self.plan.scenario.eta_max, confidence=self.confidence)

    @property
    def deviation(self) -> GroupedMean:
        """What each trial counts as in the mean deviation, by φ, m."""
        return self._means[0]

    @property
    def of_successes(self) -> GroupedMean:
        """Deviations of the trials that hit, by φ, m."""
        return self._means[1]

    def numbered_deviations(self, counts: Sequence[int]) -> list[FloatArray]:
        """Return what so many trials of each φ count as, by their number, m; nan: it was aborted, or not run."""
        found = []
        for group, values, count in zip(self.kamikaze, self.deviation.groups, counts, strict=True):
            every = np.full(count, np.nan)
            for log, value in zip(group.finished, values.tolist(), strict=True):
                if (number := split_episode_id(log.episode.episode_id)[2]) < count:
                    every[number] = value
            found.append(every)
        return found

    @property
    def trials(self) -> int:
        """Kamikaze episodes run, aborted ones not counted."""
        return sum(len(group.finished) for group in self.kamikaze)

    @property
    def successes_by_phi(self) -> list[int]:
        """Per φ, the kamikaze episodes that reached what they planned for (`Plan.succeeds`)."""
        return [sum(map(self.plan.succeeds, kamikaze.logs)) for kamikaze in self.kamikaze]

    @property
    def successes(self) -> int:
        """Kamikaze episodes that reached what they planned for (`Plan.succeeds`)."""
        return sum(self.successes_by_phi)

    @property
    def success_rate(self) -> float | None:
        """Share of the kamikaze episodes that ended in a collision; None where none was run."""
        return self.successes / self.trials if self.trials else None

    @property
    def clustered_success_rate(self) -> Clustered | None:
        """The success rate with what its error over φ is."""
        counts = zip(self.successes_by_phi, (len(group.finished) for group in self.kamikaze), strict=True)
        return clustered_rate(list(counts), self.confidence)

    @property
    def reasons(self) -> list[str]:
        """Why kamikaze episodes were aborted, one each."""
        return [log.reason for group in self.kamikaze for log in group.episodes if log.outcome == Outcome.ABORTED]

    def bounds(self) -> dict[str, float]:
        """Return η → Theorem 1's bound on P(d ≤ η), for those of BOUND_ETAS below SKD; none below two pairs."""
        mean, variance = self.skd.distances.mean, self.skd.distances.variance
        if mean is None or variance is None:
            return {}
        return {f"{eta:g}": frechet_probability_bound(eta, mean, variance) for eta in BOUND_ETAS if eta < mean}

    def bound_intervals(self) -> dict[str, Interval | None]:
        """Return η → the interval over φ of the bound, for the η of `bounds`."""
        groups = self.skd.distances.groups
        return {name: bound_interval(groups, float(name), self.confidence) for name in self.bounds()}

    def clustering(self) -> dict[str, Any]:
        """Return what is known of the error over φ of each figure, by its name."""
        found = {
            "deviation": self.deviation.clustered,
            "skd": self.skd.distances.clustered,
            "skd_prefix": self.skd.prefixes.clustered,
            "success_rate": self.clustered_success_rate,
        }
        return {name: one and one.as_dict() for name, one in found.items()}

    @property
    def collisions(self) -> list[EpisodeLog]:
        """Kamikaze episodes that collided."""
        return [log for kamikaze in self.kamikaze for log in kamikaze.logs]

    def mean_of(self, value: Callable[[EpisodeLog], float]) -> float | None:
        """Return the mean of a number of each episode that collided; None without any."""
        found = list(map(value, self.collisions))
        return float(np.mean(found)) if found else None

    def figures(self) -> dict[str, Any]:
        """Return everything that is reported of these kamikazes: an entry under `objectives` of assessment.json."""
        return entries(OF_OBJECTIVES.values(), dict.fromkeys(Of, self))

    def measure_figures(self) -> dict[str, Any]:
        """Return the figures of the further measures, by name."""
        return {name: one.as_dict() for name, one in measure_pairs(self.pairs, self.skd.kept, self.confidence).items()}

    def per_safe_trajectory(self) -> list[dict[str, Any]]:
        """Return the figures of these kamikazes for each φ."""
        means = zip(
            self.deviation.means,
            self.of_successes.means,
            self.skd.distances.means,
            self.skd.prefixes.means,
            strict=True,
        )
        keys = ("deviation", "deviation_of_successes", "skd", "skd_prefix")
        rows = zip(self.kamikaze, self.successes_by_phi, self.skd.kept, means, strict=True)
        return [
            {
                "name": kamikaze.safe_trajectory.name,
                **dict(zip(keys, found, strict=True)),
                "pairs": len(kept),
                "trials": len(kamikaze.episodes),
                "failed": len(kamikaze.finished) - successes,
                "aborted": kamikaze.aborted,
            }
            for kamikaze, successes, kept, found in rows
        ]
