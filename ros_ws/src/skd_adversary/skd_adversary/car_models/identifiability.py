"""Parameters that the logs do not determine: each gets a reason in words and a wide prior."""

from __future__ import annotations

from collections.abc import Callable

from skd_sim.world.state import braking_distance

from skd_adversary.car_models.fitted_car import Parameter, Prior
from skd_adversary.car_models.intervals import Estimate

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


def wide_prior(name: str, measure: str, start_speed: float) -> Prior:
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
    return Prior("uniform", *limits[name])


class Judge:
    """Turns estimates into parameters, or into the reason why there is none."""

    def __init__(self, *, logs: int, braking_logs: int, free: int, braking: int, lapse: float) -> None:
        """Take the counts of the logs: episodes, those with braking, free and braking ticks, the law's lapse."""
        self._logs = logs
        self._braking_logs = braking_logs
        self._free = free
        self._braking = braking
        self._lapse = lapse

    def why_not_free(self) -> str:
        """Return why the logs say nothing of driving freely; empty if they do."""
        if self._logs < LEAST_LOGS:
            return f"only {self._logs} logs, at least {LEAST_LOGS} are needed"
        if self._free < LEAST_FREE_TICKS:
            return f"only {self._free} ticks of free driving, at least {LEAST_FREE_TICKS} are needed"
        return ""

    def why_not_braking(self) -> str:
        """Return why the logs say nothing of braking; empty if they do."""
        if self._braking == 0:
            return f"the car never brakes in {self._logs} logs"
        if self._logs < LEAST_LOGS:
            return f"only {self._logs} logs, at least {LEAST_LOGS} are needed"
        if self._braking < LEAST_BRAKING_TICKS:
            return f"only {self._braking} ticks with braking, at least {LEAST_BRAKING_TICKS} are needed"
        if self._braking_logs < LEAST_BRAKING_LOGS:
            return f"the car brakes in only {self._braking_logs} logs, at least {LEAST_BRAKING_LOGS} are needed"
        return ""

    def why_no_law(self) -> str:
        """Return why the logs do not say when the car brakes; empty if they do."""
        why = self.why_not_braking()
        if not why and self._free < LEAST_FREE_TICKS:
            return f"only {self._free} ticks without braking, at least {LEAST_FREE_TICKS} are needed"
        if not why and self._lapse > LARGEST_LAPSE:
            return f"{100 * self._lapse:.0f} % of the ticks go against the best law: no family explains this car"
        return why


def parameter(
    estimate: Callable[[], Estimate], why: str, wide: Prior, *, distribution: str, limit: float | None = WIDEST
) -> Parameter:
    """Return a parameter, or that it is not identifiable.

    Args:
        estimate: makes the estimate; called only if there is no reason against it.
        why: why the parameter is not identifiable; empty if it is.
        wide: prior if it is not identifiable.
        distribution: prior if the parameter is identifiable: `uniform` over the interval, or `normal`.
        limit: largest half interval, as a share of the estimate; None: any.
    """
    if why:
        return Parameter(wide, reason=f"not identifiable: {why}")
    found = estimate()
    if limit is not None and found.high - found.low > 2.0 * limit * abs(found.value):
        prior = Prior("uniform", max(0.0, min(wide.first, found.low)), max(wide.second, found.high))
        return Parameter(
            prior, reason=f"not identifiable: the logs leave it between {found.low:.3g} and {found.high:.3g}"
        )
    if found.high <= found.low:
        prior = Prior("point", found.value)
    elif distribution == "uniform":
        prior = Prior("uniform", found.low, found.high)
    else:
        prior = Prior("normal", found.value, found.standard_error)
    return Parameter(prior, found.value, found.standard_error, (found.low, found.high))
