"""How the speed changes in a tick, while driving freely and while braking: densities and their estimation.

Paper, "The Cars": ν' = max(0, ν + U[−σν, σν] + Δt·a); a braking acceleration −b is itself perturbed by U[−e, e]
of its size. So the change is uniform while driving freely and trapezoidal while braking, both with known supports. A
free car that holds a speed is pulled towards it with a gain k, and may speed up no faster than a limit:
a = min(k·(ν_c − ν), a_max).
"""

from __future__ import annotations

import itertools
import math
from typing import Any, NamedTuple

import numpy as np
import scipy
from skd_sim.world.state import BoolArray, FloatArray, Pair, Triple

from skd_adversary.car_models.identifiability import IntervalEstimate, marginal_estimate
from skd_adversary.car_models.observations import Observations

BACKGROUND = (-15.0, 10.0)
"""Accelerations (m/s²) over which a tick that no mode explains is thought to be uniform."""
MOVING = 0.2  # m/s: slower, a car tells little, and many brakes are released at standstill
_APART = 20.0  # mean distances of neighbouring draws
LEAST_NOISE = 1e-4  # relative: rounding, and densities that stay finite
LARGEST_NOISE = 0.9  # relative, of the deceleration: what brakes does not speed up
_FAR = 25.0  # m: an adversary further ahead than this, or behind the car, leaves it free
_STARTS = 3
_APART_STARTS = math.log(1.5)  # of the decelerations of two starts
_CLEAR = 4.0  # standard errors of a slope that is not chance


class SpeedChange(NamedTuple):
    """Parameters of the change of speed.

    `speed_noise` and `deceleration_noise` are relative half-widths, `deceleration` is in m/s² (> 0), `gain` in 1/s,
    `cruise_speed` in m/s, `limit` in m/s². Weights: shares of ticks that drive freely, brake, and do neither.
    """

    speed_noise: float
    deceleration: float
    deceleration_noise: float
    gain: float = 0.0
    cruise_speed: float = 0.0
    weights: Triple = (0.9, 0.1, 0.0)
    limit: float = math.inf


def moving(data: Observations) -> BoolArray:
    """Return which ticks tell something about the car: those in which it moves at their start."""
    return np.asarray(data.speed > MOVING)


def trapezoid_density(z: FloatArray, a: FloatArray | float, b: FloatArray | float) -> FloatArray:
    """Return the density at z of U[−a, a] + U[−b, b]."""
    return np.asarray(np.clip(a + b - np.abs(z), 0.0, 2.0 * np.minimum(a, b)) / (4.0 * a * b))


def trapezoid_distribution(z: FloatArray, a: FloatArray | float, b: FloatArray | float) -> FloatArray:
    """Return the distribution function at z of U[−a, a] + U[−b, b]."""

    def square(x: FloatArray) -> FloatArray:
        return np.square(np.maximum(x, 0.0))

    total = square(z + a + b) - square(z + a - b) - square(z - a + b) + square(z - a - b)
    return np.asarray(np.clip(total / (8.0 * a * b), 0.0, 1.0))


def _half_widths(p: SpeedChange, data: Observations) -> tuple[FloatArray, float]:
    speed = np.maximum(data.speed, MOVING)
    braking = max(p.deceleration_noise, LEAST_NOISE) * p.deceleration * data.time_step
    return np.asarray(max(p.speed_noise, LEAST_NOISE) * speed), braking


def free_residual(p: SpeedChange, data: Observations) -> FloatArray:
    """Return the change of speed less what the free car intends, m/s."""
    pull = np.minimum(p.gain * (p.cruise_speed - data.speed), p.limit)
    return np.asarray(data.speed_after - data.speed - data.time_step * pull)


def densities(p: SpeedChange, data: Observations) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the likelihood of each tick while driving freely, while braking, and of the background.

    It is a density per m/s, and where the car came to stand the probability of a change that large.
    """
    a, b = _half_widths(p, data)
    stopped = data.speed_after <= 0.0
    z = free_residual(p, data)
    free = np.where(stopped, np.clip((z + a) / (2.0 * a), 0.0, 1.0), (np.abs(z) <= a) / (2.0 * a))
    z = data.speed_after - data.speed + p.deceleration * data.time_step
    brake = np.where(stopped, trapezoid_distribution(z, a, b), trapezoid_density(z, a, b))
    low, high = BACKGROUND[0] * data.time_step, BACKGROUND[1] * data.time_step
    share = np.clip((data.speed_after - data.speed - low) / (high - low), 1e-12, 1.0)
    return free, brake, np.where(stopped, share, 1.0 / (high - low))


def distributions(p: SpeedChange, data: Observations) -> tuple[FloatArray, FloatArray]:
    """Return the distribution functions of the change of speed, free and braking, at the recorded change."""
    a, b = _half_widths(p, data)
    z = free_residual(p, data)
    braked = data.speed_after - data.speed + p.deceleration * data.time_step
    return np.clip((z + a) / (2.0 * a), 0.0, 1.0), trapezoid_distribution(braked, a, b)


def _mixture(
    parts: tuple[FloatArray, FloatArray, FloatArray], rounds: int, start: Triple = (0.6, 0.35, 0.05)
) -> tuple[float, Triple, FloatArray]:
    """Return log-likelihood, weights and responsibilities (3 × n) of a mixture whose weights are fitted by EM."""
    stacked = np.stack(parts)
    weights = np.array(start)
    for _ in range(rounds):
        joint = weights[:, None] * stacked
        total = joint.sum(axis=0)
        weights = (joint / total).mean(axis=1)
        weights = np.maximum(weights, 1e-9)
        weights /= weights.sum()
    joint = weights[:, None] * stacked
    total = joint.sum(axis=0)
    return float(np.log(total).sum()), (float(weights[0]), float(weights[1]), float(weights[2])), joint / total


def _starts(data: Observations, base: SpeedChange) -> list[SpeedChange]:
    """Return where to begin: the best of a coarse grid, on a few hundred ticks spread over the data, best first.

    They differ in their deceleration: where a car's noise is as large as gentle braking, the likelihood has a peak at
    either, and on few ticks the wrong one can be the higher.

    Args:
        data: ticks in which the car moves.
        base: parameters whose pull towards a cruise speed, or its absence, is kept.
    """
    some = data.of(np.arange(len(data)) % max(1, len(data) // 250) == 0)
    slowing = (some.speed - some.speed_after) / some.time_step
    relative = np.abs(free_residual(base, some)) / np.maximum(some.speed, MOVING)
    strong = slowing[(slowing > 0.3) & (some.speed_after > 0.0)]
    decelerations = np.unique(np.quantile(strong, np.linspace(0.05, 0.95, 13)).round(2)) if strong.size else [3.5]
    noises = np.unique(np.maximum(np.quantile(relative, np.linspace(0.05, 1.0, 12)), 1e-3))
    found: list[tuple[float, SpeedChange]] = []
    for deceleration in decelerations:
        tried = []
        for noise, spread in itertools.product(noises, (0.02, 0.1, 0.3)):
            one = base._replace(speed_noise=float(noise), deceleration=float(deceleration), deceleration_noise=spread)
            value, weights, _ = _mixture(densities(one, some), 6)
            tried.append((value, one._replace(weights=weights)))
        found.append(max(tried, key=lambda pair: pair[0]))
    starts: list[SpeedChange] = []
    for _, one in sorted(found, key=lambda pair: -pair[0]):
        apart = (abs(math.log(one.deceleration / other.deceleration)) for other in starts)
        if len(starts) < _STARTS and all(far > _APART_STARTS for far in apart):
            starts.append(one)
    return starts


def _refine_noise(p: SpeedChange, data: Observations) -> SpeedChange:
    """Return p with the speed noise that is likeliest: one of the residuals, for the support ends at the largest."""
    relative = np.abs(free_residual(p, data)) / np.maximum(data.speed, MOVING)
    near = np.sort(relative[(relative > 0.5 * p.speed_noise) & (relative < 2.0 * p.speed_noise)])
    if near.size == 0:
        return p

    # Below the largest residual of a run of free ticks the likelihood only falls, so the last few of each run matter.
    def likeliest(noises: FloatArray) -> int:
        every = (densities(p._replace(speed_noise=noise), data) for noise in noises.tolist())
        return int(np.argmax([_mixture(one, 1, p.weights)[0] for one in every]))

    def spread(noises: FloatArray, count: int) -> FloatArray:
        return np.asarray(noises[np.unique(np.linspace(0, noises.size - 1, count).round().astype(int))])

    candidates = np.unique(np.append(spread(near, 30), near[-20:])) * (1.0 + 1e-12)
    top = likeliest(candidates)
    low, high = candidates[max(0, top - 1)], candidates[min(len(candidates) - 1, top + 1)]
    finer = near[(near >= low) & (near <= high)] * (1.0 + 1e-12)
    if finer.size > 60:
        finer = spread(finer, 60)
    return p._replace(speed_noise=float(finer[likeliest(finer)]))


def _refine_braking(p: SpeedChange, data: Observations, responsibility: FloatArray) -> SpeedChange:
    """Return p with the likeliest deceleration and deceleration noise, the other parameters as they are."""
    rows = responsibility[0] < 0.999  # of the others the braking density is nothing
    if not rows.any():
        return p
    some = data.of(rows)

    def cost(point: FloatArray) -> float:
        if point[1] > math.log(LARGEST_NOISE):
            return math.inf
        tried = p._replace(deceleration=float(np.exp(point[0])), deceleration_noise=float(np.exp(point[1])))
        stacked = np.array(p.weights)[:, None] * np.stack(densities(tried, some))
        return -float(np.log(stacked.sum(axis=0)).sum())

    start = np.log([p.deceleration, min(max(p.deceleration_noise, 1e-3), 0.7 * LARGEST_NOISE)])
    simplex = start + np.array([[0.0, 0.0], [0.02, 0.0], [0.0, 0.3]])
    options: Any = {"initial_simplex": simplex, "xatol": 1e-5, "fatol": 1e-5, "maxiter": 200}
    found = scipy.optimize.minimize(cost, start, method="Nelder-Mead", options=options)
    return p._replace(deceleration=float(np.exp(found.x[0])), deceleration_noise=float(np.exp(found.x[1])))


def _pulled(p: SpeedChange, data: Observations, free: BoolArray) -> SpeedChange:
    """Return p with a gain and a cruise speed, and a limit where there is one, by least squares over free ticks."""
    speed, change = data.speed[free], (data.speed_after - data.speed)[free] / data.time_step
    if free.sum() < 10 or np.ptp(speed) < 0.2:
        return p
    weight = 1.0 / np.maximum(speed, 0.5)
    slope, offset = np.polyfit(speed, change, 1, w=weight)
    if slope >= -1e-3:
        return p
    squares = float(np.square(weight * (change - offset - slope * speed)).sum())
    straight = p._replace(gain=float(-slope), cruise_speed=float(-offset / slope), limit=math.inf)
    # Below a speed s the limit holds: a = a_max − k·max(0, ν − s), which is linear in a_max and k.
    best, limited = math.inf, straight
    for corner in np.quantile(speed, np.linspace(0.02, 0.9, 40)):
        design = np.stack([np.ones_like(speed), -np.maximum(0.0, speed - corner)], axis=1) * weight[:, None]
        solution, *_ = np.linalg.lstsq(design, weight * change, rcond=None)
        left = float(np.square(weight * change - design @ solution).sum())
        limit, gain = float(solution[0]), float(solution[1])
        if left < best and limit > 0.0 and gain > 1e-3:
            best = left
            limited = p._replace(gain=gain, cruise_speed=float(corner) + limit / gain, limit=limit)
    gained = speed.size * math.log(squares / best) if 0.0 < best < squares else 0.0
    return limited if gained > 2.0 * math.log(speed.size) + 10.0 else straight


def _clearly_pulled(p: SpeedChange, data: Observations, free: BoolArray) -> bool:
    """Return whether, in free ticks, the change of speed depends on the speed by more than chance."""
    if free.sum() < 50 or np.ptp(data.speed[free]) < 0.2:
        return False
    slope, _, covariance = acceleration_line(data.of(free))
    return slope < -_CLEAR * math.sqrt(float(covariance[0, 0]))


def acceleration_line(data: Observations) -> tuple[float, float, FloatArray]:
    """Return slope (1/s) and offset (m/s²) of the acceleration over the speed by weighted least squares.

    Also their 2 × 2 covariance. The noise of the speed is relative to it, and so are the weights.
    """
    weight = 1.0 / np.maximum(data.speed, 0.5)
    design = np.stack([data.speed, np.ones(len(data))], axis=1) * weight[:, None]
    target = (data.speed_after - data.speed) / data.time_step * weight
    solution, *_ = np.linalg.lstsq(design, target, rcond=None)
    variance = float(np.square(target - design @ solution).sum()) / max(1, len(data) - 2)
    return float(solution[0]), float(solution[1]), np.asarray(variance * np.linalg.inv(design.T @ design))


def fit_speed_change(data: Observations) -> SpeedChange:
    """Return the likeliest parameters.

    Braking, and a pull towards a cruise speed, are kept only where the Bayesian information criterion pays for their
    parameters; a car that never brakes has the weight 0 for it.

    Args:
        data: ticks in which the car moves.
    """
    p, responsibility, value = _likeliest(data, SpeedChange(0.05, 3.5, 0.1))
    calm, calm_value = _without_braking(data)
    if value - calm_value < 1.5 * np.log(len(data)) + 3.0:  # two parameters and a weight, and a choice among ticks
        return calm
    pulled = _pulled(p, data, (responsibility[0] > 0.5) | (responsibility[2] > 0.5))
    if pulled.gain > 0.0:
        free = np.abs(free_residual(pulled, data)) / np.maximum(data.speed, MOVING)
        rows = responsibility[0] > 0.5
        if not rows.any():  # all was taken for something else than driving freely, and is pulled none the less
            rows = responsibility[2] > 0.5
        pulled = pulled._replace(speed_noise=float(np.quantile(free[rows], 0.99)))
        other, _, other_value = _polish(pulled, data)
        if other_value - value > np.log(len(data)):
            p, value = other, other_value
    # Where speeding up and braking look alike, what the car does undisturbed distinguishes them.
    sure = (data.gap < -data.car_length) | (data.gap > _FAR)  # no road user is near in front, whatever its law
    if _clearly_pulled(p, data, sure):
        pulled = _pulled(SpeedChange(0.05, 3.5, 0.1), data, sure)
        other, _, other_value = _likeliest(data, pulled)
        if other_value - value > 1.5 * np.log(len(data)):
            return other
    return p


def _without_braking(data: Observations) -> tuple[SpeedChange, float]:
    """Return the likeliest parameters of a car that never brakes, and their log-likelihood."""
    noise = float((np.abs(data.speed_after - data.speed) / data.speed).max()) * (1.0 + 1e-12)
    p = SpeedChange(noise, 1.0, 0.1, weights=(1.0, 0.0, 0.0))
    return p, float(np.log(densities(p, data)[0]).sum())


def _likeliest(data: Observations, base: SpeedChange) -> tuple[SpeedChange, FloatArray, float]:
    """Return what the best of several starts leads to; as `_polish`."""
    return max((_polish(start, data) for start in _starts(data, base)), key=lambda found: found[2])


def _polish(p: SpeedChange, data: Observations) -> tuple[SpeedChange, FloatArray, float]:
    """Return parameters near others that are likeliest, the modes' responsibilities (3 × n), and log-likelihood."""
    value, weights, responsibility = _mixture(densities(p, data), 20)
    for _ in range(4):
        p = _refine_noise(p._replace(weights=weights), data)
        p = _refine_braking(p, data, _mixture(densities(p, data), 20, weights)[2])
        before, (value, weights, responsibility) = value, _mixture(densities(p, data), 20, weights)
        if abs(value - before) < 1e-3:
            break
    return p._replace(weights=weights), responsibility, value


def refit(p: SpeedChange, data: Observations, free: BoolArray, braking: BoolArray) -> SpeedChange:
    """Return the likeliest parameters once it is known which ticks were free and which braking.

    Args:
        p: parameters to begin with; whether there is a pull towards a cruise speed is kept.
        data: ticks in which the car moves.
        free: the ticks in which the car was driven freely.
        braking: the ticks in which the car braked.
    """
    if free.any():
        if p.gain > 0.0:
            like = np.abs(free_residual(p, data)) <= 2.0 * p.speed_noise * data.speed
            p = _pulled(p, data, free & like)
        noise = np.sort((np.abs(free_residual(p, data)) / data.speed)[free])
        # The draws of uniform noise end where the next one is further away than chance explains (e⁻²⁰): what lies
        # beyond are ticks in which the car did something else.
        inside = max(1, int(np.searchsorted(noise, p.speed_noise, side="right")))
        while inside < noise.size and noise[inside] - noise[inside - 1] <= _APART * noise[inside - 1] / inside:
            inside += 1
        p = p._replace(speed_noise=float(noise[inside - 1] * (1.0 + 1e-12)))
    if braking.any():
        sure = np.stack([np.zeros(len(data)), np.ones(len(data)), np.zeros(len(data))])
        found = _refine_braking(p._replace(weights=(1e-12, 1.0 - 2e-12, 1e-12)), data.of(braking), sure[:, braking])
        p = found._replace(weights=p.weights)
    return p


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


def braking_estimates(p: SpeedChange, data: Observations) -> tuple[IntervalEstimate, IntervalEstimate]:
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


def _window(grid: FloatArray, density: FloatArray, least: float, most: float = np.inf) -> tuple[Pair, bool]:
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
