"""The Safe-Kamikaze Distance of sets of trajectories (paper, section "Safe-Kamikaze Distance")."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.errors import UsageError
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator.metrics.clustered import DISTANCES, PREFIXES, GroupedMean, clustered_mean
from skd_evaluator.metrics.frechet import discrete_frechet_pairs
from skd_evaluator.metrics.statistics import Interval, bound_influence, frechet_probability_bound, mean, sample_variance


class Skd(NamedTuple):
    """The SKD: the mean discrete Fréchet distance of all pairs, and what is reported with it.

    Attributes:
        distances: discrete Fréchet distance of each pair that counts, by φ, m.
        prefixes: the same with φ cut at the duration of ψ, m.
        kept: per φ, places of these pairs in the list of ψ that was given.
        discarded: number of pairs left out as further than the maximum distance.
    """

    distances: GroupedMean
    prefixes: GroupedMean
    kept: tuple[npt.NDArray[np.int64], ...]
    discarded: int


def compute_skd(
    pairs_by_phi: Iterable[tuple[Trajectory, Sequence[Trajectory]]],
    *,
    limited: Sequence[FloatArray] | None = None,
    maximum_distance: float | None = None,
    confidence: float = 0.95,
) -> Skd:
    """Compute the SKD of safe trajectories φ and the kamikaze trajectories ψ that were generated for each.

    Args:
        pairs_by_phi: each φ with its ψ; a φ may have none.
        limited: for each φ the value of each pair to which the maximum distance applies, m; None: the Fréchet distance.
        maximum_distance: pairs further apart than this are left out and counted, m; None keeps all.
        confidence: confidence of the intervals over φ; intervals over pairs have 95 %.

    Raises:
        UsageError: the trajectories of a pair differ in time step or in dimension, or the maximum distance is
            negative.
    """
    if maximum_distance is not None and not maximum_distance >= 0.0:
        raise UsageError(f"maximum distance must be 0 m or more, got {maximum_distance}")
    pairs, most = list(pairs_by_phi), math.inf if maximum_distance is None else maximum_distance
    far = [frechet_distances(phi, psis) for phi, psis in pairs]
    prefixes = [prefix_distances(phi, psis) for phi, psis in pairs]
    kept = tuple(np.flatnonzero(~(one > most)) for one in (far if limited is None else limited))
    return Skd(
        GroupedMean(_kept(far, kept), DISTANCES, confidence=confidence),
        GroupedMean(_kept(prefixes, kept), PREFIXES, confidence=confidence),
        kept,
        sum(len(one) - rows.size for one, rows in zip(far, kept, strict=True)),
    )


def _kept(values: Sequence[FloatArray], kept: Sequence[npt.NDArray[np.int64]]) -> tuple[FloatArray, ...]:
    return tuple(one[rows] for one, rows in zip(values, kept, strict=True))


def bound_interval(groups: Sequence[FloatArray], eta: float, confidence: float = 0.95) -> Interval | None:
    """Return the interval over φ of Theorem 1's bound, by the delta method: what other φ might have made of it.

    It is of the kamikazes that were run, as the bound is; a better adversary has a bound of its own.

    Args:
        groups: distances of the pairs of each φ, m, at least two in all.
        eta: η, m, between 0 and their mean.
        confidence: two-sided, in (0, 1).
    """
    every = np.concatenate(groups)
    centre, variance = mean(every), sample_variance(every)
    assert variance is not None
    value = frechet_probability_bound(eta, centre, variance)
    influences = [bound_influence(group, eta, centre, variance) for group in groups]
    found = clustered_mean(influences, confidence, prior=DISTANCES.mirrored)  # it falls where distances rise
    if found is None or found.interval is None:
        return None
    low, high = (value + end - found.value for end in found.interval)
    return max(0.0, low), min(1.0, high)


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
