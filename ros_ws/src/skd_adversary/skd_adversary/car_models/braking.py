"""What the logs say of the braking: deceleration and its noise together, with what they leave open."""

from __future__ import annotations

import numpy as np
from skd_sim.arrays import FloatArray

from skd_adversary.car_models.intervals import Estimate, marginal_estimate
from skd_adversary.car_models.observations import Observations
from skd_adversary.car_models.speed_change import (
    LARGEST_NOISE,
    LEAST_NOISE,
    MOVING,
    SpeedChange,
    trapezoid_density,
    trapezoid_distribution,
)

_POINTS = 61


def _log_likelihood(p: SpeedChange, data: Observations, decelerations: FloatArray, noises: FloatArray) -> FloatArray:
    """Return the log-likelihood of braking ticks over a grid, decelerations × noises (relative)."""
    a = max(p.speed_noise, LEAST_NOISE) * np.maximum(data.speed, MOVING)
    stopped = data.speed_after <= 0.0
    background = 1e-9  # a tick that is not braking at all must not rule out the whole grid
    values = np.empty((decelerations.size, noises.size))
    for row, deceleration in enumerate(decelerations):
        z = (data.speed_after - data.speed + deceleration * data.time_step)[None, :]
        b = (np.maximum(noises, LEAST_NOISE) * deceleration * data.time_step)[:, None]
        likelihood = np.where(stopped, trapezoid_distribution(z, a, b), trapezoid_density(z, a, b))
        values[row] = np.log(likelihood + background).sum(axis=1)
    return values


def braking_estimates(p: SpeedChange, data: Observations) -> tuple[Estimate, Estimate]:
    """Return deceleration (m/s²) and deceleration noise (relative half-width) with their intervals.

    Args:
        p: the likeliest parameters.
        data: the ticks in which the car braked.
    """
    some = max(1, len(data))
    scale = np.sqrt(np.mean(np.square(p.speed_noise * data.speed)) / 3.0) / data.time_step
    own = p.deceleration_noise * p.deceleration / np.sqrt(3.0)
    step = max(float(np.hypot(scale, own)) / np.sqrt(some), 1e-4 * p.deceleration)
    b_low, b_high = max(1e-3, p.deceleration - 6.0 * step), p.deceleration + 6.0 * step
    e_low, e_high = 0.0, min(LARGEST_NOISE, max(0.02, 3.0 * p.deceleration_noise))
    for _ in range(5):  # until the grid holds what is possible, and little else
        decelerations = np.linspace(b_low, b_high, _POINTS)
        noises = np.linspace(e_low, e_high, _POINTS)
        values = _log_likelihood(p, data, decelerations, noises)
        density = np.exp(values - values.max())
        by_b, by_e = density.sum(axis=1), density.sum(axis=0)
        new_b, fits_b = _window(decelerations, by_b, 1e-3)
        new_e, fits_e = _window(noises, by_e, 0.0, LARGEST_NOISE)
        if fits_b and fits_e:
            break
        (b_low, b_high), (e_low, e_high) = new_b, new_e
    return (
        marginal_estimate(decelerations, by_b, p.deceleration),
        marginal_estimate(noises, by_e, p.deceleration_noise),
    )


def _window(
    grid: FloatArray, density: FloatArray, least: float, most: float = np.inf
) -> tuple[tuple[float, float], bool]:
    """Return a range that holds all that a density leaves possible, and whether the grid already was such a range."""
    step = float(grid[1] - grid[0])
    inside = np.flatnonzero(density > 1e-5 * density.max())
    first, last = int(inside[0]), int(inside[-1])
    cut_low = first == 0 and grid[0] > least
    cut_high = last == grid.size - 1 and grid[-1] < most
    wide = step * grid.size
    low = grid[0] - 0.5 * wide if cut_low else grid[first] - step
    high = grid[-1] + 0.5 * wide if cut_high else grid[last] + step
    good = not cut_low and not cut_high and last - first >= grid.size // 3
    return (max(least, float(low)), min(most, float(high))), good
