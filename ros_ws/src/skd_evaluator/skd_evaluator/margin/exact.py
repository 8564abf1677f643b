"""Placeholder until the exact search is merged."""

from __future__ import annotations

from skd_sim.episode import Episode

from skd_evaluator.floor.clairvoyant_deformation import deformation_floor
from skd_evaluator.margin.least_way import LeastWay


def exact_margin(episode: Episode, upper_bound: float | None = None) -> LeastWay | None:
    """Return the least way."""
    bound = episode.scenario.eta_max if upper_bound is None else upper_bound
    found = deformation_floor(episode, bound)
    if found is None:
        return None
    return LeastWay(found.distance, found.trajectory, found.duration, 1.0, found.gap)
