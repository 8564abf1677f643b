"""The Safe-Kamikaze Distance of sets of trajectories (paper, section "Safe-Kamikaze Distance")."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.world.state import Trajectory

from skd_evaluator.metrics.clustered import DISTANCES, PREFIXES, Clustered, Prior, clustered_mean
from skd_evaluator.metrics.frechet import discrete_frechet_pairs
from skd_evaluator.metrics.statistics import (
    Interval,
    bound_influence,
    frechet_probability_bound,
    mean,
    normal_interval,
    sample_variance,
)


@dataclass(frozen=True, eq=False)
class SafeTrajectorySkd:
    """What the pairs of one φ contribute.

    Attributes:
        name: name of φ.
        distances: discrete Fréchet distance of each pair kept, m.
        prefix_distances: the same with φ cut at the duration of ψ, m.
        kept: indices of the pairs kept in the list of ψ that was given.
        discarded_by_distance: number of ψ left out because they are further than the maximum distance.
    """

    name: str
    distances: FloatArray
    prefix_distances: FloatArray
    kept: npt.NDArray[np.int64]
    discarded_by_distance: int

    @property
    def pairs(self) -> int:
        """Number of pairs kept."""
        return int(self.distances.size)

    @property
    def mean_distance(self) -> float | None:
        """Mean distance, m; None without a pair."""
        return mean(self.distances) if self.pairs else None

    @property
    def mean_prefix_distance(self) -> float | None:
        """Mean prefix distance, m; None without a pair."""
        return mean(self.prefix_distances) if self.pairs else None


@dataclass(frozen=True, eq=False)
class SkdResult:
    """The SKD and what is reported with it. What cannot be computed is None, never 0 or NaN.

    Attributes:
        skd: mean distance over all pairs, m; None: no kamikaze found.
        skd_ci95_pairs: the paper's normal interval over pairs, m; None below two pairs.
        clustered: the same mean with what its error over φ is, m; None without a pair.
        skd_prefix: mean prefix distance, φ cut at the duration of ψ, m.
        skd_prefix_ci95_pairs: normal 95 % interval of the prefix distance over pairs, m.
        prefix_clustered: the same mean with what its error over φ is, m.
        variance: sample variance of the distance, m²; None below two pairs.
        pairs: number of pairs in the mean.
        discarded_by_distance: number of pairs left out as further than the maximum distance.
        per_safe_trajectory: one entry for each φ, in the order given, including those without a pair.
    """

    skd: float | None
    skd_ci95_pairs: Interval | None
    clustered: Clustered | None
    skd_prefix: float | None
    skd_prefix_ci95_pairs: Interval | None
    prefix_clustered: Clustered | None
    variance: float | None
    pairs: int
    discarded_by_distance: int
    per_safe_trajectory: tuple[SafeTrajectorySkd, ...]

    @property
    def skd_ci95(self) -> Interval | None:
        """Interval of the SKD over φ, m; None where fewer than two φ have pairs."""
        return self.clustered.interval if self.clustered else None

    @property
    def distances(self) -> FloatArray:
        """Distance of every pair, φ by φ, m."""
        return _joined([entry.distances for entry in self.per_safe_trajectory])

    @property
    def prefix_distances(self) -> FloatArray:
        """Prefix distance of every pair, φ by φ, m."""
        return _joined([entry.prefix_distances for entry in self.per_safe_trajectory])

    def bound(self, eta: float) -> float:
        """Return Theorem 1's upper bound of P(d ≤ η), from this sample's mean and variance.

        Args:
            eta: η, m, in (0, skd).

        Raises:
            ValueError: η is outside (0, skd), or there are fewer than two pairs and hence no variance.
        """
        if self.skd is None or self.variance is None:
            raise ValueError(f"the bound needs at least two pairs, there are {self.pairs}")
        return frechet_probability_bound(eta, self.skd, self.variance)

    def bound_interval(self, eta: float, confidence: float = 0.95) -> Interval | None:
        """Return the interval over φ of `bound`, by the delta method: what other φ might have made of it.

        It is of the kamikazes that were run, as the bound is; a better adversary has a bound of its own.

        Args:
            eta: η, m, in (0, skd).
            confidence: two-sided, in (0, 1).

        Returns:
            None where fewer than two φ have pairs.

        Raises:
            ValueError: as `bound`.
        """
        self.bound(eta)  # refuses what has none
        return bound_interval([entry.distances for entry in self.per_safe_trajectory], eta, confidence)


def bound_interval(groups: Sequence[FloatArray], eta: float, confidence: float = 0.95) -> Interval | None:
    """Return the interval over φ of Theorem 1's bound; see `SkdResult.bound_interval`.

    Args:
        groups: distances of the pairs of each φ, m, at least two in all.
        eta: η, m, between 0 and their mean.
        confidence: two-sided, in (0, 1).
    """
    every = _joined(groups)
    centre, variance = mean(every), sample_variance(every)
    assert variance is not None
    value = frechet_probability_bound(eta, centre, variance)
    influences = [bound_influence(group, eta, centre, variance) for group in groups]
    found = clustered_mean(influences, confidence, prior=DISTANCES.mirrored)  # it falls where distances rise
    if found is None or found.interval is None:
        return None
    low, high = (value + end - found.value for end in found.interval)
    return max(0.0, low), min(1.0, high)


def compute_skd(
    pairs_by_phi: Iterable[tuple[Trajectory, Sequence[Trajectory]]],
    *,
    maximum_distance: float | None = None,
    confidence: float = 0.95,
) -> SkdResult:
    """Compute the SKD of safe trajectories φ and the kamikaze trajectories ψ that were generated for each.

    Args:
        pairs_by_phi: each φ with its ψ; a φ may have none.
        maximum_distance: pairs further apart than this are left out and counted, m; None keeps all.
        confidence: confidence of the intervals over φ; intervals over pairs have 95 %.

    Raises:
        UsageError: the trajectories of a pair differ in time step or in dimension, or the maximum distance is
            negative.
    """
    measured = [(phi, frechet_distances(phi, psis), prefix_distances(phi, psis)) for phi, psis in pairs_by_phi]
    return skd_of(
        [kept_pairs(phi.name, far, prefix, far, maximum_distance) for phi, far, prefix in measured], confidence
    )


def kept_pairs(
    name: str, distances: FloatArray, prefixes: FloatArray, limited: FloatArray, maximum_distance: float | None
) -> SafeTrajectorySkd:
    """Return what the pairs of one φ contribute.

    Args:
        name: name of φ.
        distances: discrete Fréchet distance of each pair, m.
        prefixes: the same with φ cut at the duration of ψ, m.
        limited: for each pair the value to which the maximum distance applies, m.
        maximum_distance: m, ≥ 0; None keeps all.

    Raises:
        UsageError: the maximum distance is negative.
    """
    if maximum_distance is not None and not maximum_distance >= 0.0:
        raise UsageError(f"maximum distance must be 0 m or more, got {maximum_distance}")
    most = math.inf if maximum_distance is None else maximum_distance
    kept = np.flatnonzero(~(limited > most))
    return SafeTrajectorySkd(
        name, _frozen(distances[kept]), _frozen(prefixes[kept]), kept, len(distances) - int(kept.size)
    )


def skd_of(entries: Sequence[SafeTrajectorySkd], confidence: float = 0.95) -> SkdResult:
    """Return the SKD over all φ; the confidence is that of the intervals over φ."""
    distances = _joined([entry.distances for entry in entries])
    prefixes = _joined([entry.prefix_distances for entry in entries])
    found = distances.size > 0
    return SkdResult(
        skd=mean(distances) if found else None,
        skd_ci95_pairs=normal_interval(distances),
        clustered=_over_phi([entry.distances for entry in entries], DISTANCES, confidence),
        skd_prefix=mean(prefixes) if found else None,
        skd_prefix_ci95_pairs=normal_interval(prefixes),
        prefix_clustered=_over_phi([entry.prefix_distances for entry in entries], PREFIXES, confidence),
        variance=sample_variance(distances),
        pairs=int(distances.size),
        discarded_by_distance=sum(entry.discarded_by_distance for entry in entries),
        per_safe_trajectory=tuple(entries),
    )


def _over_phi(groups: Sequence[FloatArray], prior: Prior, confidence: float) -> Clustered | None:
    return clustered_mean(groups, confidence, prior=prior, limits=(0.0, math.inf))


def frechet_distances(phi: Trajectory, psis: Sequence[Trajectory]) -> FloatArray:
    """Return the discrete Fréchet distance of each ψ to φ, m.

    Raises:
        UsageError: the trajectories of a pair differ in time step or in dimension.
    """
    for index, psi in enumerate(psis):
        _check_pair(phi, psi, index)
    return discrete_frechet_pairs(phi.positions, [psi.positions for psi in psis])


def prefix_distances(phi: Trajectory, psis: Sequence[Trajectory]) -> FloatArray:
    """Return the distances to φ cut at the duration of each ψ, m.

    Both are sampled with one time step from time 0, so equal durations are equal counts of points. A ψ that
    lasts longer than φ meets the whole of φ.
    """
    counts = np.array([min(len(psi), len(phi)) for psi in psis], dtype=np.int64)
    distances = np.empty(len(psis))
    for count in np.unique(counts):
        same = np.flatnonzero(counts == count).tolist()
        cut = phi.prefix(int(count)).positions
        distances[same] = discrete_frechet_pairs(cut, [psis[index].positions for index in same])
    return distances


def _check_pair(phi: Trajectory, psi: Trajectory, index: int) -> None:
    pair = f"ψ {psi.name or index!r} of φ {phi.name!r}"
    if not math.isclose(phi.time_step, psi.time_step, rel_tol=1e-9):
        raise UsageError(f"{pair} has a time step of {psi.time_step} s, φ has {phi.time_step} s: resample one of them")
    if phi.positions.shape[1] != psi.positions.shape[1]:
        raise UsageError(f"{pair} has {psi.positions.shape[1]} coordinates a position, φ has {phi.positions.shape[1]}")


def _joined(parts: Sequence[FloatArray]) -> FloatArray:
    return np.concatenate(parts) if parts else np.empty(0)


def _frozen(values: FloatArray) -> FloatArray:
    values.setflags(write=False)
    return values
