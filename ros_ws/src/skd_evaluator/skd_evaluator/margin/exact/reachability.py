"""What can happen, at most, while the adversary stays within a limit of φ: convex sets of places, there and back.

What the basic car does in a tick depends on the adversary through one thing alone: whether it is behind the front,
in the strip in which the car brakes for it, or ahead of that. A *history* says which, tick by tick, and so which state
the car is in. If a pedestrian could also take any velocity between those of its moves, the places that it can be at
under a history would form a convex set: φ's neighbourhood, cut by the strips, and the sums of such sets with the moves.
Real ones are among them. Backwards, likewise, a set holds all from where it can still be hit within the limit. Where
nothing is left on either side no sequence of moves leads to a hit.

One kamikaze episode of the basic car in numbers: φ, the car and its known noise.

The car's noise is known for every tick, so its state is a function of when it braked.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from skd_sim.kernels.compilation import kernel
from skd_sim.world.episode import EpisodeSpec, Role, generator
from skd_sim.world.state import FloatArray, IntArray, next_speed, travelled
from skd_sim.world.world import make_world

from skd_evaluator.margin.actions import MOVE_COUNT, move_velocity
from skd_evaluator.margin.exact.polygons import MOST, SLACK, add, cut, cut_to_capsule, half_planes, hull

BEHIND, BRAKED, AHEAD = range(3)
"""Where the adversary is when a tick begins: behind the car's front, in the strip in which it brakes, ahead of it."""
NONE = -1
_MOVE_POINTS = MOVE_COUNT + 4
_PIECES = 24  # of a tick in which there can be a contact, at most
_OUTSTANDING = 0.003  # share of a limit by which a set may stand out of it


class Reachability(NamedTuple):
    """Memory for histories; their id is a row. Sets are rows of `points` and `planes`."""

    size: IntArray  # [histories, rows of points, rows of planes]
    car: FloatArray  # history → x, y, m, and speed, m/s
    tick: IntArray  # history → how many ticks have gone
    child: IntArray  # history × where → history, NONE
    touches: IntArray  # history × where → whether a hit in the tick is possible
    points: FloatArray  # corners of sets, m
    reached: IntArray  # history → first row, and number of rows: where it can be
    planes: FloatArray  # (a, b, c): a·x + b·y ≤ c
    hopeful: IntArray  # history × where → first row, and number of rows: from where there can be a hit
    moves: FloatArray  # tick × corner × 2: hull of the displacements in a tick, m
    move_count: IntArray  # tick → its corners


def make_reachability(histories: int, ticks: int) -> Reachability:
    """Return memory for this many histories."""

    def integers(*shape: int) -> IntArray:
        return np.empty(shape, np.int64)

    return Reachability(
        size=np.zeros(3, np.int64),
        car=np.empty((histories, 3)),
        tick=integers(histories),
        child=integers(histories, 3),
        touches=integers(histories, 3),
        points=np.empty((24 * histories + 4 * MOST, 2)),
        reached=integers(histories, 2),
        planes=np.empty((24 * histories + 4 * MOST, 3)),
        hopeful=integers(histories, 3, 2),
        moves=np.zeros((ticks, _MOVE_POINTS, 2)),
        move_count=np.zeros(ticks, np.int64),
    )


@kernel
def fill_moves(c: ExactProblem, f: Reachability) -> None:
    """Fill in the hulls of displacements."""
    points, out = np.empty((MOVE_COUNT, 2)), np.empty((MOST, 2))
    for tick in range(c.noise.shape[0]):
        for move in range(MOVE_COUNT):
            vx, vy = move_velocity(move, c.path, tick, c.time_step, c.adversary_speed)
            points[move, 0], points[move, 1] = c.time_step * vx, c.time_step * vy
        count = hull(points, MOVE_COUNT, out)
        f.move_count[tick] = count
        f.moves[tick, :count] = out[:count]


@kernel
def _grown_car(c: ExactProblem, x: float, y: float, out: FloatArray) -> int:
    """Write a polygon around all places of a disc's centre at which it touches the car."""
    n = 0
    steps = 3
    outer = (c.radius + SLACK) / np.cos(0.25 * np.pi / steps)
    for corner in range(4):
        corner_x = x + (c.half_width if corner in (0, 3) else -c.half_width)
        corner_y = y + (c.front if corner < 2 else -c.rear)
        for k in range(steps):
            angle = 0.5 * np.pi * (corner + (k + 0.5) / steps)
            out[n, 0], out[n, 1] = corner_x + outer * np.cos(angle), corner_y + outer * np.sin(angle)
            n += 1
    # Their sides are those of the rectangle grown by the radius.
    for i in range(n):
        out[i, 0] = min(max(out[i, 0], x - c.half_width - c.radius - SLACK), x + c.half_width + c.radius + SLACK)
        out[i, 1] = min(max(out[i, 1], y - c.rear - c.radius - SLACK), y + c.front + c.radius + SLACK)
    return n


@kernel
def in_zone(
    c: ExactProblem, where: int, car: FloatArray, points: FloatArray, count: int, out: FloatArray, other: FloatArray
) -> int:
    """Write the part of a set that is behind the front, in the strip or ahead; return the number of its points.

    Beside a car that stands it is all one.
    """
    if car[2] == 0.0:
        out[:count] = points
        return count
    front = car[1] + c.front
    if where == BEHIND:
        return cut(points, count, 0.0, 1.0, front + SLACK, out)
    if where == AHEAD:
        return cut(points, count, 0.0, -1.0, -(front + c.trigger) + SLACK, out)
    n = cut(points, count, 0.0, 1.0, front + c.trigger + SLACK, other)
    return cut(other, n, 0.0, -1.0, -front + SLACK, out)


@kernel
def contact_set(
    c: ExactProblem,
    f: Reachability,
    tick: int,
    before: FloatArray,
    after: FloatArray,
    limit: float,
    planes: FloatArray,
    plane_count: int,
    box: FloatArray,
    fine: float,
    out: FloatArray,
) -> int:
    """Write points whose hull holds all places of a set from which a hit within the limit in this tick is possible.

    Args:
        c: what is known of the episode beforehand.
        f: the reachability bound, which has the moves.
        tick: number of the tick in which the hit is.
        before: state of the car when it begins.
        after: state of the car when it ends.
        limit: greatest deviation, m.
        planes: half-planes that bound the set.
        plane_count: how many half-planes there are.
        box: around the set: low x, high x, low y, high y, m.
        fine: length, m, of the parts in which the car's motion past φ is looked at.
        out: receives the points; the row count is its room.

    Returns:
        Number of points.
    """
    # From when to when in the tick the car is fast enough: its speed is linear.
    begin, end = 0.0, 1.0
    speed, speed_after = before[2], after[2]
    if speed < c.hit_speed and speed_after < c.hit_speed:
        return 0
    if speed < c.hit_speed:
        begin = max(0.0, (c.hit_speed - speed) / (speed_after - speed) - 1e-9)
    elif speed_after < c.hit_speed:
        end = min(1.0, (c.hit_speed - speed) / (speed_after - speed) + 1e-9)
    moved_x, moved_y = after[0] - before[0], after[1] - before[1]
    moves, move_count = f.moves[tick], f.move_count[tick]
    # The set against the box that the car sweeps, as the adversary sees it.
    low_x, high_x, low_y, high_y = 0.0, 0.0, 0.0, 0.0
    for i in range(move_count):
        low_x, high_x = min(low_x, moved_x - moves[i, 0]), max(high_x, moved_x - moves[i, 0])
        low_y, high_y = min(low_y, moved_y - moves[i, 1]), max(high_y, moved_y - moves[i, 1])
    side = c.half_width + c.radius + SLACK
    if (
        box[0] > before[0] + side + high_x
        or box[1] < before[0] - side + low_x
        or box[2] > before[1] + c.front + c.radius + SLACK + high_y
        or box[3] < before[1] - c.rear - c.radius - SLACK + low_y
    ):
        return 0
    x_phi, y_phi = place_of_phi(c, tick)
    x_to, y_to = place_of_phi(c, tick + 1)
    past_x, past_y = x_to - x_phi - moved_x, y_to - y_phi - moved_y
    length = np.sqrt(past_x * past_x + past_y * past_y) * (end - begin)
    pieces = max(1, min(_PIECES, int(np.ceil(length / fine))))
    grown, other, sum_, cone = np.empty((MOST, 2)), np.empty((MOST, 2)), np.empty((MOST, 2)), np.empty((MOST, 2))
    corners = np.empty((2 * _MOVE_POINTS, 2))
    n = 0
    for piece in range(pieces):
        s = begin + (end - begin) * piece / pieces
        e = begin + (end - begin) * (piece + 1) / pieces
        count = _grown_car(c, before[0], before[1], grown)
        first, last = (x_phi + s * past_x, y_phi + s * past_y), (x_phi + e * past_x, y_phi + e * past_y)
        count = cut_to_capsule(grown, count, first, last, SURE * limit + MARGIN, _OUTSTANDING, other)
        if count == 0:
            continue
        for i in range(move_count):
            dx, dy = moved_x - moves[i, 0], moved_y - moves[i, 1]
            corners[2 * i, 0], corners[2 * i, 1] = s * dx, s * dy
            corners[2 * i + 1, 0], corners[2 * i + 1, 1] = e * dx, e * dy
        cone_count = hull(corners, 2 * move_count, cone)
        count = add(grown, count, cone, cone_count, sum_)
        for k in range(plane_count):
            count = cut(sum_, count, planes[k, 0], planes[k, 1], planes[k, 2], other)
            if count == 0:
                break
            sum_, other = other, sum_
        if n + count > out.shape[0]:
            break
        for i in range(count):
            out[n, 0], out[n, 1] = sum_[i, 0], sum_[i, 1]
            n += 1
    return n


@kernel
def _box_of(points: FloatArray, count: int, box: FloatArray) -> None:
    box[0], box[1], box[2], box[3] = np.inf, -np.inf, np.inf, -np.inf
    for i in range(count):
        box[0], box[1] = min(box[0], points[i, 0]), max(box[1], points[i, 0])
        box[2], box[3] = min(box[2], points[i, 1]), max(box[3], points[i, 1])


@kernel
def reach_forwards(c: ExactProblem, f: Reachability, limit: float, fine: float, only_whether: bool) -> int:
    """Make all histories within a limit, and the sets that go with them.

    Args:
        c: what is known of the episode beforehand.
        f: memory, with its moves; its other content is overwritten.
        limit: greatest deviation, m.
        fine: how finely places are told apart, as in `contact_set`.
        only_whether: stop at the first hit that is possible.

    Returns:
        1: a hit is possible, as far as this tells; 0: none is; −1: no room.
    """
    ticks = c.noise.shape[0]
    north = np.empty(ticks + 1)  # the farthest North that φ will be
    highest = -np.inf
    for tick in range(ticks, -1, -1):
        highest = max(highest, place_of_phi(c, tick)[1])
        north[tick] = highest
    zone, other, sum_, planes = np.empty((MOST, 2)), np.empty((MOST, 2)), np.empty((MOST, 2)), np.empty((MOST + 4, 3))
    touching = np.empty(((_PIECES + 2) * MOST, 2))
    box = np.empty(4)
    f.size[0], f.size[1], f.size[2] = 1, 1, 0
    f.car[0, 0], f.car[0, 1], f.car[0, 2] = c.car_x, c.car_y, c.car_speed
    f.tick[0] = 0
    f.points[0, 0], f.points[0, 1] = c.path[0, 0], c.path[0, 1]
    f.reached[0, 0], f.reached[0, 1] = 0, 1
    possible = 0
    state = 0
    while state < f.size[0]:
        tick = f.tick[state]
        f.child[state, :] = NONE
        f.touches[state, :] = 0
        y, speed = f.car[state, 1], f.car[state, 2]
        if (
            tick >= ticks
            or speed * c.fastest[tick] < c.hit_speed
            or y - c.rear - c.radius > north[tick] + SURE * limit + MARGIN
        ):
            state += 1
            continue
        first, count = f.reached[state, 0], f.reached[state, 1]
        phi = place_of_phi(c, tick + 1)
        for where in range(3):
            if speed == 0.0 and where != BRAKED:
                continue
            n = in_zone(c, where, f.car[state], f.points[first : first + count], count, zone, other)
            if n == 0:
                continue
            new = f.size[0]
            if new >= f.car.shape[0] or f.size[1] + MOST > f.points.shape[0]:
                return -1
            distance, after = car_step(c, speed, where == BRAKED, tick)
            f.car[new, 0] = f.car[state, 0] + distance * c.cos_heading
            f.car[new, 1] = f.car[state, 1] + distance * c.sin_heading
            f.car[new, 2] = after
            f.tick[new] = tick + 1
            _box_of(zone, n, box)
            plane_count = half_planes(zone, n, planes)
            if contact_set(c, f, tick, f.car[state], f.car[new], limit, planes, plane_count, box, fine, touching) > 0:
                f.touches[state, where] = 1
                possible = 1
                if only_whether:
                    return 1
            n = add(zone, n, f.moves[tick], f.move_count[tick], sum_)
            n = cut(sum_, n, 1.0, 0.0, c.path_edge + SLACK, zone)
            n = cut_to_capsule(zone, n, phi, phi, SURE * limit + MARGIN, _OUTSTANDING, other)
            if n == 0 and f.touches[state, where] == 0:
                continue
            f.child[state, where] = new  # with nothing in it where there is a hit in this tick or none at all
            f.reached[new, 0], f.reached[new, 1] = f.size[1], n
            f.points[f.size[1] : f.size[1] + n] = zone[:n]
            f.size[1] += n
            f.size[0] = new + 1
        state += 1
    return possible


@kernel
def reach_backwards(c: ExactProblem, f: Reachability, limit: float, fine: float) -> int:
    """Fill in, after `reach_forwards` with the same limit, from where there can be a hit.

    Returns:
        0; −1: no room.
    """
    zone, other, sum_, planes = np.empty((MOST, 2)), np.empty((MOST, 2)), np.empty((MOST, 2)), np.empty((MOST + 4, 3))
    touching = np.empty(((_PIECES + 6) * MOST, 2))
    together = np.empty((4 * MOST, 2))
    backwards = np.empty((_MOVE_POINTS, 2))
    box = np.empty(4)
    # From here on `reached` of a history holds from where there can be a hit.
    for state in range(f.size[0] - 1, -1, -1):
        tick = f.tick[state]
        first, count = f.reached[state, 0], f.reached[state, 1]
        all_count = 0
        for where in range(3):
            f.hopeful[state, where, 0], f.hopeful[state, where, 1] = f.size[2], 0
            child = f.child[state, where]
            if child < 0:
                continue
            n = in_zone(c, where, f.car[state], f.points[first : first + count], count, zone, other)
            plane_count = half_planes(zone, n, planes)
            m = 0
            if f.touches[state, where] != 0:
                _box_of(zone, n, box)
                m = contact_set(
                    c, f, tick, f.car[state], f.car[child], limit, planes, plane_count, box, fine, touching[: -2 * MOST]
                )
            next_first, next_count = f.reached[child, 0], f.reached[child, 1]
            if next_count > 0:
                move_count = f.move_count[tick]
                for i in range(move_count):
                    backwards[i, 0], backwards[i, 1] = -f.moves[tick, i, 0], -f.moves[tick, i, 1]
                n = add(f.points[next_first : next_first + next_count], next_count, backwards, move_count, sum_)
                for k in range(plane_count):
                    n = cut(sum_, n, planes[k, 0], planes[k, 1], planes[k, 2], other)
                    if n == 0:
                        break
                    sum_, other = other, sum_
                for i in range(n):
                    touching[m, 0], touching[m, 1] = sum_[i, 0], sum_[i, 1]
                    m += 1
            if m == 0:
                f.child[state, where] = NONE
                continue
            n = hull(touching, m, zone)
            if f.size[2] + MOST + 4 > f.planes.shape[0]:
                return -1
            rows = half_planes(zone, n, f.planes[f.size[2] :])
            f.hopeful[state, where, 1] = rows
            f.size[2] += rows
            together[all_count : all_count + n] = zone[:n]
            all_count += n
        if all_count == 0:
            f.reached[state, 1] = 0
            continue
        n = hull(together, all_count, zone)
        if n > count:  # back into its place, or, where there is no room, as it was
            if f.size[1] + n > f.points.shape[0]:
                continue
            f.reached[state, 0] = f.size[1]
            f.size[1] += n
            first = f.reached[state, 0]
        f.reached[state, 1] = n
        f.points[first : first + n] = zone[:n]
    return 0


@kernel(inline=True)
def where_of(c: ExactProblem, f: Reachability, state: int, x: float, y: float) -> int:
    """Return where an adversary at (x, y), m, is for the car; beside a standing one it is all the same."""
    if f.car[state, 2] == 0.0:
        return BRAKED
    dx, dy = x - f.car[state, 0], y - f.car[state, 1]
    ahead = c.cos_heading * dx + c.sin_heading * dy - c.front
    if ahead < 0.0:
        return BEHIND
    return BRAKED if ahead <= c.trigger else AHEAD


@kernel(inline=True)
def is_hopeful(f: Reachability, state: int, where: int, x: float, y: float) -> bool:
    """Tell whether there can still be a hit within the limit of the reachability bound."""
    first, count = f.hopeful[state, where, 0], f.hopeful[state, where, 1]
    if count == 0:
        return False
    for k in range(first, first + count):  # noqa: SIM110, numba has no generators
        if f.planes[k, 0] * x + f.planes[k, 1] * y > f.planes[k, 2]:
            return False
    return True


SURE = 1.0 + 1e-9
"""Margin of what is left out for being too far."""
MARGIN = 1e-9  # m, the same for lengths that may be 0


class ExactProblem(NamedTuple):
    """One episode; lengths in m, speeds in m/s, times in s."""

    path: FloatArray  # φ, n × 2
    noise: FloatArray  # ticks × 2: relative perturbation of speed and of acceleration
    fastest: FloatArray  # ticks + 1: greatest share of its speed that a car has at any time from tick t on
    car_x: float
    car_y: float
    car_speed: float
    cos_heading: float
    sin_heading: float
    front: float
    rear: float
    half_width: float
    radius: float
    trigger: float
    deceleration: float
    time_step: float
    adversary_speed: float
    path_edge: float
    minimum_impact_speed: float
    hit_speed: float


def make_problem(episode: EpisodeSpec) -> ExactProblem:
    """Return a kamikaze episode in numbers, the car's noise of every tick included."""
    scenario, world = episode.scenario, make_world(episode)
    car, adversary, ticks = scenario.car, scenario.adversary, scenario.ticks
    assert episode.safe_trajectory is not None
    # The world draws two numbers a tick, for the speed and for the acceleration, whatever happens.
    draws = generator(episode.seed, episode.episode_id, Role.CAR).random((ticks, 2))
    noise = (2.0 * draws - 1.0) * np.array([car.speed_noise, car.acceleration_noise])
    fastest = np.ones(ticks + 1)
    for tick in range(ticks - 1, -1, -1):
        fastest[tick] = max(1.0, (1.0 + noise[tick, 0]) * fastest[tick + 1])
    return ExactProblem(
        path=np.array(episode.safe_trajectory.positions, order="C"),
        noise=noise,
        fastest=fastest,
        car_x=world.car.x,
        car_y=world.car.y,
        car_speed=world.car.speed,
        cos_heading=math.cos(world.car.heading),
        sin_heading=math.sin(world.car.heading),
        front=car.front,
        rear=car.rear,
        half_width=car.half_width,
        radius=adversary.reach,
        trigger=episode.multiplier * car.safe_distance,
        deceleration=car.deceleration,
        time_step=scenario.time_step,
        adversary_speed=adversary.speed,
        path_edge=scenario.path_edge,
        minimum_impact_speed=scenario.collision.minimum_impact_speed,
        hit_speed=max(scenario.collision.hit_speed, scenario.collision.minimum_impact_speed),
    )


@kernel
def car_step(c: ExactProblem, speed: float, braking: bool, tick: int) -> tuple[float, float]:
    """Return how far the car comes in a tick (m) and its speed after it (m/s)."""
    acceleration = -c.deceleration if braking else 0.0
    applied = acceleration + c.noise[tick, 1] * acceleration
    after = next_speed(speed, applied, c.noise[tick, 0], c.time_step)
    return travelled(speed, after, c.time_step), after


@kernel(inline=True)
def place_of_phi(c: ExactProblem, tick: int) -> tuple[float, float]:
    """Return where φ is after `tick` ticks, m."""
    row = min(tick, c.path.shape[0] - 1)
    return c.path[row, 0], c.path[row, 1]
