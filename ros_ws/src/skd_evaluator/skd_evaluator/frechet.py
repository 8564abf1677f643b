"""Discrete Fréchet distance between point sequences in R^n.

Eiter and Mannila, "Computing discrete Fréchet distance", TR CD-TR 94/64, TU Vienna, 1994: over all couplings
that start at the two first points, end at the two last, and at each step move on by one point on either curve
*or on both*, the smallest possible value of the longest link.

The table c[i, j] = max(|p_i − q_j|², min(c[i−1, j], c[i, j−1], c[i−1, j−1])) is filled one anti-diagonal
after the other: the cells of an anti-diagonal do not depend on one another, so the processor can work on
several at once, which row order forbids. Three diagonals are kept, so memory is linear. Several curves q
against one p go through the table side by side ("lanes", interleaved point by point), which keeps short
curves efficient too. Every cell sees the same correctly rounded operations whatever the number of lanes,
so a batch gives the same bits as its pairs one by one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from skd_sim.compilation import kernel

FloatArray = npt.NDArray[np.float64]

_LANES = 8  # curves side by side: measured best of 1, 4, 8, 16, 32 from 13 to 1,000 points
_CHUNK = 4  # values; diagonals are widened to multiples of it, as the processor takes that many at once
_NOT_FINITE = -1.0  # a kernel's answer for bad input; no distance is negative


@kernel
def _all_finite(points: FloatArray) -> bool:
    """Tell whether no coordinate is NaN or infinite."""
    fine = True
    for i in range(points.shape[0]):
        for c in range(points.shape[1]):
            fine &= np.isfinite(points[i, c])
    return fine


@kernel
def _workspace(n: int, m: int, dimension: int, lanes: int) -> FloatArray:
    """Return memory for `_sweep` over curves of at most n and m points."""
    wide = n * lanes + _CHUNK
    return np.empty(dimension * (wide + m * lanes + 2 * _CHUNK) + 3 * (wide + lanes) + wide)


# Two kernels with everything in one straight line each: with a branch between the slices and their use, numba counts
# references to them on every diagonal, which took three times as long as the arithmetic at 40 points.


@kernel
def _diagonals_in_plane(
    n: int,
    m: int,
    lanes: int,
    columns_p: FloatArray,
    columns_q: FloatArray,
    before: FloatArray,
    last: FloatArray,
    new: FloatArray,
) -> FloatArray:
    """Go through the table of 2-D curves, laid out as `_sweep` says, and return its last diagonal."""
    wide = columns_p.shape[0] // 2
    long = columns_q.shape[0] // 2
    for k in range(1, n + m - 1):
        begin = max(0, k - m + 1) * lanes // _CHUNK * _CHUNK
        count = (min(n, k + 1) * lanes - begin + _CHUNK - 1) // _CHUNK * _CHUNK
        there = begin + (m - 1 - k) * lanes + _CHUNK
        diagonal = before[begin : begin + count]
        above = last[begin : begin + count]
        beside = last[begin + lanes : begin + lanes + count]
        cell = new[begin + lanes : begin + lanes + count]
        px = columns_p[begin : begin + count]
        py = columns_p[wide + begin : wide + begin + count]
        qx = columns_q[there : there + count]
        qy = columns_q[long + there : long + there + count]
        for i in range(count):
            dx = px[i] - qx[i]
            dy = py[i] - qy[i]
            link = dx * dx + dy * dy
            reach = above[i] if above[i] < beside[i] else beside[i]
            reach = diagonal[i] if diagonal[i] < reach else reach
            cell[i] = link if link > reach else reach
        before, last, new = last, new, before
    return last


@kernel
def _diagonals(
    n: int,
    m: int,
    lanes: int,
    dimension: int,
    columns_p: FloatArray,
    columns_q: FloatArray,
    squared: FloatArray,
    before: FloatArray,
    last: FloatArray,
    new: FloatArray,
) -> FloatArray:
    """Do what `_diagonals_in_plane` does in any dimension, with a pass per coordinate."""
    wide = columns_p.shape[0] // dimension
    long = columns_q.shape[0] // dimension
    for k in range(1, n + m - 1):
        begin = max(0, k - m + 1) * lanes // _CHUNK * _CHUNK
        count = (min(n, k + 1) * lanes - begin + _CHUNK - 1) // _CHUNK * _CHUNK
        there = begin + (m - 1 - k) * lanes + _CHUNK
        links = squared[:count]
        links[:] = 0.0
        for c in range(dimension):
            pc = columns_p[c * wide + begin : c * wide + begin + count]
            qc = columns_q[c * long + there : c * long + there + count]
            for i in range(count):
                delta = pc[i] - qc[i]
                links[i] += delta * delta
        diagonal = before[begin : begin + count]
        above = last[begin : begin + count]
        beside = last[begin + lanes : begin + lanes + count]
        cell = new[begin + lanes : begin + lanes + count]
        for i in range(count):
            reach = above[i] if above[i] < beside[i] else beside[i]
            reach = diagonal[i] if diagonal[i] < reach else reach
            cell[i] = links[i] if links[i] > reach else reach
        before, last, new = last, new, before
    return last


@kernel
def _sweep(
    p: FloatArray,
    flat: FloatArray,
    offsets: npt.NDArray[np.int64],
    chosen: npt.NDArray[np.int64],
    work: FloatArray,
    out: FloatArray,
) -> None:
    """Write to out[chosen] the distances of p to the chosen curves, all in one sweep.

    Args:
        p: n × d.
        flat: the points of all curves, one after the other; N × d.
        offsets: curve k is flat[offsets[k] : offsets[k + 1]].
        chosen: indices of the curves to take, one per lane.
        work: from `_workspace`.
        out: one value per curve.
    """
    n, dimension = p.shape
    lanes = chosen.shape[0]
    m = 0
    for k in chosen:
        m = max(m, offsets[k + 1] - offsets[k])

    wide = (n * lanes + _CHUNK - 1) // _CHUNK * _CHUNK
    long = m * lanes + 2 * _CHUNK
    columns_p = work[: dimension * wide]
    used = dimension * wide
    columns_q = work[used : used + dimension * long]
    used += dimension * long
    squared = work[used : used + wide]
    used += wide
    # Cell (i, lane) of a diagonal is at (i + 1)·lanes + lane. Infinity stands for all outside the table,
    # i = −1 included.
    table = work[used : used + 3 * (wide + lanes)]
    table[:] = np.inf
    before = table[: wide + lanes]
    last = table[wide + lanes : 2 * (wide + lanes)]
    new = table[2 * (wide + lanes) :]

    for c in range(dimension):
        column = columns_p[c * wide : (c + 1) * wide]
        for i in range(n):
            for lane in range(lanes):
                column[i * lanes + lane] = p[i, c]
        # Rows below the table: no cell of it depends on them, any finite number will do.
        column[n * lanes :] = 0.0
        # q runs backwards, so that a diagonal reads both curves forwards. Points at infinity around it make
        # the cells left and right of the table infinite without a test.
        column = columns_q[c * long : (c + 1) * long]
        column[:_CHUNK] = np.inf
        column[long - _CHUNK :] = np.inf
        for lane in range(lanes):
            first = offsets[chosen[lane]]
            final = offsets[chosen[lane] + 1] - 1
            for j in range(m):
                # A shorter curve waits at its last point: repeating a point does not change the distance.
                column[_CHUNK + (m - 1 - j) * lanes + lane] = flat[min(first + j, final), c]

    for lane in range(lanes):
        total = 0.0
        for c in range(dimension):
            delta = p[0, c] - flat[offsets[chosen[lane]], c]
            total += delta * delta
        last[lanes + lane] = total

    if dimension == 2:
        last = _diagonals_in_plane(n, m, lanes, columns_p, columns_q, before, last, new)
    else:
        last = _diagonals(n, m, lanes, dimension, columns_p, columns_q, squared, before, last, new)
    for lane in range(lanes):
        out[chosen[lane]] = np.sqrt(last[n * lanes + lane])


@kernel
def _distance(p: FloatArray, q: FloatArray) -> float:
    """Return the distance of one pair, or _NOT_FINITE."""
    if not (_all_finite(p) and _all_finite(q)):
        return _NOT_FINITE
    offsets = np.empty(2, np.int64)
    offsets[0] = 0
    offsets[1] = q.shape[0]
    chosen = np.zeros(1, np.int64)
    out = np.empty(1)
    _sweep(p, q, offsets, chosen, _workspace(p.shape[0], q.shape[0], p.shape[1], 1), out)
    return out[0]  # type: ignore[no-any-return]


@kernel
def _distances(
    p: FloatArray,
    flat: FloatArray,
    offsets: npt.NDArray[np.int64],
    order: npt.NDArray[np.int64],
    out: FloatArray,
) -> None:
    """Write the distance of p to every curve; `order` lists the curves, those of like length together."""
    longest = 0
    for k in order:
        longest = max(longest, offsets[k + 1] - offsets[k])
    work = _workspace(p.shape[0], longest, p.shape[1], min(_LANES, order.shape[0]))
    for start in range(0, order.shape[0], _LANES):
        _sweep(p, flat, offsets, order[start : start + _LANES], work, out)


def discrete_frechet(p: npt.ArrayLike, q: npt.ArrayLike) -> float:
    """Return the discrete Fréchet distance of two curves.

    Distances are squared on the way, so coordinates should be between about 1e-150 and 1e150 in size.

    Args:
        p: n × d points, n ≥ 1, d ≥ 1, finite.
        q: m × d points, m ≥ 1, finite.

    Returns:
        The distance, in the unit of the points.

    Raises:
        ValueError: an array is empty, is not n × d, or has a value that is not finite, or the two d differ.
    """
    first = _points(p, "p")
    second = _points(q, "q")
    if first.shape[1] != second.shape[1]:
        raise ValueError(f"p has {first.shape[1]} coordinates a point, q has {second.shape[1]}")
    distance = _distance(first, second)
    if distance == _NOT_FINITE:
        raise ValueError(f"{'q' if _all_finite(first) else 'p'} has a coordinate that is not finite")
    return distance


def discrete_frechet_pairs(reference: npt.ArrayLike, others: Sequence[npt.ArrayLike]) -> FloatArray:
    """Return the discrete Fréchet distances of many curves to one, the same bits as `discrete_frechet` gives.

    Args:
        reference: n × d points, n ≥ 1, d ≥ 1, finite.
        others: curves of m_k × d points each, m_k ≥ 1, finite; may be an empty list.

    Returns:
        One distance per curve in `others`, in the unit of the points.

    Raises:
        ValueError: as `discrete_frechet`; the message says which curve.
    """
    first = _points(reference, "reference")
    if not _all_finite(first):
        raise ValueError("reference has a coordinate that is not finite")
    curves = [np.asarray(curve, dtype=np.float64) for curve in others]
    dimension = first.shape[1]
    lengths = np.empty(len(curves), dtype=np.int64)
    for k, curve in enumerate(curves):
        shape = curve.shape
        if len(shape) != 2 or shape[1] != dimension or shape[0] == 0:
            _points(curve, f"others[{k}]")
            raise ValueError(f"reference has {dimension} coordinates a point, others[{k}] has {shape[1]}")
        lengths[k] = shape[0]
    out = np.empty(len(curves))
    if not curves:
        return out
    flat = np.ascontiguousarray(np.concatenate(curves))
    if not _all_finite(flat):
        bad = next(k for k, curve in enumerate(curves) if not np.isfinite(curve).all())
        raise ValueError(f"others[{bad}] has a coordinate that is not finite")
    offsets = np.zeros(len(curves) + 1, dtype=np.int64)
    np.cumsum(lengths, out=offsets[1:])
    _distances(first, flat, offsets, np.argsort(lengths, kind="stable"), out)
    return out


def _points(values: npt.ArrayLike, name: str) -> FloatArray:
    """Return the points as a writable contiguous array: the one layout that the kernels are compiled for."""
    points: FloatArray = np.ascontiguousarray(values, dtype=np.float64)
    # ascontiguousarray makes a number into a list of one, which is refused here like any other list.
    if points.ndim != 2 or points.shape[0] == 0 or points.shape[1] == 0:
        raise ValueError(f"{name} must be n × d points with n, d ≥ 1, got shape {np.shape(values)}")
    return points if points.flags.writeable else points.copy()
