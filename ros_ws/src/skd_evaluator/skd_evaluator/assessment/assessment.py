"""The assessment of a car: what the kamikazes of each objective reached, all else that is known, and its figures."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from skd_sim.errors import AssessmentError
from skd_sim.options.car_and_adversary import (
    DEFAULT_OBJECTIVES,
    RANKING_OBJECTIVES,
    SKD_OBJECTIVES,
    Objective,
    first_of,
)
from skd_sim.world.episode import EpisodeLog, Outcome
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.assessment.episode_figures import Surrogates, lane_left, surrogates_of
from skd_evaluator.assessment.figure_table import AT_THE_TOP, OF_OBJECTIVES, Of, entries, figures_html
from skd_evaluator.assessment.plan import Plan, split_episode_id
from skd_evaluator.metrics.aborted import NOT_CREDIBLE, not_credible
from skd_evaluator.metrics.clustered import GroupedMean, GroupedRate
from skd_evaluator.metrics.deviation import deviation_pairs, mean_deviation
from skd_evaluator.metrics.margins import EquivalentMultiplier, Margins, ReferenceMargin, optimality_gap
from skd_evaluator.metrics.measures import Pair, measure_pairs, pair_of
from skd_evaluator.metrics.price_of_caution import PriceOfCaution, lanes_left
from skd_evaluator.metrics.risks import Risks
from skd_evaluator.metrics.sample_size import UntilWidth
from skd_evaluator.metrics.skd import Skd, bound_interval, compute_skd
from skd_evaluator.metrics.statistics import Interval, frechet_probability_bound
from skd_evaluator.metrics.vulnerability_curve import BudgetPoint, Vulnerability, vulnerability_curve

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

    @cached_property
    def success_rate(self) -> GroupedRate:
        """Share of the kamikaze episodes that reached what they planned for."""
        trials = (len(group.finished) for group in self.kamikaze)
        return GroupedRate(list(zip(self.successes_by_phi, trials, strict=True)), self.confidence)

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
            "success_rate": self.success_rate.clustered,
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


HIT_SHARE = 0.95
"""Share of the runs along a safe trajectory above which, if they are hit, it is no safe one for this car."""
_FEWEST_RUNS = 10


@dataclass(frozen=True)
class Assessment:
    """What is known of a car: each stage adds to it, and the figures of assessment.json follow from it.

    Attributes:
        plan: what is assessed; once kamikazes have run, its objective is the first of theirs.
        safe: the safe trajectories Φ.
        results: what the kamikazes of each objective reached, in the order of `in_order`.
        nominal_runs: runs of the car against an adversary that follows φ.
        seconds: wall-clock time it took.
        confidence: confidence of the intervals by φ; above 95 % if they were looked at before more φ were run.
        margins: the minimal deviation of each trial; None where the margin is not known.
        margin_note: why the margin is not known; else empty.
        risks: the risk; None where it is not known.
        risk_note: why the risk is not known; else empty.
        price: what caution costs; None: not known.
        price_note: why not; else empty.
        equivalent: the C of the basic car with the same margin on the same φ; None where the margin is not known.
        equivalent_note: how it was found, or why there is none.
        reference: how the car stands beside each reference driver, if that was requested.
        budgets: how often kamikazes were hit that were bounded in their deviation, if that was requested.
        left_out: what recordings held besides, and why it does not count, a line each.
        warnings: what a reader should know of the episodes that count, a line each.
        until_width: when and why the assessment stopped, if it went on until its interval was narrow enough.
        provenance: what ran, when and where (`skd_evaluator.provenance`).
        static_tests: what came of the protocol's static tests, an entry of assessment.json each.
        simulation: what a simulator other than SKD's own says of the car in it; None where it says nothing.
    """

    plan: Plan
    safe: tuple[Trajectory, ...] = ()
    results: tuple[ObjectiveResult, ...] = ()
    nominal_runs: tuple[EpisodeLog, ...] = ()
    seconds: float = 0.0
    confidence: float = CONFIDENCE
    margins: Margins | None = None
    margin_note: str = ""
    risks: Risks | None = None
    risk_note: str = ""
    price: PriceOfCaution | None = None
    price_note: str = ""
    equivalent: EquivalentMultiplier | None = None
    equivalent_note: str = ""
    reference: tuple[ReferenceMargin, ...] = ()
    budgets: tuple[BudgetPoint, ...] = ()
    left_out: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    until_width: UntilWidth | None = None
    provenance: Mapping[str, Any] | None = None
    static_tests: tuple[Mapping[str, Any], ...] = ()
    simulation: Mapping[str, Any] | None = None

    @property
    def for_skd(self) -> ObjectiveResult:
        """The assessment whose SKD is reported first: by the paper's objective, where that ran."""
        return self._first_of(SKD_OBJECTIVES)

    @property
    def for_deviation(self) -> ObjectiveResult:
        """The assessment whose deviation is reported first: by objective `deviation`, where that ran."""
        return self._first_of(RANKING_OBJECTIVES)

    def _first_of(self, preferred: Sequence[Objective]) -> ObjectiveResult:
        found = {one.plan.objective: one for one in self.results}
        return found[first_of(preferred, found)]

    @property
    def _by_objective(self) -> list[tuple[EpisodeLog, str]]:
        """All episodes, kamikazes with their objective, then those along φ; aborted ones included."""
        named = [(str(one.plan.objective), group.episodes) for one in self.results for group in one.kamikaze]
        return [(log, name) for name, logs in (*named, ("", self.nominal_runs)) for log in logs]

    @property
    def episodes(self) -> int:
        """Episodes run, kamikaze and along φ, aborted ones included."""
        return len(self._by_objective)

    @property
    def reasons(self) -> list[str]:
        """Why episodes were aborted, one each."""
        return [log.reason for log, _ in self._by_objective if log.outcome == Outcome.ABORTED]

    @property
    def clipped(self) -> list[int]:
        """Per episode in which the car was commanded more than it can do, how often."""
        return [log.clipped for log, _ in self._by_objective if log.clipped]

    @property
    def kamikaze_logs(self) -> list[EpisodeLog]:
        """Kamikaze episodes that ran to their end."""
        return [log for one in self.results for group in one.kamikaze for log in group.finished]

    @property
    def logs(self) -> list[EpisodeLog]:
        """Episodes that ran to their end, and those along φ that did not."""
        return [*self.kamikaze_logs, *self.nominal_runs]

    @cached_property
    def contact_rate(self) -> GroupedRate:
        """Share of the runs along φ that ended in a collision."""
        return self._rate_along_phi(lambda log: log.outcome == Outcome.COLLISION)

    @cached_property
    def nominal_collision_rate(self) -> GroupedRate:
        """Share of the runs along φ that the moving car hit."""
        return self._rate_along_phi(lambda log: log.hit)

    def _rate_along_phi(self, counts_as: Callable[[EpisodeLog], bool]) -> GroupedRate:
        """Return the share of the runs along φ that count.

        Generated φ may be the same to the bit; their runs are told apart by the number of φ in the episode's id.
        """
        counts: dict[bytes, dict[int, list[int]]] = {}
        for log in self.nominal_runs:
            along = log.episode.safe_trajectory
            if log.outcome != Outcome.ABORTED and along is not None:
                index = split_episode_id(log.episode.episode_id)[1]
                count = counts.setdefault(along.positions.tobytes(), {}).setdefault(index, [0, 0])
                count[0] += counts_as(log)
                count[1] += 1
        alike = {place: [tuple(found[index]) for index in sorted(found)] for place, found in counts.items()}
        hits = []
        for one in self.safe:
            left = alike.get(one.positions.tobytes())
            hits.append(left.pop(0) if left else (0, 0))
        return GroupedRate([(hit, runs) for hit, runs in hits], self.confidence)

    def optimality_gap(self) -> tuple[float | None, Interval | None]:
        """Return how many times the margin the kamikazes that rank the car needed, in the same trials."""
        if self.margins is None or self.margins.lane not in ("", self.plan.scenario.oncoming_lane):
            return None, None
        margins, result = self.margins.per_phi, self.for_deviation
        return optimality_gap(result.numbered_deviations(list(map(len, margins))), margins, result.confidence)

    @cached_property
    def surrogates(self) -> Surrogates:
        """The surrogate safety measures of all episodes, in the order of episodes.npz."""
        return surrogates_of(self.plan.scenario, self._by_objective)

    @property
    def vulnerability(self) -> Vulnerability | None:
        """The vulnerability curves, of margins and of planned kamikazes; None without a trial."""
        planned = vulnerability_curve(self.for_deviation.deviation.groups, self.plan.scenario.eta_max)
        if planned is None:
            return None
        return Vulnerability(planned, self.budgets, None if self.margins is None else self.margins.curve)

    @cached_property
    def lanes_left(self) -> tuple[float, float] | None:
        """In which share of the runs along φ the car leaves its lane, and for how long, s; None: in none."""
        return lanes_left([*map(lane_left, self.nominal_runs)])

    def failed(self, error: AssessmentError, **notes: Any) -> Assessment:
        """Return the assessment of a car that failed in a stage; its other figures stay, beside a warning.

        Args:
            error: how it failed.
            notes: fields that say which figure is not known for it.
        """
        return replace(self, warnings=tuple(dict.fromkeys((*self.warnings, f"{NOT_CREDIBLE}{error}"))), **notes)

    @property
    def credible(self) -> bool:
        """Whether no warning says that the figures are not."""
        return not not_credible(self.warnings)

    def _repr_html_(self) -> str:
        return figures_html(self.as_dict(), not_credible(self.warnings))

    @cached_property
    def objectives(self) -> dict[str, dict[str, Any]]:
        """All figures of the kamikazes of each objective, by its name."""
        return {str(one.plan.objective): one.figures() for one in self.results}

    def as_dict(self) -> dict[str, Any]:
        """Return the content of assessment.json.

        At the top `skd` and what belongs to it are those of the paper's objective and `deviation` that of objective
        `deviation`, or both of the only objective that ran; under `objectives` are all figures of each.
        """
        subjects: dict[Of, Any] = {Of.MARGIN: self.margins, Of.RISK: self.risks, Of.PRICE: self.price}
        subjects |= {Of.CAR: self, Of.SETTING: self, Of.RANKING: self.for_deviation, Of.SKD: self.for_skd}
        return entries(AT_THE_TOP.values(), subjects)

    def clustering(self) -> dict[str, Any]:
        """Return what is known of the error over φ of each figure at the top, by its key."""
        parts = {Of.RANKING: self.for_deviation.clustering(), Of.SKD: self.for_skd.clustering()}
        clustered = self.contact_rate.clustered
        parts[Of.CAR] = {"contact_rate": clustered and clustered.as_dict()}
        return {one.key: parts[one.of][one.source or one.key] for one in AT_THE_TOP.values() if one.clustered}

    def stated_provenance(self) -> dict[str, Any] | None:
        """Return what ran, when and where, with the digest of the car model; None: it is not known."""
        if self.provenance is None:
            return None
        model = self.plan.car_model
        return {**self.provenance, "car_model_sha256": hashlib.sha256(model.encode()).hexdigest() if model else None}

    def per_safe_trajectory(self) -> list[dict[str, Any]]:
        """Return the figures of each φ: its SKD and deviation, and how often it was hit in runs along it."""
        of_skd, of_deviation = (
            self.objectives[str(one.plan.objective)]["per_safe_trajectory"]
            for one in (self.for_skd, self.for_deviation)
        )
        rows = zip(of_skd, of_deviation, self.contact_rate.counts, strict=True)
        return [
            {
                **skd,
                **{name: deviation[name] for name in ("deviation", "deviation_of_successes")},
                "contact_rate": hits / runs if runs else None,
                "collision_runs": runs,
                "safe": runs < _FEWEST_RUNS or hits <= HIT_SHARE * runs,
            }
            for skd, deviation, (hits, runs) in rows
        ]


def in_order(objectives: Sequence[Objective]) -> tuple[Objective, ...]:
    """Return objectives in the order in which they run and are reported: `deviation` first."""
    order = [*DEFAULT_OBJECTIVES, *Objective, *sorted(objectives)]
    return tuple(sorted(set(objectives), key=order.index))


def objective_results(
    plan: Plan, kamikaze: Mapping[Objective, Sequence[KamikazeSet]], confidence: float = CONFIDENCE
) -> tuple[ObjectiveResult, ...]:
    """Compute the result of each objective of which kamikazes have been run, now or long ago.

    Args:
        plan: what was assessed, whatever its objective.
        kamikaze: Ψ(φ) per φ, by objective; at least of one.
        confidence: confidence of the intervals over φ.
    """
    return tuple(
        ObjectiveResult(replace(plan, objective=objective), tuple(kamikaze[objective]), confidence)
        for objective in in_order(tuple(kamikaze))
    )


def assessment_of(
    plan: Plan,
    safe: Sequence[Trajectory],
    kamikaze: Mapping[Objective, Sequence[KamikazeSet]],
    nominal_runs: Sequence[EpisodeLog],
    confidence: float = CONFIDENCE,
) -> Assessment:
    """Return the assessment that follows from episodes; see `objective_results`."""
    results = objective_results(plan, kamikaze, confidence)
    return Assessment(results[0].plan, tuple(safe), results, tuple(nominal_runs), confidence=confidence)
