"""Discrete Fréchet distance between point sequences in R^n.

Eiter and Mannila, "Computing discrete Fréchet distance", TR CD-TR 94/64, TU Vienna, 1994: over all couplings
that start at the two first points, end at the two last, and at each step move on by one point on either curve
*or on both*, the smallest possible value of the longest link.

`frechet_kernels` says how it is computed. The bits of a distance do not depend on how it was asked for: alone
or in a batch, with or without a bound that it keeps, on one thread or several.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray, IntArray

from skd_evaluator.metrics.distances.frechet_kernels import NOT_FINITE, all_finite, measure, measure_one

_LANES = 8  # curves side by side: of 1, 2, 4, 8 and 16 the best or nearly so from 40 to 1,000 points
_PARTS_A_WORKER = 4  # parts of a batch per thread, so that none waits long for the last


def discrete_frechet(p: npt.ArrayLike, q: npt.ArrayLike, *, bound: float = math.inf) -> float:
    """Return the discrete Fréchet distance of two curves, or infinity if it is above the bound.

    A bound saves time: what cannot stay within it is left as soon as that is certain.
    Distances are squared on the way, so coordinates should be between about 1e-150 and 1e150 in size.

    Args:
        p: n × d points, n ≥ 1, d ≥ 1, finite.
        q: m × d points, m ≥ 1, finite.
        bound: greatest distance of interest, 0 or more, in the unit of the points.

    Returns:
        The distance, in the unit of the points, where it is at most the bound; else infinity.

    Raises:
        ValueError: an array is empty, is not n × d, or has a value that is not finite, or the two d differ; or the
            bound is negative or NaN.
    """
    first = _points(p, "p")
    second = _points(q, "q")
    if first.shape[1] != second.shape[1]:
        raise ValueError(f"p has {first.shape[1]} coordinates a point, q has {second.shape[1]}")
    distance = measure_one(first, second, _checked(bound))
    if distance == NOT_FINITE:
        raise ValueError(f"{'q' if all_finite(first) else 'p'} has a coordinate that is not finite")
    return distance


def discrete_frechet_pairs(
    reference: npt.ArrayLike,
    others: Sequence[npt.ArrayLike] | FloatArray,
    *,
    bound: float = math.inf,
    workers: int = 1,
) -> FloatArray:
    """Return the discrete Fréchet distances of many curves to one, the same bits as `discrete_frechet` gives.

    Args:
        reference: n × d points, n ≥ 1, d ≥ 1, finite.
        others: curves of m_k × d points each, m_k ≥ 1, finite; may be an empty list. Curves of one length may be one
            array, K × m × d, which is quicker to take in.
        bound: greatest distance of interest, 0 or more, in the unit of the points.
        workers: number of threads. They live as long as the call, so that a process may fork before and after it.

    Returns:
        One value per curve in `others`: the distance, in the unit of the points, or infinity if it is above the bound.

    Raises:
        ValueError: as `discrete_frechet`; the message says which curve. Or there is no worker.
    """
    if workers < 1:
        raise ValueError(f"at least one worker is needed, got {workers}")
    limit = _checked(bound)
    first = _points(reference, "reference")
    if not all_finite(first):
        raise ValueError("reference has a coordinate that is not finite")
    flat, lengths = _joined(others, first.shape[1])
    out = np.empty(lengths.size)
    if not lengths.size:
        return out
    if not all_finite(flat):
        bad = next(k for k, curve in enumerate(others) if not np.isfinite(curve).all())
        raise ValueError(f"others[{bad}] has a coordinate that is not finite")
    offsets = np.zeros(lengths.size + 1, dtype=np.int64)
    np.cumsum(lengths, out=offsets[1:])
    order = np.argsort(lengths, kind="stable")

    def run(part: IntArray) -> None:
        measure(first, flat, offsets, part, limit, _LANES, out)

    parts = _parts(order, workers)
    if len(parts) == 1:
        run(order)
    else:
        with ThreadPoolExecutor(min(workers, len(parts))) as pool:
            list(pool.map(run, reversed(parts)))  # the longest first; a list, so that errors come out
    return out


def _parts(order: IntArray, workers: int) -> list[IntArray]:
    """Cut the order into parts for the workers, each a multiple of the lanes but for the last."""
    if workers == 1:
        return [order]
    size = -(-order.size // (workers * _PARTS_A_WORKER * _LANES)) * _LANES
    return [order[start : start + size] for start in range(0, order.size, size)]


def _joined(others: Sequence[npt.ArrayLike] | FloatArray, dimension: int) -> tuple[FloatArray, IntArray]:
    """Return the points of all curves one after the other, and the lengths of the curves."""
    if isinstance(others, np.ndarray) and others.ndim == 3 and others.shape[1] > 0 and others.shape[2] == dimension:
        flat = np.ascontiguousarray(others, dtype=np.float64).reshape(-1, dimension)
        return _writable(flat), np.full(others.shape[0], others.shape[1], dtype=np.int64)
    curves = [np.asarray(curve, dtype=np.float64) for curve in others]
    lengths = np.empty(len(curves), dtype=np.int64)
    for k, curve in enumerate(curves):
        shape = curve.shape
        if len(shape) != 2 or shape[1] != dimension or shape[0] == 0:
            _points(curve, f"others[{k}]")
            raise ValueError(f"reference has {dimension} coordinates a point, others[{k}] has {shape[1]}")
        lengths[k] = shape[0]
    return np.ascontiguousarray(np.concatenate(curves)) if curves else np.empty((0, dimension)), lengths


def _checked(bound: float) -> float:
    if not bound >= 0.0:
        raise ValueError(f"bound must be 0 or more, got {bound}")
    return float(bound)


def _points(values: npt.ArrayLike, name: str) -> FloatArray:
    """Return the points as a writable contiguous array: the one layout that the kernels are compiled for."""
    points: FloatArray = np.ascontiguousarray(values, dtype=np.float64)
    # ascontiguousarray makes a number into a list of one, which is refused here like any other list.
    if points.ndim != 2 or points.shape[0] == 0 or points.shape[1] == 0:
        raise ValueError(f"{name} must be n × d points with n, d ≥ 1, got shape {np.shape(values)}")
    return _writable(points)


def _writable(points: FloatArray) -> FloatArray:
    return points if points.flags.writeable else points.copy()
