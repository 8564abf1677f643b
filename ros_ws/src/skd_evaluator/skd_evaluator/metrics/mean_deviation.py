"""The mean deviation of a car: what a kamikaze needed, over all trials, those that failed included.

A mean over successes alone flatters a car that is hit easily and hides one that is hardly ever hit: of the latter only
the lucky trials would count. So a trial that fails counts as η_max, and so does one that needed more. That is the
restricted mean of survival analysis (Royston and Parmar, BMC Medical Research Methodology 13:152, 2013), with the
deviation in the place of time: ∫ (1 − P(η)) dη from 0 to η_max, where P(η) is the share of trials that hit the car
within a deviation of η.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.world.state import Trajectory

from skd_evaluator.metrics.distances.deviation import deviation_pairs
from skd_evaluator.metrics.distances.measures import Measure
from skd_evaluator.metrics.statistics.clustered import Clustered, clustered_mean
from skd_evaluator.metrics.statistics.prior import DISTANCES
from skd_evaluator.metrics.statistics.statistics import Interval, mean, normal_interval


@dataclass(frozen=True, eq=False)
class Trials:
    """The trials on one φ.

    Attributes:
        phi: the safe trajectory φ.
        psis: the trajectories ψ of the trials that collided, each up to its contact.
        durations: times of the contacts, in ticks since the start, one for each ψ.
        failed: number of trials that ran to their end and did not collide.
        measured: deviation of each ψ, m, where it is known already.
    """

    phi: Trajectory
    psis: Sequence[Trajectory]
    durations: Sequence[float]
    failed: int
    measured: FloatArray | None = None

    def distances(self) -> FloatArray:
        """Return the deviation of each ψ, m."""
        if self.measured is not None:
            return self.measured
        return _distances(self.phi, self.psis, self.durations)


@dataclass(frozen=True, eq=False)
class SafeTrajectoryDeviation:
    """What the trials on one φ needed.

    Attributes:
        name: name of φ.
        distances: deviation of each trial that collided, in the order of the ψ given, m.
        failed: number of trials that did not collide.
        eta_max: η_max, m: what a trial counts as that failed.
    """

    name: str
    distances: FloatArray
    failed: int
    eta_max: float

    @property
    def trials(self) -> int:
        """Number of trials."""
        return int(self.distances.size) + self.failed

    @property
    def restricted(self) -> FloatArray:
        """What each trial counts as, those that collided first, m."""
        return np.concatenate([np.minimum(self.distances, self.eta_max), np.full(self.failed, self.eta_max)])

    @property
    def mean(self) -> float | None:
        """Restricted mean, m; None without a trial."""
        return mean(self.restricted) if self.trials else None

    @property
    def mean_of_successes(self) -> float | None:
        """Mean over the trials that collided, m; None where none did."""
        return mean(self.distances) if self.distances.size else None


@dataclass(frozen=True, eq=False)
class MeanDeviation:
    """The mean deviation and what is reported with it. What cannot be computed is None.

    Attributes:
        mean: restricted mean over all trials, m; None without a trial.
        ci95: normal 95 % interval over trials, m; None with fewer than two.
        clustered: the same mean with what its error over φ is, m; None without a trial.
        of_successes: mean over the trials that collided, m.
        of_successes_ci95: normal 95 % interval of the mean over successes, m.
        eta_max: η_max, m: what a trial counts as that failed.
        per_safe_trajectory: one entry for each φ, in the order given.
    """

    mean: float | None
    ci95: Interval | None
    clustered: Clustered | None
    of_successes: float | None
    of_successes_ci95: Interval | None
    eta_max: float
    per_safe_trajectory: tuple[SafeTrajectoryDeviation, ...]

    @property
    def ci95_clustered(self) -> Interval | None:
        """Interval of the mean over φ, m; None where fewer than two φ have trials."""
        return self.clustered.interval if self.clustered else None

    @property
    def distances(self) -> FloatArray:
        """Deviation of every trial that collided, φ by φ, m."""
        return np.concatenate([np.empty(0), *(entry.distances for entry in self.per_safe_trajectory)])

    @property
    def restricted(self) -> FloatArray:
        """What every trial counts as, φ by φ, m."""
        return np.concatenate([np.empty(0), *(entry.restricted for entry in self.per_safe_trajectory)])

    @property
    def trials(self) -> int:
        """Number of trials."""
        return sum(entry.trials for entry in self.per_safe_trajectory)


def mean_deviation(
    trials_by_phi: Iterable[Trials],
    *,
    eta_max: float,
    confidence: float = 0.95,
) -> MeanDeviation:
    """Compute the mean deviation of trials on safe trajectories.

    Args:
        trials_by_phi: the trials on each φ.
        eta_max: η_max, m, > 0.
        confidence: confidence of the interval over φ; intervals over trials have 95 %.

    Raises:
        ValueError: η_max is not positive; or as `deviation_pairs`.
    """
    if not eta_max > 0.0:
        raise ValueError(f"eta_max must be positive, got {eta_max}")
    entries = tuple(
        SafeTrajectoryDeviation(
            one.phi.name,
            one.distances(),
            one.failed,
            eta_max,
        )
        for one in trials_by_phi
    )
    groups = [entry.restricted for entry in entries]
    counting = np.concatenate([np.empty(0), *groups])
    collided = np.concatenate([np.empty(0), *(entry.distances for entry in entries)])
    return MeanDeviation(
        mean=mean(counting) if counting.size else None,
        ci95=normal_interval(counting),
        clustered=clustered_mean(groups, confidence, prior=DISTANCES, limits=(0.0, eta_max)),
        of_successes=mean(collided) if collided.size else None,
        of_successes_ci95=normal_interval(collided),
        eta_max=eta_max,
        per_safe_trajectory=entries,
    )


def _distances(phi: Trajectory, psis: Sequence[Trajectory], durations: Sequence[float]) -> FloatArray:
    return deviation_pairs(phi.positions, [psi.positions for psi in psis], np.asarray(durations, float))


DEVIATION = Measure(
    "deviation",
    "m",
    lambda phi, pairs: _distances(phi, [pair.psi for pair in pairs], [pair.duration for pair in pairs]),
    shown=False,
    headline=True,
)
