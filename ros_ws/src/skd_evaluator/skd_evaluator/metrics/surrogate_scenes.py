"""A car and a road user over time, from whatever source: what all surrogate safety measures are computed of.

Between two moments both move uniformly, as in the contact test (`skd_sim.world.contact`); seen from the car the
other's centre then runs along a straight segment.

Interactions one after another, as one: what is computed moment by moment is then computed of all of them at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import until_contact
from skd_sim.world.state import FloatArray, IntArray

from skd_evaluator.metrics.contact_place import car_until_contact


@dataclass(frozen=True, eq=False)
class Interaction:
    """Two road users over time, in any frame in which the ground does not move.

    Attributes:
        times: n moments, s, strictly increasing.
        car: n × 4: reference point (x, y), m, heading, rad, and speed, m/s.
        other: n × 2, centre of the other road user, m.
        velocity: n × 2, velocity of the other in the same frame, m/s.
        turned: n, where the other's box points, rad; not used for a disc.
        footprint: of the car: ahead of its reference point, behind it and to each side, m.
        shape: of the other: radius, half length and half width, m; a disc has a radius, a box has none.
    """

    times: FloatArray
    car: FloatArray
    other: FloatArray
    velocity: FloatArray
    turned: FloatArray
    footprint: tuple[float, float, float]
    shape: tuple[float, float, float]

    def __len__(self) -> int:
        return len(self.times)

    @cached_property
    def seen(self) -> FloatArray:
        """Centre of the other in the car's frame: ahead and to the left of its reference point, n × 2, m."""
        return self._in_car_frame(self.other - self.car[:, :2])

    @cached_property
    def moving(self) -> FloatArray:
        """Velocity of the other along the axes of the car's frame, n × 2, m/s: its own, not as seen from the car."""
        return self._in_car_frame(self.velocity)

    @cached_property
    def turned_from_car(self) -> FloatArray:
        """Where the other's box points from the car's heading, n, rad."""
        return self.turned - self.car[:, 2]

    @cached_property
    def extent(self) -> FloatArray:
        """Half of what the other takes along and across the car's heading, n × 2, m."""
        radius, half_length, half_width = self.shape
        if radius > 0.0:
            return np.full((len(self), 2), radius)
        cos, sin = np.abs(np.cos(self.turned_from_car)), np.abs(np.sin(self.turned_from_car))
        return np.column_stack([cos * half_length + sin * half_width, sin * half_length + cos * half_width])

    @cached_property
    def gap(self) -> FloatArray:
        """From the car's front to the nearest edge of the other along the car's heading, n, m; below 0 beside it."""
        return np.asarray(self.seen[:, 0] - self.extent[:, 0] - self.footprint[0])

    @cached_property
    def closing(self) -> FloatArray:
        """How fast the gap closes, n, m/s."""
        return np.asarray(self.car[:, 3] - self.moving[:, 0])

    def _in_car_frame(self, vectors: FloatArray) -> FloatArray:
        cos, sin = np.cos(self.car[:, 2]), np.sin(self.car[:, 2])
        x, y = vectors.T
        return np.column_stack([cos * x + sin * y, cos * y - sin * x])


class EpisodeMotion(NamedTuple):
    """How an episode went.

    Attributes:
        times: n ticks, and at the end the contact, if there is one, s.
        adversary: n × 2 positions then, m.
        car: n × 4: reference point (x, y), m, heading, rad, and speed, m/s.
    """

    times: FloatArray
    adversary: FloatArray
    car: FloatArray


def course_of(
    scenario: Scenario, adversary: FloatArray, car: FloatArray, contact: float = math.nan, impact: float = math.nan
) -> EpisodeMotion:
    """Return the course of an episode whose states are at ticks.

    Args:
        scenario: road, time step, and how the car moves within a tick.
        adversary: n × 2 positions at ticks, m.
        car: n × 4: reference point (x, y), m, heading, rad, and speed, m/s.
        contact: time of the contact, which is in the last tick, s; nan without one.
        impact: speed of the car then, m/s.
    """
    time_step = scenario.time_step
    times = np.arange(len(adversary), dtype=np.float64) * time_step
    if math.isnan(contact):
        return EpisodeMotion(times, adversary, car)
    if contact <= times[-2]:  # at the tick itself
        return EpisodeMotion(times[:-1], adversary[:-1], car[:-1])
    times[-1], ticks = contact, contact / time_step
    walked = until_contact(adversary, ticks)
    return EpisodeMotion(times, walked, car_until_contact(scenario, car, ticks, impact, walked[-1]))


@dataclass(frozen=True, eq=False)
class Interactions:
    """Interactions with one footprint and one shape.

    Attributes:
        whole: all moments, scene by scene; times begin anew in each.
        starts: where in it each scene begins, and at last its length, k + 1.
    """

    whole: Interaction
    starts: IntArray

    @classmethod
    def of(cls, scene: Interaction) -> Interactions:
        """Return one scene as scenes."""
        return cls(scene, np.array([0, len(scene)]))

    @cached_property
    def last(self) -> IntArray:
        """Last moment of the scene in which each moment is."""
        return np.repeat(self.starts[1:] - 1, np.diff(self.starts))

    def least(self, values: FloatArray) -> FloatArray:
        """Return the least in each scene, k, of one value for each moment."""
        return np.asarray(np.minimum.reduceat(values, self.starts[:-1]))

    def most(self, values: FloatArray) -> FloatArray:
        """Return the greatest in each scene, k, of one value for each moment."""
        return np.asarray(np.maximum.reduceat(values, self.starts[:-1]))

    def at_end(self, values: FloatArray) -> FloatArray:
        """Return the value at the last moment of each scene, k."""
        return values[self.starts[1:] - 1]

    def every(self, step: float) -> Interactions:
        """Return the same on a grid of moments `step` (s) apart, and at the last moment of each.

        Measures that are greatest or least over time then mean the same for sources of any rate. Velocities are kept
        from one moment to the next, everything else is joined in straight lines, headings the shorter way.
        """
        whole = self.whole
        first, end = whole.times[self.starts[:-1]], self.at_end(whole.times)
        counts = np.where(np.diff(self.starts) > 1, np.ceil((end - first) / step), 0.0).astype(np.int64) + 1
        starts = np.concatenate([[0], np.cumsum(counts)])
        times, held = _grid(whole.times, self.starts, starts, step)
        following = np.minimum(held + 1, self.last[held])
        after, lasts = times - whole.times[held], whole.times[following] - whole.times[held]

        def at(values: FloatArray, *, turns: bool = False) -> FloatArray:
            change = values[following] - values[held]
            if turns:
                change = np.where(np.abs(change) > np.pi, np.remainder(change + np.pi, 2.0 * np.pi) - np.pi, change)
            rate = np.divide(change, lasts, out=np.zeros_like(change), where=lasts > 0.0)
            return rate * after + values[held]

        x, y, heading, speed = whole.car.T
        car = np.column_stack([at(x), at(y), at(heading, turns=True), at(speed)])
        other = np.column_stack([at(column) for column in whole.other.T])
        finer = Interaction(times, car, other, whole.velocity[held], whole.turned[held], whole.footprint, whole.shape)
        return Interactions(finer, starts)


def scene_of(scenario: Scenario, times: FloatArray, adversary: FloatArray, car: FloatArray) -> Interaction:
    """Return the scene of an episode: the car keeps to its lane, and the adversary moves uniformly in each tick.

    Args:
        scenario: road and shapes.
        times: n ticks, and at the end the contact, if there is one, s.
        adversary: n × 2 positions then, m.
        car: n × 4: reference point (x, y), m, heading, rad, and speed, m/s.
    """
    return scenes_of(scenario, [EpisodeMotion(times, adversary, car)]).whole


def scenes_of(scenario: Scenario, courses: Sequence[EpisodeMotion]) -> Interactions:
    """Return the scenes of episodes, at least one, in a scenario; see `scene_of`."""
    body = scenario.adversary
    starts = np.cumsum([0, *(len(one.times) for one in courses)])
    times, places, car = (np.concatenate(parts) for parts in zip(*courses, strict=True))
    velocity = velocities(times, places, starts)
    turned = np.zeros(len(times))
    if body.is_box:
        for start, end in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
            heading = body.first_heading
            for tick, (vx, vy) in enumerate(velocity[start:end].tolist(), start):
                heading = turned[tick] = body.heading(heading, vx, vy)
    scene = Interaction(times, car, places, velocity, turned, scenario.car.footprint, body.shape)
    return Interactions(scene, starts)


def velocities(times: FloatArray, places: FloatArray, starts: IntArray) -> FloatArray:
    """Return n × 2 velocities, m/s, of who is at places (n × 2, m) and moves uniformly from each to the next.

    At the last moment of a scene it is the velocity that led there; who is seen once stands.
    """
    found = np.zeros_like(places)
    within = np.ones(len(times), bool)
    within[starts[1:] - 1] = False
    (rows,) = np.nonzero(within)
    found[rows] = (places[rows + 1] - places[rows]) / (times[rows + 1] - times[rows])[:, None]
    ends = starts[1:][np.diff(starts) > 1] - 1
    found[ends] = found[ends - 1]
    return found


@kernel
def _grid(times: FloatArray, starts: IntArray, finer: IntArray, step: float) -> tuple[FloatArray, IntArray]:
    """Return the moments of the grid, s, and of each the last given moment that is not after it.

    Args:
        times: given moments, s.
        starts: where each scene begins in them.
        finer: where each scene begins in the grid.
        step: between moments of the grid, s.
    """
    moments, held = np.empty(finer[-1]), np.empty(finer[-1], np.int64)
    for scene in range(len(starts) - 1):
        first, last = starts[scene], starts[scene + 1] - 1
        spacing, place = (times[first] + step) - times[first], first  # as numpy's arange has it
        for row in range(finer[scene], finer[scene + 1]):
            moment = times[first] + (row - finer[scene]) * spacing
            if row + 1 == finer[scene + 1]:
                moment = times[last]
            while place < last and times[place + 1] <= moment:
                place += 1
            moments[row], held[row] = moment, place
    return moments, held
