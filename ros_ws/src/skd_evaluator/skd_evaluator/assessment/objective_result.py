"""The assessment of a car by kamikazes of one objective: what they reached, and everything reported with it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.world.episode import EpisodeLog, Outcome
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.figure_table import OF_OBJECTIVES, Of, entries
from skd_evaluator.assessment.plan import Plan, split_episode_id
from skd_evaluator.metrics.clustered import Clustered, GroupedMean, clustered_rate
from skd_evaluator.metrics.deviation import deviation_pairs, mean_deviation
from skd_evaluator.metrics.measures import Measured, measure_pairs, pair_of
from skd_evaluator.metrics.skd import Skd, bound_interval, compute_skd
from skd_evaluator.metrics.statistics import Interval, frechet_probability_bound

BOUND_ETAS = (0.25, 0.5, 1.0)
"""Distances η (m) for which Theorem 1's bound is reported."""
CONFIDENCE = 0.95


@dataclass(frozen=True)
class KamikazeSet:
    """Ψ(φ): the kamikaze episodes of one safe trajectory that collided, and what became of the others.

    Attributes:
        safe_trajectory: the safe trajectory φ.
        logs: the episodes that collided.
        trials: number of episodes.
        misses: the episodes that ran to their end and did not collide.
        lost: the episodes that were aborted.
    """

    safe_trajectory: Trajectory
    logs: tuple[EpisodeLog, ...]
    trials: int
    misses: tuple[EpisodeLog, ...] = ()
    lost: tuple[EpisodeLog, ...] = ()

    @property
    def in_order(self) -> list[EpisodeLog]:
        """Logs of all episodes, in the order of their trials."""
        return sorted((*self.logs, *self.misses, *self.lost), key=lambda log: log.episode.episode_id)

    @property
    def reasons(self) -> list[str]:
        """Why episodes were aborted, one each."""
        return [log.reason for log in self.lost]

    @property
    def clipped(self) -> list[int]:
        """Per episode in which the car was commanded more than it can do, how often."""
        return [log.clipped for log in self.in_order if log.clipped]

    @property
    def aborted(self) -> int:
        """Number of episodes that were aborted."""
        return len(self.lost)


def kamikaze_set(safe_trajectory: Trajectory, logs: Iterable[EpisodeLog]) -> KamikazeSet:
    """Return Ψ(φ) of the kamikaze episodes that were run for φ, in the order of their trials."""
    tried = tuple(logs)
    return KamikazeSet(
        safe_trajectory,
        tuple(log for log in tried if log.outcome == Outcome.COLLISION),
        len(tried),
        tuple(log for log in tried if log.outcome not in (Outcome.COLLISION, Outcome.ABORTED)),
        tuple(log for log in tried if log.outcome == Outcome.ABORTED),
    )


@dataclass(frozen=True)
class ObjectiveResult:
    """What the kamikazes of one objective reached, and everything reported with it.

    Attributes:
        plan: what was assessed.
        kamikaze: Ψ(φ) per φ.
        skd: discrete Fréchet distances of all pairs.
        deviation: what each trial counts as in the mean deviation, by φ, m.
        of_successes: deviations of the trials that hit, by φ, m.
        trial_deviations: for each φ, what each trial counts as in the mean deviation, in the order of the
            trials, m; nan: it was aborted, or not run.
        measured: the further measures of all pairs, by name.
        confidence: confidence of the intervals over φ; above 95 % if somebody looked at them before more φ were run.
    """

    plan: Plan
    kamikaze: tuple[KamikazeSet, ...]
    skd: Skd
    deviation: GroupedMean
    of_successes: GroupedMean
    trial_deviations: tuple[FloatArray, ...] = ()
    measured: Mapping[str, Measured] = field(default_factory=dict)
    confidence: float = CONFIDENCE

    @property
    def trials(self) -> int:
        """Kamikaze episodes run, aborted ones not counted."""
        return sum(kamikaze.trials - kamikaze.aborted for kamikaze in self.kamikaze)

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
        trials = [group.trials - group.aborted for group in self.kamikaze]
        return clustered_rate(list(zip(self.successes_by_phi, trials, strict=True)), self.confidence)

    @property
    def reasons(self) -> list[str]:
        """Why kamikaze episodes were aborted, one each."""
        return [reason for kamikaze in self.kamikaze for reason in kamikaze.reasons]

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
        return {name: one.figures(self.skd.kept, self.confidence) for name, one in self.measured.items()}

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
                "trials": kamikaze.trials,
                "failed": kamikaze.trials - kamikaze.aborted - successes,
                "aborted": kamikaze.aborted,
            }
            for kamikaze, successes, kept, found in rows
        ]


def objective_result(plan: Plan, kamikaze: Sequence[KamikazeSet], confidence: float = CONFIDENCE) -> ObjectiveResult:
    """Compute the result of kamikazes of one objective that have been run, now or long ago.

    A maximum distance applies to the distance for which the objective plans: kamikazes of objective `deviation` are
    discarded by their deviation, others by their Fréchet distance. Discarded kamikazes do not count in SKD. The mean
    deviation is over all trials, each with the deviation that it needed. SKD counts all collisions, the
    deviation only hits by the moving car.
    """
    pairs = [(group.safe_trajectory, [pair_of(log) for log in group.logs]) for group in kamikaze]
    deviations = [
        deviation_pairs(phi.positions, [one.psi.positions for one in mine], [one.duration for one in mine])
        for phi, mine in pairs
    ]
    trials = [_hits_of(group, distances) for group, distances in zip(kamikaze, deviations, strict=True)]
    eta_max = plan.scenario.eta_max
    deviation, of_successes = mean_deviation(trials, eta_max=eta_max, confidence=confidence)
    return ObjectiveResult(
        plan,
        tuple(kamikaze),
        compute_skd(
            [(phi, [one.psi for one in mine]) for phi, mine in pairs],
            limited=deviations if plan.limits_deviation else None,
            maximum_distance=plan.maximum_distance,
            confidence=confidence,
        ),
        deviation,
        of_successes,
        measured=measure_pairs(pairs),
        confidence=confidence,
        trial_deviations=tuple(
            _by_trial(group, distances, eta_max) for group, distances in zip(kamikaze, deviations, strict=True)
        ),
    )


def _hits_of(group: KamikazeSet, distances: FloatArray) -> tuple[FloatArray, int]:
    """Return the deviations on one φ with which the moving car hit, m, and how many other trials ran to their end."""
    hit = np.array([log.hit for log in group.logs], dtype=bool)
    return distances[hit], group.trials - group.aborted - int(hit.sum())


def _by_trial(group: KamikazeSet, distances: FloatArray, eta_max: float) -> FloatArray:
    """Return the deviation that each trial on a φ counts as, by its number, m; nan: it was aborted, or not run."""
    numbers = [split_episode_id(log.episode.episode_id)[2] for log in group.in_order]
    found = np.full(max(numbers, default=-1) + 1, np.nan)
    for log in group.misses:
        found[split_episode_id(log.episode.episode_id)[2]] = eta_max
    for log, distance in zip(group.logs, distances.tolist(), strict=True):
        found[split_episode_id(log.episode.episode_id)[2]] = min(distance, eta_max) if log.hit else eta_max
    return found
