"""Intervals of estimates, and parameters that the logs do not determine: each gets a reason in words and a wide prior.

Intervals are for where the likelihood is flat or ends abruptly and a Hessian would say nothing:

* A boundary between what braked and what did not: the likelihood is a step function of it. With a flat prior its
  posterior is piecewise constant. The nearest observations above and below a boundary are, for many episodes,
  exponentially far away, so the boundary is uniform between them: the central 95 % cover it 95 % of the time.
* The half-width of uniform noise: the largest of m draws is Beta(m, 1) of it, exactly.
* Location and half-width of the braking noise: a posterior on a grid, flat priors.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from skd_sim.world.state import FloatArray, braking_distance

from skd_adversary.car_models.car_model_file import CarParameter, ParameterPrior

LEVEL = 0.95


@dataclass(frozen=True)
class IntervalEstimate:
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


def normal_estimate(value: float, error: float) -> IntervalEstimate:
    """Return an estimate whose error is normal, by its standard error."""
    return IntervalEstimate(value, error, value - 1.96 * error, value + 1.96 * error)


def half_width_estimate(largest: float, count: int) -> IntervalEstimate:
    """Return the half-width of uniform noise from the largest of `count` absolute draws; the interval is exact.

    The likelihood is zero below the largest draw and falls above it: the shortest interval begins there.
    """
    n = max(1, count)
    deviation = largest * math.sqrt(n / (n + 2.0)) / (n + 1.0)
    return IntervalEstimate(largest, deviation, largest, largest * (1.0 - LEVEL) ** (-1.0 / n))


def step_estimate(edges: FloatArray, values: FloatArray) -> IntervalEstimate:
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
    return IntervalEstimate(value, math.sqrt(variance), min(float(ends[0]), value), max(float(ends[1]), value))


def marginal_estimate(grid: FloatArray, density: FloatArray, value: float) -> IntervalEstimate:
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
    return IntervalEstimate(value, deviation, min(float(low), value), max(float(high), value))


LEAST_LOGS = 5
LEAST_BRAKING_LOGS = 5
LEAST_FREE_TICKS = 20
LEAST_BRAKING_TICKS = 10
WIDEST = 0.5
"""Half of the 95 % interval over the estimate, above which a number is not worth its name."""
LARGEST_LAPSE = 0.1
"""Share of ticks against the best law, above which no law is said to hold."""

PRIOR_DECELERATION = 3.5
"""m/s², of the paper's car: a car that never braked is thought to be like it, within wide limits."""


def wide_prior(name: str, measure: str, start_speed: float) -> ParameterPrior:
    """Return the prior of a parameter about which nothing is known; triggers have that of an unknown car.

    Args:
        name: name of the parameter.
        measure: what the trigger is compared with, `distance` or `time`.
        start_speed: speed of the car at the start of the logged episodes, m/s.
    """
    speed = max(start_speed, 1.0)
    reach = braking_distance(speed, PRIOR_DECELERATION)
    scale = reach if measure == "distance" else reach / speed
    limits = {
        "trigger": (0.25 * scale, 1.5 * scale),
        "trigger_spread": (0.0, 0.25 * scale),
        "path_half_width": (0.9, 5.0),
        "deceleration": (0.5 * PRIOR_DECELERATION, 2.5 * PRIOR_DECELERATION),
        "deceleration_noise": (0.0, 0.3),
        "reaction_delay": (0.0, 0.9),
        "cruise_speed": (0.5 * speed, 1.5 * speed),
        "cruise_gain": (0.0, 1.0),
        "cruise_acceleration": (0.5, 5.0),
        "speed_noise": (0.0, 0.15),
    }
    return ParameterPrior("uniform", *limits[name])


def _too_few(*counts: tuple[int, int, str]) -> str:
    """Return the first of what there is too little of: number, least number, name; empty if there is enough of all."""
    return next(
        (f"only {count} {what}, at least {least} are needed" for count, least, what in counts if count < least), ""
    )


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Turns estimates into parameters, or into the reason why there is none, by the counts of the logs.

    Attributes:
        logs: number of episodes.
        start_speed: speed of the car at the start of the episodes, m/s.
        braking_logs: number of those with braking.
        free: ticks of free driving.
        braking: ticks of braking.
        lapse: share of ticks that go against the law.
    """

    logs: int
    start_speed: float
    braking_logs: int = 0
    free: int = 0
    braking: int = 0
    lapse: float = 0.0

    def why_not_free(self) -> str:
        """Return why the logs say nothing of driving freely; empty if they do."""
        return _too_few((self.logs, LEAST_LOGS, "logs"), (self.free, LEAST_FREE_TICKS, "ticks of free driving"))

    def why_not_braking(self) -> str:
        """Return why the logs say nothing of braking; empty if they do."""
        if self.braking == 0:
            return f"the car never brakes in {self.logs} logs"
        return _too_few(
            (self.logs, LEAST_LOGS, "logs"),
            (self.braking, LEAST_BRAKING_TICKS, "ticks with braking"),
            (self.braking_logs, LEAST_BRAKING_LOGS, "logs with braking"),
        )

    def why_no_law(self) -> str:
        """Return why the logs do not say when the car brakes; empty if they do."""
        why = self.why_not_braking() or _too_few((self.free, LEAST_FREE_TICKS, "ticks without braking"))
        if not why and self.lapse > LARGEST_LAPSE:
            return f"{100 * self.lapse:.0f} % of the ticks go against the best law: no family explains this car"
        return why

    def unknown(self, why: str, *names: str) -> dict[str, CarParameter]:
        """Return parameters of which nothing is known, by name."""
        return {
            name: CarParameter(wide_prior(name, "distance", self.start_speed), reason=f"not identifiable: {why}")
            for name in names
        }

    def parameter(
        self,
        name: str,
        estimate: Callable[[], IntervalEstimate],
        why: str,
        distribution: str = "normal",
        *,
        measure: str = "distance",
        limit: float | None = WIDEST,
    ) -> CarParameter:
        """Return a parameter, or that it is not identifiable.

        Args:
            name: name of the parameter.
            estimate: makes the estimate; called only if there is no reason against it.
            why: why the parameter is not identifiable; empty if it is.
            distribution: prior if the parameter is identifiable: `uniform` over the interval, or `normal`.
            measure: what the trigger is compared with, `distance` or `time`.
            limit: largest half interval, as a share of the estimate; None: any.
        """
        wide = wide_prior(name, measure, self.start_speed)
        if why:
            return CarParameter(wide, reason=f"not identifiable: {why}")
        found = estimate()
        if limit is not None and found.high - found.low > 2.0 * limit * abs(found.value):
            prior = ParameterPrior("uniform", max(0.0, min(wide.first, found.low)), max(wide.second, found.high))
            return CarParameter(
                prior, reason=f"not identifiable: the logs leave it between {found.low:.3g} and {found.high:.3g}"
            )
        if found.high <= found.low:
            prior = ParameterPrior("point", found.value)
        elif distribution == "uniform":
            prior = ParameterPrior("uniform", found.low, found.high)
        else:
            prior = ParameterPrior("normal", found.value, found.standard_error)
        return CarParameter(prior, found.value, found.standard_error, (found.low, found.high))
