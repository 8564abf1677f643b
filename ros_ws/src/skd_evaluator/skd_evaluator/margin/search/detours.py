"""Detours: a trajectory that was driven is left for one action, by which the road user is hit if the car drives on.

The car is taken to drive as it did. In the tick in which the trajectory is left that is what happens, if the car
decides at the begin of a tick; later it is a guess, which a drive confirms or not.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import road_pose, road_position
from skd_sim.world.contact import sweep
from skd_sim.world.episode import EpisodeSpec, Role, generator
from skd_sim.world.state import FloatArray, IntArray
from skd_sim.world.world import first_car_state

from skd_evaluator.margin.search.candidates import ActionSpace

_BEND = 0.5  # m by which the path of a car in a tick may be off a straight line


def undisturbed_car(episode: EpisodeSpec) -> FloatArray:
    """Return x, y (m), heading (rad) and speed (m/s) of a car at each tick that keeps its first speed, n × 4."""
    scenario = episode.scenario
    car = first_car_state(scenario, episode.start_gap, generator(episode.seed, episode.episode_id, Role.START))
    line = scenario.road.line
    begin, _ = road_position(line, car.x, car.y)
    ticks = np.arange(scenario.ticks + 1)
    along = begin + scenario.time_step * car.speed * ticks
    return np.array([(*road_pose(line, one), car.speed) for one in along.tolist()])


def detour(
    space: ActionSpace,
    actions: IntArray,
    users: FloatArray,
    cars: FloatArray,
    bound: float,
    longest: int,
    first: int = 0,
) -> tuple[float, IntArray] | None:
    """Return the deviation (m) and actions of the detour of least deviation that is hit; None where there is none.

    Args:
        space: has the velocities of actions.
        actions: what is left.
        users: places of the road user then, at ticks, n × 2, m.
        cars: pose and speed of the car then, n × 4.
        bound: only hits with less deviation count, m.
        longest: ticks, at most, from leaving the trajectory to the hit.
        first: tick before which it is not left.
    """
    scenario, car = space.scenario, space.scenario.car
    footprint, limits = (car.front, car.rear, car.half_width), (scenario.time_step, scenario.collision.hit_speed, bound)
    deviation, tick, action, length = _best_detour(
        footprint,
        scenario.adversary.shape,
        limits,
        space.phi,
        space.table_along(users, longest),
        users,
        cars,
        first,
        longest,
    )
    if tick < 0:
        return None
    found = actions.copy()
    found[tick : tick + length] = action
    return deviation, found


@kernel
def _best_detour(
    footprint: tuple[float, float, float],
    shape: tuple[float, float, float],
    limits: tuple[float, float, float],
    phi: FloatArray,
    table: FloatArray,
    users: FloatArray,
    cars: FloatArray,
    first: int,
    longest: int,
) -> tuple[float, int, int, int]:
    """Return deviation, tick in which a trajectory is left (−1: never), action, and for how many ticks."""
    step, hit_speed, bound = limits
    reach = shape[0] if shape[0] > 0.0 else math.hypot(shape[1], shape[2])
    touching = math.hypot(max(footprint[0], footprint[1]), footprint[2]) + reach + _BEND
    fastest = 0.0
    for velocity in table.reshape(-1, 2):
        fastest = max(fastest, velocity[0] ** 2 + velocity[1] ** 2)
    fastest = math.sqrt(fastest)
    best = (-1, -1, 0)
    deviated = 0.0
    for begin in range(users.shape[0] - 1):
        deviated = max(deviated, math.hypot(users[begin, 0] - phi[begin, 0], users[begin, 1] - phi[begin, 1]))
        if deviated >= bound:
            break
        last = min(begin + longest, users.shape[0] - 1)
        if begin < first or not _may_meet(users[begin], cars[begin : last + 1], touching, step, fastest):
            continue
        for action in range(table.shape[1]):
            x, y, most = users[begin, 0], users[begin, 1], deviated
            for tick in range(begin, last):
                held = min(tick - begin, table.shape[2] - 1)
                vx, vy = table[tick - held, action, held, 0], table[tick - held, action, held, 1]
                x_to, y_to = x + step * vx, y + step * vy
                away, away_y = x - phi[tick, 0], y - phi[tick, 1]
                away_to, away_y_to = x_to - phi[tick + 1, 0], y_to - phi[tick + 1, 1]
                east, north, east_to, north_to = cars[tick, 0], cars[tick, 1], cars[tick + 1, 0], cars[tick + 1, 1]
                if _least_distance(x - east, y - north, x_to - east_to, y_to - north_to) <= touching:
                    path, heading, ends = cars[tick : tick + 2], math.atan2(vy, vx), (x_to, y_to)
                    share, impact = sweep(path, (x, y), ends, (vx, vy), heading, footprint, shape, step, 0, 1)
                    if share <= 1.0:
                        east, north = away + share * (away_to - away), away_y + share * (away_y_to - away_y)
                        reached = max(most, math.hypot(east, north))
                        if impact >= hit_speed and reached < bound:
                            bound, best = reached, (begin, action, tick + 1 - begin)
                        break
                most = max(most, math.hypot(away_to, away_y_to))
                if most >= bound:
                    break
                x, y = x_to, y_to
    return bound, *best


@kernel
def _may_meet(user: FloatArray, cars: FloatArray, touching: float, step: float, fastest: float) -> bool:
    """Return whether a road user can come within `touching` (m) of the car, wherever it goes from the first tick on."""
    for tick in range(cars.shape[0] - 1):
        moved = step * (max(cars[tick, 3], cars[tick + 1, 3]) + (tick + 1) * fastest)
        if math.hypot(user[0] - cars[tick, 0], user[1] - cars[tick, 1]) <= touching + moved:
            return True
    return False


@kernel
def _least_distance(x: float, y: float, x_to: float, y_to: float) -> float:
    """Return the least distance between the origin and a segment."""
    along, up = x_to - x, y_to - y
    square = along * along + up * up
    share = min(1.0, max(0.0, -(x * along + y * up) / square)) if square > 0.0 else 0.0
    return math.sqrt((x + share * along) ** 2 + (y + share * up) ** 2)
