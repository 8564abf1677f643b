"""Discrete Fréchet distance between point sequences in R^n, its kernels, and dynamic time warping.

Eiter and Mannila, "Computing discrete Fréchet distance", TR CD-TR 94/64, TU Vienna, 1994: over all couplings that start
at the two first points, end at the two last, and at each step move on by one point on either curve *or on both*, the
smallest possible value of the longest link.

In the plane the table c[i, j] = max(|p_i − q_j|², min(c[i−1, j], c[i, j−1], c[i−1, j−1])) is filled one anti-diagonal
after the other: the cells of an anti-diagonal do not depend on one another, so the processor can work on several at
once, which row order forbids. Three diagonals are kept, so memory is linear. Several curves q against one p go through
the table side by side ("lanes", interleaved point by point), which keeps short curves efficient too.

Only cells that can matter are filled. The coupling that goes along both curves evenly gives a limit from above; values
never fall along a coupling, so none that leads to an answer within the limit has a cell beyond it. The range of rows
taken on to the next diagonal is narrowed from both ends while its predecessors are beyond the limit, and a range that
becomes empty ends the sweep. (The idea of a limit from a quick coupling is in Devogele et al., "Optimized discrete
Fréchet distance between trajectories", BigSpatial 2017.)

Every cell within the limit sees the same correctly rounded operations whatever the number of lanes and the range. So
the bits of a distance do not depend on how it is computed: alone or in a batch.

Dynamic time warping is the time-normalised distance of Sakoe and Chiba ("Dynamic programming algorithm optimization for
spoken word recognition", IEEE Transactions on Acoustics, Speech, and Signal Processing 26, 1978), symmetric form
without a slope constraint: the least sum of d(φ_i, ψ_j) over couplings that step by one in i, in j or in both, where a
step in both counts twice, over the number of points of φ and ψ together. φ is cut at the duration of ψ, as for the
prefix distance. Unlike the discrete Fréchet distance it is a mean and no maximum: one wide turn weighs little in it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from skd_sim.kernels.compilation import kernel
from skd_sim.world.state import FloatArray, IntArray, Trajectory

from skd_evaluator.metrics.clustered import PREFIXES
from skd_evaluator.metrics.measures import Measure, Pair

_CHUNK = 4  # values; diagonals are widened to multiples of it, as the processor takes that many at once
_NARROW_EVERY = 4  # diagonals; less often costs cells, more often costs looks at their ends


@kernel
def all_finite(points: FloatArray) -> bool:
    """Tell whether no coordinate is NaN or infinite."""
    fine = True
    for i in range(points.shape[0]):
        for c in range(points.shape[1]):
            fine &= np.isfinite(points[i, c])
    return fine


@kernel
def _squared_link(p: FloatArray, i: int, q: FloatArray, j: int) -> float:
    """Return |p_i − q_j|², rounded as the sweeps round it."""
    total = 0.0
    for c in range(p.shape[1]):
        delta = p[i, c] - q[j, c]
        total += delta * delta
    return total


@kernel
def _even_coupling(p: FloatArray, q: FloatArray) -> float:
    """Return the squared longest link of the coupling that goes along two curves in the plane evenly."""
    if p.shape[0] >= q.shape[0]:
        long, short = p, q
    else:
        long, short = q, p
    steps = long.shape[0] - 1
    rise = short.shape[0] - 1
    longest = 0.0
    j = 0
    part = 0
    if steps == rise:  # by far the most frequent
        for i in range(steps + 1):
            dx = p[i, 0] - q[i, 0]
            dy = p[i, 1] - q[i, 1]
            link = dx * dx + dy * dy
            longest = link if link > longest else longest
        return longest
    for i in range(steps + 1):
        link = _squared_link(long, i, short, j)
        longest = link if link > longest else longest
        part += rise
        if part >= steps:
            part -= steps
            j = min(j + 1, rise)
    return longest


@kernel
def _dead(cells: FloatArray, row: int, limits: FloatArray) -> bool:
    """Tell whether a row's cells are beyond the limit in every lane."""
    start = (row + 1) * limits.shape[0]
    dead = True
    for lane in range(limits.shape[0]):
        dead &= cells[start + lane] > limits[lane]
    return dead


@kernel
def _narrowed(before: FloatArray, last: FloatArray, limits: FloatArray, low: int, high: int) -> tuple[int, int]:
    """Return the rows low ≤ i < high of the next diagonal without those at the ends whose predecessors are dead."""
    while low < high and _dead(last, low, limits) and _dead(last, low - 1, limits) and _dead(before, low - 1, limits):
        low += 1
    while (
        low < high
        and _dead(last, high - 1, limits)
        and _dead(last, high - 2, limits)
        and _dead(before, high - 2, limits)
    ):
        high -= 1
    return low, high


@kernel(inline=True)
def _next_band(
    n: int, m: int, k: int, limits: FloatArray, before: FloatArray, last: FloatArray, low: int, high: int
) -> tuple[int, int]:
    """Return from where to where diagonal k has to be looked at; where nowhere, the last cell of all is infinite."""
    low = max(low, k - m + 1)
    high = min(high + 1, n)
    if k % _NARROW_EVERY == 0:
        low, high = _narrowed(before, last, limits, low, high)
    if low >= high:
        lanes = limits.shape[0]
        last[n * lanes : (n + 1) * lanes] = np.inf
    return low, high


@kernel
def _fence(cells: FloatArray, begin: int, count: int, lanes: int) -> None:
    """Make infinite what the next two diagonals read beside the values that this one has: the buffer is reused."""
    for i in range(begin, begin + lanes):
        cells[i] = np.inf
    after = begin + lanes + count
    for i in range(after, after + lanes + _CHUNK):
        cells[i] = np.inf


# Everything in one straight line: with a branch between the slices and their use, numba counts references to them on
# every diagonal, which took three times as long as the arithmetic at 40 points.


@kernel
def _diagonals(
    n: int,
    m: int,
    limits: FloatArray,
    columns_p: FloatArray,
    columns_q: FloatArray,
    before: FloatArray,
    last: FloatArray,
    new: FloatArray,
) -> FloatArray:
    """Go through the table, laid out as `_sweep` says, and return its last diagonal."""
    lanes = limits.shape[0]
    wide = columns_p.shape[0] // 2
    long = columns_q.shape[0] // 2
    low = 0
    high = 1
    for k in range(1, n + m - 1):
        low, high = _next_band(n, m, k, limits, before, last, low, high)
        if low >= high:
            break
        begin = low * lanes // _CHUNK * _CHUNK
        count = (high * lanes - begin + _CHUNK - 1) // _CHUNK * _CHUNK
        there = begin + (m - 1 - k) * lanes + _CHUNK
        _fence(new, begin, count, lanes)
        diagonal = before[begin : begin + count]
        above = last[begin : begin + count]
        adjacent = last[begin + lanes : begin + lanes + count]
        cell = new[begin + lanes : begin + lanes + count]
        px = columns_p[begin : begin + count]
        py = columns_p[wide + begin : wide + begin + count]
        qx = columns_q[there : there + count]
        qy = columns_q[long + there : long + there + count]
        for i in range(count):
            dx = px[i] - qx[i]
            dy = py[i] - qy[i]
            link = dx * dx + dy * dy
            reach = above[i] if above[i] < adjacent[i] else adjacent[i]
            reach = diagonal[i] if diagonal[i] < reach else reach
            cell[i] = link if link > reach else reach
        before, last, new = last, new, before
    return last


@kernel
def _workspace(n: int, m: int, lanes: int) -> FloatArray:
    """Return memory for `_sweep` over curves of at most n and m points."""
    wide = n * lanes + _CHUNK
    return np.empty(2 * (wide + m * lanes + 2 * _CHUNK) + 3 * (wide + 2 * lanes + _CHUNK))


@kernel
def _sweep(
    p: FloatArray,
    flat: FloatArray,
    offsets: IntArray,
    chosen: IntArray,
    limits: FloatArray,
    work: FloatArray,
    out: FloatArray,
) -> None:
    """Write to out[chosen] the squared distances of p to the chosen curves, all in one sweep.

    Args:
        p: n × 2.
        flat: the points of all curves, one after the other; N × 2.
        offsets: curve k is flat[offsets[k] : offsets[k + 1]].
        chosen: indices of the curves to take, one per lane.
        limits: one limit for each lane, m²; where the squared distance is more, out gets some value above the limit.
        work: memory from `_workspace`.
        out: receives one value for each curve.
    """
    n = p.shape[0]
    lanes = chosen.shape[0]
    m = 0
    for k in chosen:
        m = max(m, offsets[k + 1] - offsets[k])

    wide = (n * lanes + _CHUNK - 1) // _CHUNK * _CHUNK
    long = m * lanes + 2 * _CHUNK
    columns_p = work[: 2 * wide]
    used = 2 * wide
    columns_q = work[used : used + 2 * long]
    used += 2 * long
    # Cell (i, lane) of a diagonal is at (i + 1)·lanes + lane. Infinity stands for all outside the table,
    # i = −1 included, and for all that is left out.
    size = wide + 2 * lanes + _CHUNK
    table = work[used : used + 3 * size]
    table[:] = np.inf
    before = table[:size]
    last = table[size : 2 * size]
    new = table[2 * size :]

    for c in range(2):
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
        last[lanes + lane] = _squared_link(p, 0, flat, offsets[chosen[lane]])

    last = _diagonals(n, m, limits, columns_p, columns_q, before, last, new)
    for lane in range(lanes):
        out[chosen[lane]] = last[n * lanes + lane]


@kernel
def _row_by_row(p: FloatArray, q: FloatArray) -> float:
    """Return the squared distance of two curves in any dimension, by the whole table."""
    row = np.full(q.shape[0], np.inf)
    for i in range(p.shape[0]):
        diagonal = -np.inf if i == 0 else np.inf  # cell (i − 1, j − 1)
        for j in range(q.shape[0]):
            before = row[j - 1] if j > 0 else np.inf
            reach = min(diagonal, row[j], before)
            diagonal = row[j]
            row[j] = max(_squared_link(p, i, q, j), reach)
    return row[-1]  # type: ignore[no-any-return]


@kernel
def measure(p: FloatArray, flat: FloatArray, offsets: IntArray, order: IntArray, most: int, out: FloatArray) -> None:
    """Write to out[order] the distances of p to the curves of `order`.

    Args:
        p: n × d.
        flat: the points of all curves, one after the other; N × d.
        offsets: curve k is flat[offsets[k] : offsets[k + 1]].
        order: indices of the curves to take, those of like length together.
        most: number of curves that go through the table side by side.
        out: receives one value for each curve; only out[order] is written.
    """
    n = p.shape[0]
    if p.shape[1] != 2:  # no curve of a road user
        for k in order:
            out[k] = np.sqrt(_row_by_row(p, flat[offsets[k] : offsets[k + 1]]))
        return
    open_curves = np.empty_like(order)
    limits = np.empty(order.shape[0])
    left = 0
    longest = 0
    for k in order:
        q = flat[offsets[k] : offsets[k + 1]]
        m = q.shape[0]
        # Every coupling has the first link and the last.
        least = max(_squared_link(p, 0, q, 0), _squared_link(p, n - 1, q, m - 1))
        out[k] = least
        limit = _even_coupling(p, q)
        if limit > least:
            open_curves[left] = k
            limits[left] = limit
            left += 1
            longest = max(longest, m)
    if left > 0:
        work = _workspace(n, longest, min(most, left))
        for start in range(0, left, most):
            end = min(start + most, left)
            _sweep(p, flat, offsets, open_curves[start:end], limits[start:end], work, out)
    for k in order:
        out[k] = np.sqrt(out[k])


_LANES = 8  # curves side by side: of 1, 2, 4, 8 and 16 the best or nearly so from 40 to 1,000 points


def discrete_frechet(p: npt.ArrayLike, q: npt.ArrayLike) -> float:
    """Return the discrete Fréchet distance of two curves.

    Distances are squared first, so coordinates should be between about 1e-150 and 1e150 in size.

    Args:
        p: n × d points, n ≥ 1, d ≥ 1, finite.
        q: m × d points, m ≥ 1, finite.

    Returns:
        The distance, in the unit of the points.

    Raises:
        ValueError: an array is empty, is not n × d, or has a value that is not finite, or the two d differ.
    """
    return float(discrete_frechet_pairs(p, [q])[0])


def discrete_frechet_pairs(reference: npt.ArrayLike, others: Sequence[npt.ArrayLike] | FloatArray) -> FloatArray:
    """Return the discrete Fréchet distances of many curves to one, the same bits as `discrete_frechet` gives.

    Args:
        reference: n × d points, n ≥ 1, d ≥ 1, finite.
        others: curves of m_k × d points each, m_k ≥ 1, finite; may be an empty list. Curves of one length may be one
            array, K × m × d, which is quicker to take in.

    Returns:
        One value per curve in `others`: the distance, in the unit of the points.

    Raises:
        ValueError: as `discrete_frechet`; the message says which curve.
    """
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
    measure(first, flat, offsets, np.argsort(lengths, kind="stable"), _LANES, out)
    return out


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


def _points(values: npt.ArrayLike, name: str) -> FloatArray:
    """Return the points as a writable contiguous array: the one layout that the kernels are compiled for."""
    points: FloatArray = np.ascontiguousarray(values, dtype=np.float64)
    # ascontiguousarray makes a number into a list of one, which is refused here like any other list.
    if points.ndim != 2 or points.shape[0] == 0 or points.shape[1] == 0:
        raise ValueError(f"{name} must be n × d points with n, d ≥ 1, got shape {np.shape(values)}")
    return _writable(points)


def _writable(points: FloatArray) -> FloatArray:
    return points if points.flags.writeable else points.copy()


@kernel(allocates=True)
def _least_sum(phi: FloatArray, psi: FloatArray) -> float:
    row = np.full(len(psi), np.inf)
    for i in range(len(phi)):
        diagonal = np.inf  # entry (i − 1, j − 1)
        for j in range(len(psi)):
            distance = 0.0
            for axis in range(phi.shape[1]):
                difference = phi[i, axis] - psi[j, axis]
                distance += difference * difference
            distance = math.sqrt(distance)
            above = row[j]
            if i == 0 and j == 0:
                row[j] = 2.0 * distance
            else:
                least = min(above + distance, diagonal + 2.0 * distance)
                row[j] = min(least, row[j - 1] + distance) if j > 0 else least
            diagonal = above
    return float(row[-1])


def warped_distance(phi: FloatArray, psi: FloatArray) -> float:
    """Return the time-normalised distance of two curves.

    Args:
        phi: n × d positions, m; n ≥ 1.
        psi: m × d positions, m; m ≥ 1.

    Returns:
        The distance, m.
    """
    return float(_least_sum(phi, psi)) / (len(phi) + len(psi))


def _of_pairs(phi: Trajectory, pairs: Sequence[Pair]) -> list[float]:
    return [warped_distance(phi.prefix(min(len(one.psi), len(phi))).positions, one.psi.positions) for one in pairs]


WARPED = Measure("time-warped distance to φ", "m", _of_pairs, shown=False, prior=PREFIXES)
