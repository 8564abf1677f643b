"""What the logs say of a trigger that varies, with what they leave open."""

from __future__ import annotations

import numpy as np
from skd_sim.arrays import FloatArray

from skd_adversary.car_models.families import Evidence, Law, encounter_values, spread_values
from skd_adversary.car_models.intervals import LEVEL, Estimate, marginal_estimate

_POINTS = 31


def sharp_spread(e: Evidence, law: Law) -> Estimate:
    """Return the spread of a trigger that was found sharp: 0, and how large a spread the logs could have hidden.

    The upper end is the 95 % point of its posterior under a flat prior, the trigger at its estimate.
    """
    spreads = max(law.trigger, 1e-3) * np.geomspace(1e-4, 1.0, 40)
    values = encounter_values(e, law, spreads)
    density = np.exp(values - values.max())
    weights = np.append(density[0] * spreads[0], 0.5 * (density[1:] + density[:-1]) * np.diff(spreads))
    cumulative = np.cumsum(weights) / weights.sum()
    high = float(np.interp(LEVEL, cumulative, spreads))
    return Estimate(0.0, high / 2.0, 0.0, high)


def spread_estimates(e: Evidence, law: Law) -> tuple[Estimate, Estimate]:
    """Return trigger and spread of a law whose trigger is not sharp, from their posterior on a grid, flat priors."""
    step = 0.1 * max(law.spread, 1e-3)
    triggers: FloatArray = np.empty(0)
    spreads: FloatArray = np.empty(0)
    low, high = law.trigger - 10.0 * step, law.trigger + 10.0 * step
    least, most = 0.3 * law.spread, 2.5 * law.spread
    by_trigger = by_spread = triggers
    for _ in range(4):
        triggers, spreads = np.linspace(max(0.0, low), high, _POINTS), np.linspace(least, most, _POINTS)
        values = spread_values(e, law, triggers, spreads)
        density = np.exp(values - values.max())
        by_trigger, by_spread = density.sum(axis=1), density.sum(axis=0)
        inside = by_trigger > 1e-4 * by_trigger.max()
        within = by_spread > 1e-4 * by_spread.max()
        if not (inside[0] or inside[-1] or within[-1]) and inside.sum() > 8 and within.sum() > 8:
            break
        low, high = _around(triggers, inside)
        least, most = _around(spreads, within)
        least = max(1e-4 * max(law.trigger, 1e-3), least)
    return (
        marginal_estimate(triggers, by_trigger, law.trigger),
        marginal_estimate(spreads, by_spread, law.spread),
    )


def _around(grid: FloatArray, inside: FloatArray) -> tuple[float, float]:
    """Return a range around the points that count, wider where they reach the grid's ends."""
    chosen = np.flatnonzero(inside)
    step = float(grid[1] - grid[0])
    low = grid[chosen[0]] - (10.0 if chosen[0] == 0 else 1.0) * step
    high = grid[chosen[-1]] + (10.0 if chosen[-1] == grid.size - 1 else 1.0) * step
    return float(low), float(high)
