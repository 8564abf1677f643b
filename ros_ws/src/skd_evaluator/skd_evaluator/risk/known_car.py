"""Crossings in front of the basic car, all that it does being known: compiled, the same to the bit as episodes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.controllers.basic import basic_acceleration
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import road_pose
from skd_sim.world.contact import sweep, to_car_frame
from skd_sim.world.episode import Episode, Mode
from skd_sim.world.state import next_speed, travelled

from skd_evaluator.metrics.behaviour.walking import walk
from skd_evaluator.risk.crossings import CrossingPlan, Crossings, Ends
from skd_evaluator.risk.touching import SAME, in_car_frame, missed_by, side_touched


class Course(NamedTuple):
    """The scenario in numbers; lengths in m, speeds in m/s, times in s."""

    line: FloatArray  # of the road
    front: float
    rear: float
    half_width: float
    radius: float
    start_speed: float
    gap_range: float
    trigger: float
    deceleration: float
    speed_noise: float
    acceleration_noise: float
    time_step: float
    minimum_impact_speed: float
    hit_speed: float


def course_of(episode: Episode) -> Course:
    """Return a scenario in numbers."""
    scenario = episode.scenario
    car = scenario.car
    return Course(
        scenario.road.line,
        car.front,
        car.rear,
        car.half_width,
        scenario.adversary.reach,
        car.start_speed,
        car.start_gap_range,
        episode.multiplier * car.safe_distance,
        car.deceleration,
        car.speed_noise,
        car.acceleration_noise,
        scenario.time_step,
        scenario.collision.minimum_impact_speed,
        scenario.collision.hit_speed,
    )


@kernel
def cross(
    course: Course, way: FloatArray, count: int, gap: float, draws: FloatArray, path: FloatArray
) -> tuple[int, float, int]:
    """Let the car meet somebody who walks a way.

    Args:
        course: the scenario.
        way: places at ticks, m.
        count: how many of them.
        gap: front bumper to the crossing line before the draw, m.
        draws: uniform in [0, 1): of the start, then of speed and acceleration in each tick.
        path: 2 × 4, to work in.

    Returns:
        A `Touch`, the least time by which the front of the moving car missed, s, and the number of ticks, that of the
        contact included.
    """
    s = -(gap + course.gap_range * draws[0]) - course.front
    x, y, heading = road_pose(course.line, s)
    speed, least = course.start_speed, math.inf
    footprint = (course.front, course.rear, course.half_width)
    for tick in range(count - 1):
        here, there = (way[tick, 0], way[tick, 1]), (way[tick + 1, 0], way[tick + 1, 1])
        ahead, _ = to_car_frame(here[0], here[1], x, y, heading)
        command = basic_acceleration(ahead - course.front, course.trigger, course.deceleration)
        speed_draw = course.speed_noise * (2.0 * draws[1 + 2 * tick] - 1.0)
        applied = command + course.acceleration_noise * (2.0 * draws[2 + 2 * tick] - 1.0) * command
        after = next_speed(speed, applied, speed_draw, course.time_step)
        distance = travelled(speed, after, course.time_step)
        path[0, 0], path[0, 1], path[0, 2], path[0, 3] = x, y, heading, speed
        path[1, 0], path[1, 1] = x + distance * math.cos(heading), y + distance * math.sin(heading)
        path[1, 2], path[1, 3] = heading, after
        velocity = ((there[0] - here[0]) / course.time_step, (there[1] - here[1]) / course.time_step)
        share, impact = sweep(
            path, here, there, velocity, 0.0, footprint, (course.radius, 0.0, 0.0), course.time_step, 0, 1
        )
        until = 1.0
        contact = share <= 1.0 and impact >= course.minimum_impact_speed
        if contact:
            until = share
        near = missed_by(path, here, there, until, footprint, course.radius, course.hit_speed, course.time_step)
        least = min(least, near)
        if contact:
            ahead, left, _ = in_car_frame(path, here, there, share)
            side = side_touched(ahead, left, footprint, course.radius, impact, course.hit_speed, SAME)
            return side, 0.0 if side == 1 else max(least, 1e-9), tick + 1
        x, y, speed = path[1, 0], path[1, 1], after
    return 0, max(least, 1e-9), count - 1


@kernel
def cross_many(
    course: Course,
    paths: FloatArray,
    lengths: IntArray,
    gaps: FloatArray,
    values: FloatArray,
    phi: IntArray,
    walker: FloatArray,
    car: FloatArray,
    normal: bool,
    scale: float,
    touch: IntArray,
    missed: FloatArray,
    lasted: IntArray,
) -> None:
    """Run crossings; `car` has standard normals, or what is uniform in [0, 1) already."""
    ticks = (car.shape[1] - 1) // 2
    way, path, draws = np.empty((ticks + 1, 2)), np.empty((2, 4)), np.empty(car.shape[1])
    for row in range(phi.shape[0]):
        index = phi[row]
        intended = paths[index, : lengths[index]]
        count = walk(intended, values, walker[row], scale, course.time_step, way)
        for at in range(draws.shape[0]):
            draws[at] = 0.5 * math.erfc(-car[row, at] * math.sqrt(0.5)) if normal else car[row, at]
        touch[row], missed[row], lasted[row] = cross(course, way, count, gaps[index], draws, path)


class KnownCar:
    """Runs crossings in front of a basic car."""

    def __init__(self, crossing_plan: CrossingPlan) -> None:
        """Take the scenario apart into numbers."""
        self.car_normals = 1 + 2 * crossing_plan.ticks
        episodes = [
            crossing_plan.plan.episode(Mode.KAMIKAZE, index, 0, phi) for index, phi in enumerate(crossing_plan.safe)
        ]
        self._course = course_of(episodes[0])
        self._values = crossing_plan.values
        self._lengths = np.array([len(phi) for phi in crossing_plan.safe], np.int64)
        self._paths = np.zeros((len(crossing_plan.safe), int(self._lengths.max()), 2))
        for index, phi in enumerate(crossing_plan.safe):
            self._paths[index, : len(phi)] = phi.positions
        self._gaps = np.array([episode.start_gap for episode in episodes])

    def run(self, crossings: Crossings, scale: float) -> Ends:
        """Run crossings by the car's normals."""
        return self._run(crossings, crossings.car, scale, normal=True)

    def run_drawn(self, crossings: Crossings, draws: FloatArray, scale: float) -> Ends:
        """Run crossings by what the car has drawn, uniform in [0, 1)."""
        return self._run(crossings, draws, scale, normal=False)

    def _run(self, crossings: Crossings, car: FloatArray, scale: float, *, normal: bool) -> Ends:
        touch, missed = np.empty(len(crossings), np.int64), np.empty(len(crossings))
        lasted = np.empty(len(crossings), np.int64)
        cross_many(
            self._course, self._paths, self._lengths, self._gaps, self._values, crossings.phi,
            np.ascontiguousarray(crossings.walker), np.ascontiguousarray(car), normal, scale, touch, missed, lasted,
        )  # fmt: skip
        return Ends(touch, missed, lasted)
