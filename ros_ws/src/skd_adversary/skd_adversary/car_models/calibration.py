"""Whether the fitted model predicts ticks it has not seen: the probability integral transform of held-out ticks."""

from __future__ import annotations

import numpy as np
import scipy
from skd_sim.arrays import BoolArray, FloatArray

from skd_adversary.car_models.families import Law, aside, nearness
from skd_adversary.car_models.observations import Observations
from skd_adversary.car_models.speed_change import SpeedChange, distributions, moving


def braking_probability(law: Law, data: Observations) -> FloatArray:
    """Return the probability that the car brakes, per tick, each taken by itself."""
    near, inside = nearness(data, law.family), aside(data, law.family) <= law.gate
    inside &= np.isfinite(near)
    distance = law.trigger - np.where(inside, near, 0.0)
    if law.family.spread == "sharp" or law.spread <= 0.0:
        brakes = (distance >= 0.0).astype(np.float64)
    elif law.family.spread == "encounter":
        brakes = scipy.special.ndtr(distance / law.spread)
    else:
        brakes = scipy.special.expit(distance / law.spread)
    brakes = np.where(inside, brakes, 0.0)
    return np.asarray(law.lapse + (1.0 - 2.0 * law.lapse) * brakes)


def integral_transform(change: SpeedChange, law: Law, data: Observations, rng: np.random.Generator) -> FloatArray:
    """Return the predicted distribution function at each recorded change of speed: uniform, if the model is right.

    Where the car came to stand, which has a probability of its own, a uniform draw below it is taken.
    """
    rows: BoolArray = moving(data)
    free, braking = distributions(change, data)
    brakes = braking_probability(law, data)
    value = (brakes * braking + (1.0 - brakes) * free)[rows]
    stopped = data.speed_after[rows] <= 0.0
    return np.asarray(np.where(stopped, value * rng.random(value.size), value))


def kolmogorov_smirnov(values: FloatArray) -> tuple[float, float]:
    """Return statistic and p-value of uniformity on [0, 1] (asymptotic, with Stephens' correction)."""
    n = values.size
    ordered = np.sort(values)
    steps = np.arange(1, n + 1) / n
    statistic = float(max((steps - ordered).max(), (ordered - steps + 1.0 / n).max()))
    root = np.sqrt(n)
    return statistic, float(scipy.special.kolmogorov((root + 0.12 + 0.11 / root) * statistic))
