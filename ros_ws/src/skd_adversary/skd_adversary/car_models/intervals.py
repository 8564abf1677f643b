"""Estimates with intervals, where the likelihood is flat or ends abruptly and a Hessian would say nothing.

* A boundary between what braked and what did not: the likelihood is a step function of it. With a flat prior its
  posterior is piecewise constant. The nearest observations above and below a boundary are, for many encounters,
  exponentially far away, so the boundary is uniform between them: the central 95 % cover it 95 % of the time.
* The half-width of uniform noise: the largest of m draws is Beta(m, 1) of it, exactly.
* Location and half-width of the braking noise: a posterior on a grid, flat priors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from skd_sim.arrays import FloatArray

LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """A number with its uncertainty.

    Attributes:
        value: maximum of the likelihood; its middle, where it is flat.
        standard_error: standard deviation of what the data leave open.
        low: lower end of the 95 % interval.
        high: upper end of the interval.
    """

    value: float
    standard_error: float
    low: float
    high: float


def half_width_estimate(largest: float, count: int) -> Estimate:
    """Return the half-width of uniform noise from the largest of `count` absolute draws; the interval is exact.

    The likelihood is zero below the largest draw and falls above it: the shortest interval begins there.
    """
    n = max(1, count)
    deviation = largest * math.sqrt(n / (n + 2.0)) / (n + 1.0)
    return Estimate(largest, deviation, largest, largest * (1.0 - LEVEL) ** (-1.0 / n))


def step_estimate(edges: FloatArray, values: FloatArray) -> Estimate:
    """Return the estimate of a boundary whose log-likelihood is constant between edges.

    Args:
        edges: k + 1 increasing positions; the range that is thought possible.
        values: k log-likelihoods, of the segments between them.
    """
    widths = np.diff(edges)
    edges, values, widths = np.append(edges[:-1][widths > 0.0], edges[-1]), values[widths > 0.0], widths[widths > 0.0]
    top = int(np.argmax(values))
    low = high = top
    while low > 0 and values[low - 1] >= values[top] - 1e-9:
        low -= 1
    while high + 1 < values.size and values[high + 1] >= values[top] - 1e-9:
        high += 1
    mass = np.exp(values - values[top]) * widths
    cumulative = np.append(0.0, np.cumsum(mass)) / mass.sum()
    tail = 0.5 * (1.0 - LEVEL)
    ends = np.interp([tail, 1.0 - tail], cumulative, edges)
    middles = 0.5 * (edges[1:] + edges[:-1])
    share = mass / mass.sum()
    mean = float(share @ middles)
    variance = float(share @ (np.square(middles - mean) + np.square(widths) / 12.0))
    value = 0.5 * float(edges[low] + edges[high + 1])
    return Estimate(value, math.sqrt(variance), min(float(ends[0]), value), max(float(ends[1]), value))


def marginal_estimate(grid: FloatArray, density: FloatArray, value: float) -> Estimate:
    """Return the estimate that a posterior density on an even grid gives.

    Args:
        grid: the k positions of the grid.
        density: k densities, up to a factor.
        value: the maximum of the likelihood.
    """
    weights = 0.5 * (density[1:] + density[:-1])
    cumulative = np.append(0.0, np.cumsum(weights)) / weights.sum()
    tail = 0.5 * (1.0 - LEVEL)
    low, high = np.interp([tail, 1.0 - tail], cumulative, grid)
    mean = float(np.average(grid, weights=density))
    deviation = math.sqrt(float(np.average(np.square(grid - mean), weights=density)))
    return Estimate(value, deviation, min(float(low), value), max(float(high), value))
