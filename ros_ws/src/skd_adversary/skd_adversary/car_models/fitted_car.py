"""A car that was learned from logs: every parameter of its predictive model, with its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass

from skd_sim.errors import UsageError
from skd_sim.inputs.model import Count, Finite, Frozen

from skd_adversary.car_models.car_forest import CarForest

DISTRIBUTIONS = ("point", "uniform", "normal")

PARAMETERS = {
    "trigger": "m",  # s where the measure is time
    "trigger_spread": "m",
    "path_half_width": "m",
    "deceleration": "m/s²",
    "deceleration_noise": "relative",
    "reaction_delay": "s",
    "cruise_speed": "m/s",
    "cruise_gain": "1/s",
    "cruise_acceleration": "m/s²",
    "speed_noise": "relative",
}
"""Every parameter and its unit; half-widths of uniform noise are relative to the quantity that they perturb."""

LARGEST = {
    "trigger": 60.0,
    "trigger_spread": 60.0,
    "path_half_width": 20.0,
    "deceleration": 30.0,
    "deceleration_noise": 1.0,
    "reaction_delay": 10.0,
}
"""The most that each can be where logs determine it, in its unit: more than recordings may show, and a fit looks for.

A number in another unit, such as mm, is beyond it. What others come to (a speed to which a car that speeds up is on its
way, say) has no end.
"""

LONGEST_DELAY = 3
"""Ticks between what the car sees and what it does, at most, that are looked for in logs and planned with."""

OPTIONAL = ("path_half_width", "cruise_acceleration")
"""Of them, those that a car may not have: no path that it looks at, no limit to how it speeds up."""


@dataclass(frozen=True)
class Prior:
    """Prior of a parameter: a point, uniform(first, second) or normal(first, second = deviation)."""

    distribution: str
    first: float
    second: float = 0.0

    def __post_init__(self) -> None:
        if self.distribution not in DISTRIBUTIONS:
            raise UsageError(f"distribution must be one of {', '.join(DISTRIBUTIONS)}, got {self.distribution!r}")
        if not (math.isfinite(self.first) and math.isfinite(self.second)):
            raise UsageError(f"a {self.distribution} prior needs finite numbers, got {self.first}, {self.second}")
        if self.distribution == "uniform" and self.second < self.first:
            raise UsageError(f"a uniform prior needs low ≤ high, got {self.first:g}, {self.second:g}")
        if self.distribution == "normal" and self.second < 0.0:
            raise UsageError(f"a normal prior needs a deviation ≥ 0, got {self.second:g}")


@dataclass(frozen=True)
class Parameter:
    """One parameter as the logs show it.

    Attributes:
        prior: what the adversary believes of the parameter.
        estimate: likeliest value; none where it is not identifiable.
        standard_error: standard error of the estimate; None where it is not identifiable.
        interval: 95 % interval; None where it is not identifiable.
        reason: why it is not identifiable, beginning with "not identifiable: "; empty if it is.
    """

    prior: Prior
    estimate: float | None = None
    standard_error: float | None = None
    interval: tuple[float, float] | None = None
    reason: str = ""

    @property
    def identifiable(self) -> bool:
        """Whether the logs determine it."""
        return not self.reason


@dataclass(frozen=True)
class FamilyRow(Frozen):
    """One line of the comparison of families; log-likelihoods in nats.

    `held_out` is over all folds; none for a family that is far behind in AIC.
    """

    name: str
    parameters: Count
    log_likelihood: Finite
    aic: Finite
    bic: Finite
    held_out: Finite | None
    trigger: Finite


@dataclass(frozen=True)
class Calibration(Frozen):
    """Probability integral transform of held-out ticks against the uniform distribution (Kolmogorov-Smirnov)."""

    ticks: Count
    statistic: Finite
    p_value: Finite


@dataclass(frozen=True)
class Prediction(Frozen):
    """How well held-out ticks are predicted, by one way to predict them.

    Attributes:
        model: `law` or `forest`.
        ticks: number of held-out ticks.
        statistic: Kolmogorov-Smirnov distance of their probability integral transform from the uniform distribution.
        near_ticks: how many of them were near the road user.
        near_statistic: the same statistic of the ticks near the road user.
        score: mean continuous ranked probability score of the change of speed in those, m/s; less is better.
    """

    model: str
    ticks: Count
    statistic: Finite
    near_ticks: Count
    near_statistic: Finite
    score: Finite


@dataclass(frozen=True)
class FittedCar:
    """The predictive model of a car, from logs.

    Attributes:
        measure: what the trigger is compared with: `distance` (m) or `time` (s to contact).
        gate: whether the adversary has to be in the path: `none`, `position` or `predicted`.
        spread: how the trigger varies: `sharp` (not at all), `encounter` (from one encounter to the next) or `tick`
            (from tick to tick).
        lapse: share of ticks that go against the law.
        parameters: all of `PARAMETERS`, by name, except for `OPTIONAL` ones that the car does not have.
        families: comparison of all families, the best held-out likelihood first.
        chosen: name of the chosen family.
        calibration: how well the chosen family is calibrated; None where there are too few logs.
        logs: number of episodes.
        ticks: number of ticks.
        braking_ticks: number of ticks in which the car braked.
        time_step: duration of a tick, s.
        version: version of SKD that fitted it.
        front: front bumper of the car in the logs ahead of its reference point, m; none where it was not written down.
        rear: rear bumper behind the reference point, m; None where it was not written down.
        forest: forest that predicts the car, where no law does it as well; None: the law does.
        predictions: how well law and forest predict held-out ticks, if there are enough logs to compare them.
        waiting_reward: m of deviation, at most 0, that each step after φ's end costs who waits for this car, by what
            kamikazes came to with it; none: nobody has tried, and the kind of model says it.
    """

    measure: str
    gate: str
    spread: str
    lapse: float
    parameters: dict[str, Parameter]
    families: tuple[FamilyRow, ...]
    chosen: str
    calibration: Calibration | None
    logs: int
    ticks: int
    braking_ticks: int
    time_step: float
    version: str = "unknown"
    front: float | None = None
    rear: float | None = None
    forest: CarForest | None = None
    predictions: tuple[Prediction, ...] = ()
    waiting_reward: float | None = None

    def unit(self, name: str) -> str:
        """Return the unit of a parameter."""
        return "s" if self.measure == "time" and name in ("trigger", "trigger_spread") else PARAMETERS[name]
