"""Deviation: how far ψ was, at worst, from where φ would have been at the same time.

D(φ, ψ) = max over 0 ≤ t ≤ t_c of |ψ(t) − φ(t)|, t_c the time of the contact, φ held at its last point after its end.

Unlike the Fréchet distance, which compares places alone, it compares places at times: waiting costs as much as another
way does, and what φ still had to go after t_c costs nothing. It is the supremum metric of paths over one span of time,
the coupling of times being the identity. It is linear in length, and 0 exactly where ψ walks φ up to the contact.

Both move uniformly within a tick, so their difference is linear in time there and its norm convex: its greatest value
over a tick is at an end of it. Ticks and the contact therefore suffice, and the value is exact. φ ends at a tick.

The mean deviation of a car: what a kamikaze needed, over all trials, those that failed included.

A mean over successes alone flatters a car that is hit easily and hides one that is hardly ever hit: of the latter only
the lucky trials would count. So a trial that fails counts as η_max, and so does one that needed more. That is the
restricted mean of survival analysis (Royston and Parmar, BMC Medical Research Methodology 13:152, 2013), with the
deviation in the place of time: ∫ (1 − P(η)) dη from 0 to η_max, where P(η) is the share of trials that hit the car
within a deviation of η.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from skd_sim.kernels.compilation import kernel
from skd_sim.world.episode import EpisodeLog
from skd_sim.world.state import FloatArray, IntArray, Trajectory

from skd_evaluator.metrics.clustered import DISTANCES, GroupedMean

_ROUNDING = 1e-6  # ticks; a duration is a quotient of times, and a recording may have been computed elsewhere


def deviation(phi: npt.ArrayLike, psi: npt.ArrayLike, duration: float) -> float:
    """Return the deviation of one pair.

    Args:
        phi: n × d positions at ticks 0 … n − 1, m; n ≥ 1, finite.
        psi: m × d positions, m; m ≥ 1, finite: at ticks 0 … m − 2, and the last at the contact.
        duration: time of the contact, in ticks, from m − 2 to m − 1 (0 where m is 1).

    Returns:
        D, in the unit of the positions.

    Raises:
        ValueError: an array is empty, is not n × d, or has a value that is not finite; the two d differ; or the
            duration is not one of so many positions.
    """
    return float(deviation_pairs(phi, [psi], [duration])[0])


def deviation_pairs(phi: npt.ArrayLike, psis: Sequence[npt.ArrayLike], durations: npt.ArrayLike) -> FloatArray:
    """Return the deviations of many ψ of one φ.

    Args:
        phi: n × d positions at ticks, m; n ≥ 1, finite.
        psis: K arrays of m_k × d positions, m, each as in `deviation`; may be empty.
        durations: K times of contact, in ticks.

    Returns:
        K values, in the unit of the positions.

    Raises:
        ValueError: as `deviation`; the message says which ψ. Or there are not as many durations as ψ.
    """
    first = _points(phi, "phi")
    curves = [_points(psi, f"psis[{index}]") for index, psi in enumerate(psis)]
    times = np.array(durations, dtype=np.float64)
    if times.shape != (len(curves),):
        raise ValueError(f"there are {len(curves)} psis, and durations of shape {times.shape}")
    for index, (curve, time) in enumerate(zip(curves, times.tolist(), strict=True)):
        times[index] = _checked(first, curve, time, f"psis[{index}]")
    out = np.empty(len(curves))
    if curves:
        ends = np.cumsum([len(curve) for curve in curves], dtype=np.int64)
        _measure(np.ascontiguousarray(first), np.concatenate(curves), ends, times, out)
    return out


@kernel(allocates=False)
def _measure(phi: FloatArray, psis: FloatArray, ends: IntArray, durations: FloatArray, out: FloatArray) -> None:
    """Write the deviation of each ψ, rows ends[k − 1] … ends[k] − 1 of `psis`, into out[k]."""
    last = phi.shape[0] - 1
    begin = 0
    for index in range(out.size):
        contact = ends[index] - begin - 1
        greatest = 0.0
        for tick in range(contact):
            squared = 0.0
            for axis in range(phi.shape[1]):
                difference = psis[begin + tick, axis] - phi[min(tick, last), axis]
                squared += difference * difference
            greatest = max(greatest, squared)
        before = max(contact - 1, 0)
        share = durations[index] - before
        here, there = min(before, last), min(before + 1, last)
        squared = 0.0
        for axis in range(phi.shape[1]):
            difference = psis[begin + contact, axis] - (phi[here, axis] + share * (phi[there, axis] - phi[here, axis]))
            squared += difference * difference
        out[index] = math.sqrt(max(greatest, squared))
        begin = ends[index]


def _points(values: npt.ArrayLike, name: str) -> FloatArray:
    points: FloatArray = np.array(values, dtype=np.float64)
    if points.ndim != 2 or points.shape[0] == 0 or points.shape[1] == 0:
        raise ValueError(f"{name} must be n × d positions with n, d ≥ 1, got shape {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(f"{name} has a coordinate that is not finite")
    return points


def _checked(phi: FloatArray, psi: FloatArray, duration: float, name: str) -> float:
    """Return the duration, within the last tick of ψ to the last bit."""
    if phi.shape[1] != psi.shape[1]:
        raise ValueError(f"phi has {phi.shape[1]} coordinates a position, {name} has {psi.shape[1]}")
    low, high = max(len(psi) - 2, 0), len(psi) - 1
    if not low - _ROUNDING <= duration <= high + _ROUNDING:
        raise ValueError(f"the duration of {name} must be from {low} to {high} ticks, got {duration:g}")
    return min(max(float(duration), float(low)), float(high))


@dataclass(frozen=True, eq=False)
class Hit:
    """A trajectory on which the moving car hits, under the draws of one trial: the one of least deviation.

    Attributes:
        distance: deviation of the trajectory, m.
        trajectory: the adversary's positions per tick, the last of them at the contact, m.
        duration: time until the contact, ticks.
        impact_speed: speed of the car at the contact, m/s; at least the scenario's `collision.hit_speed`.
        gap: the least deviation of all is no more than this below `distance`, m; 0: up to rounding it is `distance`;
            infinity: that is not known, for it was found by search.
    """

    distance: float
    trajectory: Trajectory
    duration: float
    impact_speed: float
    gap: float = math.inf


def hit_of(phi: FloatArray, log: EpisodeLog) -> Hit:
    """Return the hit in which an episode ended, of whose deviation from φ (n × 2, m) nothing is known beforehand."""
    duration, path = log.impact_time / log.episode.scenario.time_step, log.trajectory
    return Hit(deviation(phi, path.positions, duration), path, duration, log.impact_speed)


def mean_deviation(
    trials: Iterable[FloatArray], *, eta_max: float, confidence: float = 0.95
) -> tuple[GroupedMean, GroupedMean]:
    """Return the restricted mean deviation over all trials, and the mean over those that hit, m.

    Args:
        trials: for each φ the deviation of each trial that ran to its end, m; infinite without a hit.
        eta_max: η_max, m, > 0: what a trial counts as that failed, or that needed more.
        confidence: confidence of the interval over φ.
    """
    groups = list(trials)
    return (
        GroupedMean(tuple(np.minimum(one, eta_max) for one in groups), DISTANCES, (0.0, eta_max), confidence),
        GroupedMean(tuple(one[np.isfinite(one)] for one in groups), DISTANCES, confidence=confidence),
    )
