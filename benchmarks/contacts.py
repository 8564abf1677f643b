"""With which side of the car somebody was touched, and how a run counts: the front of the moving car, or another side.

A run ends at the first touch. Where it is made with less than the scenario's `collision.hit_speed` of the car, somebody
has walked into a car that stands. Else it is a hit; and where it is not the front that touches, a blind adversary has
run into the flank of a car that passes, or into its rear.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.world.contact import to_car_frame
from skd_sim.world.episode import EpisodeLog, Outcome

_SAME = 1e-6  # m, by which a touching disc's distance may differ from its radius


class Run(StrEnum):
    """How a run counts; one letter each, as a stored file has them."""

    NONE = "."
    """Nobody was touched."""
    SLOW = "s"
    """Somebody touched a car slower than hit_speed."""
    FRONT = "F"
    """Hit with the front, its corners included."""
    FLANK = "L"
    """Hit, and it was the left or the right side that touched."""
    REAR = "R"
    """Hit, and it was the rear that touched, its corners included."""


def side_of_contact(ahead: float, left: float, half_width: float, radius: float) -> Run:
    """Return which side of a rectangle a disc touches, its centre being there in the rectangle's frame.

    A disc that touches a side has its centre a radius beside it; one whose centre is nearer to the axis touches front
    or rear or one of their corners. So the offset alone tells flank from front, and it is known to the bit: within a
    tick a car that goes straight changes its place ahead alone. Which of front and rear it is, is known a metre off.

    Args:
        ahead: of the middle of the car, m.
        left: of its axis, m.
        half_width: of the car, m.
        radius: of the disc, m.
    """
    if abs(left) >= half_width + radius - _SAME:
        return Run.FLANK
    return Run.FRONT if ahead > 0.0 else Run.REAR


def run_of(log: EpisodeLog) -> Run:
    """Return how a run counts.

    Raises:
        UsageError: the road is not straight, or the adversary is no disc.
        RuntimeError: it was aborted.
    """
    if log.outcome == Outcome.ABORTED:
        raise RuntimeError(log.reason)
    if log.outcome != Outcome.COLLISION:
        return Run.NONE
    scenario = log.episode.scenario
    if not scenario.collision.is_hit(log.impact_speed):
        return Run.SLOW
    radius = scenario.adversary.shape[0]
    if radius == 0.0 or not scenario.road.straight:
        raise UsageError("the side of a contact is known of a disc on a straight road alone")
    x, y = log.trajectory.positions[-1]
    before, after = log.car[-2, :2], log.car[-1, :2]
    passed = log.impact_time / scenario.time_step - (len(log.car) - 2)
    car_x, car_y = before + passed * (after - before)
    middle = 0.5 * (scenario.car.front - scenario.car.rear)
    ahead, left = to_car_frame(float(x), float(y), float(car_x), float(car_y), HEADING_NORTH)
    return side_of_contact(ahead - middle, left, scenario.car.half_width, radius)


def counted(letters: str, *kinds: Run) -> np.ndarray:
    """Return which runs of a stored line are of one of some kinds, n booleans."""
    return np.isin(np.array(list(letters)), [str(kind) for kind in kinds])
