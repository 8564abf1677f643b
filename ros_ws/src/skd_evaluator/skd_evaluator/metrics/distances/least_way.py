"""The way of least deviation on which the moving car hits, in one trial."""

from __future__ import annotations

from dataclasses import dataclass

from skd_sim.world.state import Trajectory


@dataclass(frozen=True, eq=False)
class LeastWay:
    """The way of least deviation that ends in a hit, under the draws of one trial.

    Attributes:
        distance: deviation of the way, m.
        trajectory: the adversary's positions per tick, the last of them at the contact, m.
        duration: time until the contact, ticks.
        impact_speed: speed of the car at the contact, m/s; at least the scenario's `collision.hit_speed`.
        gap: the least deviation of all is no more than this below `distance`, m; 0: up to rounding it is `distance`;
            infinity: that is not known, for the way was found by search.
    """

    distance: float
    trajectory: Trajectory
    duration: float
    impact_speed: float
    gap: float
