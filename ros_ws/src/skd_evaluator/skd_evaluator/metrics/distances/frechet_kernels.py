"""The compiled part of the discrete Fréchet distance.

The table c[i, j] = max(|p_i − q_j|², min(c[i−1, j], c[i, j−1], c[i−1, j−1])) is filled one anti-diagonal
after the other: the cells of an anti-diagonal do not depend on one another, so the processor can work on
several at once, which row order forbids. Three diagonals are kept, so memory is linear. Several curves q
against one p go through the table side by side ("lanes", interleaved point by point), which keeps short
curves efficient too.

Only cells that can matter are filled. A coupling found in linear time gives a limit from above, the caller's
bound another; values never fall along a coupling, so none that leads to an answer within the limit has a cell
beyond it. The range of rows taken on to the next diagonal is narrowed from both ends while its predecessors
are beyond the limit, and a range that becomes empty ends the sweep. (The idea of a limit from a quick
coupling is in Devogele et al., "Optimized discrete Fréchet distance between trajectories", BigSpatial 2017.)

Every cell within the limit sees the same correctly rounded operations whatever the number of lanes, the bound
and the range, so all ways of asking give the same bits.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.kernels.compilation import kernel

_CHUNK = 4  # values; diagonals are widened to multiples of it, as the processor takes that many at once
_NARROW_EVERY = 4  # diagonals; less often costs cells, more often costs looks at their ends
_GREEDY_FROM = 100  # points; below, a greedy coupling costs more than it spares
_SLACK = 1e-15, 1e-307  # relative and absolute, m²: more than what rounding can do to the square of a bound
NOT_FINITE = -1.0  # an answer for bad input; no distance is negative


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
    """Return the squared longest link of the coupling that goes along both curves evenly."""
    if p.shape[0] >= q.shape[0]:
        long, short = p, q
    else:
        long, short = q, p
    steps = long.shape[0] - 1
    rise = short.shape[0] - 1
    longest = 0.0
    j = 0
    part = 0
    if steps == rise and p.shape[1] == 2:  # by far the most frequent
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
def _greedy_coupling(p: FloatArray, q: FloatArray) -> float:
    """Return the squared longest link of the coupling that always takes the shortest next link."""
    i = 0
    j = 0
    longest = _squared_link(p, 0, q, 0)
    while i + 1 < p.shape[0] or j + 1 < q.shape[0]:
        best = np.inf
        onward = 0
        if i + 1 < p.shape[0] and j + 1 < q.shape[0]:
            best = _squared_link(p, i + 1, q, j + 1)
        if i + 1 < p.shape[0]:
            link = _squared_link(p, i + 1, q, j)
            if link < best or j + 1 == q.shape[0]:
                best = link
                onward = 1
        if j + 1 < q.shape[0]:
            link = _squared_link(p, i, q, j + 1)
            if link < best or i + 1 == p.shape[0]:
                best = link
                onward = 2
        i += onward != 2
        j += onward != 1
        longest = best if best > longest else longest
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


# Two kernels with everything in one straight line each: with a branch between the slices and their use, numba counts
# references to them on every diagonal, which took three times as long as the arithmetic at 40 points.


@kernel
def _diagonals_in_plane(
    n: int,
    m: int,
    limits: FloatArray,
    columns_p: FloatArray,
    columns_q: FloatArray,
    before: FloatArray,
    last: FloatArray,
    new: FloatArray,
) -> FloatArray:
    """Go through the table of 2-D curves, laid out as `_sweep` says, and return its last diagonal."""
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
    limits: FloatArray,
    dimension: int,
    columns_p: FloatArray,
    columns_q: FloatArray,
    squared: FloatArray,
    before: FloatArray,
    last: FloatArray,
    new: FloatArray,
) -> FloatArray:
    """Do what `_diagonals_in_plane` does in any dimension, with a pass per coordinate."""
    lanes = limits.shape[0]
    wide = columns_p.shape[0] // dimension
    long = columns_q.shape[0] // dimension
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
def _workspace(n: int, m: int, dimension: int, lanes: int) -> FloatArray:
    """Return memory for `_sweep` over curves of at most n and m points."""
    wide = n * lanes + _CHUNK
    return np.empty(dimension * (wide + m * lanes + 2 * _CHUNK) + 3 * (wide + 2 * lanes + _CHUNK) + wide)


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
        p: n × d.
        flat: the points of all curves, one after the other; N × d.
        offsets: curve k is flat[offsets[k] : offsets[k + 1]].
        chosen: indices of the curves to take, one per lane.
        limits: one limit for each lane, m²; where the squared distance is more, out gets some value above the limit.
        work: memory from `_workspace`.
        out: receives one value for each curve.
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
    # i = −1 included, and for all that is left out.
    size = wide + 2 * lanes + _CHUNK
    table = work[used : used + 3 * size]
    table[:] = np.inf
    before = table[:size]
    last = table[size : 2 * size]
    new = table[2 * size :]

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
        last[lanes + lane] = _squared_link(p, 0, flat, offsets[chosen[lane]])

    if dimension == 2:
        last = _diagonals_in_plane(n, m, limits, columns_p, columns_q, before, last, new)
    else:
        last = _diagonals(n, m, limits, dimension, columns_p, columns_q, squared, before, last, new)
    for lane in range(lanes):
        out[chosen[lane]] = last[n * lanes + lane]


@partial(kernel, nogil=True)
def measure(
    p: FloatArray, flat: FloatArray, offsets: IntArray, order: IntArray, bound: float, most: int, out: FloatArray
) -> None:
    """Write to out[order] the distances of p to the curves of `order`, infinity for those above the bound.

    Args:
        p: n × d.
        flat: the points of all curves, one after the other; N × d.
        offsets: curve k is flat[offsets[k] : offsets[k + 1]].
        order: indices of the curves to take, those of like length together.
        bound: 0 or more.
        most: number of curves that go through the table side by side.
        out: receives one value for each curve; only out[order] is written.
    """
    n = p.shape[0]
    squared_bound = bound * bound * (1.0 + _SLACK[0]) + _SLACK[1]
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
        if least > squared_bound:
            continue
        limit = _even_coupling(p, q)
        if limit > least and n >= _GREEDY_FROM and m >= _GREEDY_FROM:
            limit = min(limit, _greedy_coupling(p, q))
        if limit > least:
            open_curves[left] = k
            limits[left] = min(limit, squared_bound)
            left += 1
            longest = max(longest, m)
    if left > 0:
        work = _workspace(n, longest, p.shape[1], min(most, left))
        for start in range(0, left, most):
            end = min(start + most, left)
            _sweep(p, flat, offsets, open_curves[start:end], limits[start:end], work, out)
    for k in order:
        distance = np.sqrt(out[k])
        out[k] = distance if distance <= bound else np.inf


@kernel
def measure_one(p: FloatArray, q: FloatArray, bound: float) -> float:
    """Return the distance of one pair, infinity above the bound, or NOT_FINITE."""
    if not (all_finite(p) and all_finite(q)):
        return NOT_FINITE
    offsets = np.empty(2, np.int64)
    offsets[0] = 0
    offsets[1] = q.shape[0]
    out = np.empty(1)
    measure(p, q, offsets, np.zeros(1, np.int64), bound, 1, out)
    return out[0]  # type: ignore[no-any-return]
