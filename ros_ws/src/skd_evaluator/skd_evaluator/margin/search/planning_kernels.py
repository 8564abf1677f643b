"""The way of least deformation in a learned picture of the car: best first, places that are nearly the same merged.

A planned moment has the adversary's place and velocity, the car's path coordinate, speed and last acceleration, and how
far the adversary has strayed. The picture says how the car goes on; its noise is the episode's own. Moments are taken
in the order of what they have strayed or, if that is more, of how far from φ at least the car can still be met. Cells
in which moments merge grow with what was strayed: a tenth of it.
"""

from __future__ import annotations

import math

import numpy as np
from skd_adversary.model.crossing import within
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.encounter.road import is_straight_north, road_pose, road_position
from skd_sim.geometry.contact import first_contact, rectangle_distance, sweep
from skd_sim.geometry.obstruction import runs_into
from skd_sim.kernels.compilation import kernel

from skd_evaluator.margin.search.picture import SITUATION, nearest_sample
from skd_evaluator.margin.search.planning_parts import BOLD, CAUTIOUS, COLUMNS, Course, Room, View

_X, _Y, _VX, _VY, _HEADING, _ALONG, _SPEED, _ACCELERATION, _STRAYED = range(COLUMNS)
_FINEST = 0.02  # m, cell of places
_OF_STRAYED = 0.1  # cell of places by what was strayed
_CAR_CELL, _SPEED_CELL = 0.25, 0.5  # m, m/s
_BRAKES = -0.5  # m/s²
_SAME_PLACE, _SAME_CAR = 0.03, 0.1  # m
_SLACK = 0.02  # m
_SPURT = 2.0  # m/s, by which a car may get faster in a tick


@kernel
def _foreseen(view: View, situation: FloatArray) -> float:
    row, away = nearest_sample(view.samples, view.known, view.weights, situation)
    if row < 0:
        return 0.0
    if (view.mode == CAUTIOUS or view.mode == BOLD) and away > view.radius:
        return view.unknown
    return float(view.samples[row, SITUATION])


@kernel
def _last_tick(course: Course, bound: float) -> int:
    """Return the tick from which on φ is further from the strip that the car sweeps than a bound (m)."""
    radius = course.shape[0] if course.shape[0] > 0.0 else math.hypot(course.shape[1], course.shape[2])
    edge = course.footprint[2] + radius + bound
    last = course.phi_road.shape[0] - 1
    if abs(course.phi_road[last, 0]) <= edge:
        return course.ticks
    while last > 0 and abs(course.phi_road[last, 0]) > edge:
        last -= 1
    return int(min(course.ticks, last + 1))


@kernel
def _still(
    course: Course, view: View, tick: int, ticks: int, right: float, at: float, along: float, speed: float
) -> float:
    """Return how far from φ, at least, the car can be met, wherever between full brake and none it is; or infinity.

    Args:
        course: what is known of the attempt beforehand.
        view: says what the car can do.
        tick: number of the tick that is now.
        ticks: the ticks in which φ is near enough.
        right: offset of the adversary, m.
        at: path coordinate of the adversary, m.
        along: path coordinate of the car, m.
        speed: speed of the car, m/s.
    """
    front, rear, half_width = course.footprint
    radius, half_length, other_half_width = course.shape
    if radius == 0.0:
        radius = math.hypot(half_length, other_half_width)
    last = course.phi_road.shape[0] - 1
    least = math.inf
    standing_way = -0.5 * speed * speed / view.hardest
    standing_time = -speed / view.hardest
    most = max(speed, view.cruise)
    for later in range(tick, ticks):
        before = (later - tick) * course.time_step
        after = before + course.time_step
        rolled = (course.unbraked[later + 1, 1] - course.unbraked[tick, 1]) / course.unbraked[tick, 0]
        furthest = along + min(speed + 0.5 * view.strongest * after, most) * rolled + front
        nearest = along + (
            standing_way if before >= standing_time else speed * before + 0.5 * view.hardest * before * before
        )
        nearest -= rear
        middle, half = 0.5 * (furthest + nearest), 0.5 * (furthest - nearest)
        there = rectangle_distance(at - middle, right, half, half, half_width) - radius
        if there > course.fastest * after:
            continue
        for end in (min(later, last), min(later + 1, last)):
            away = rectangle_distance(course.phi_road[end, 1] - middle, course.phi_road[end, 0], half, half, half_width)
            least = min(least, away - radius)
        if least <= 0.0:
            return 0.0
    return max(0.0, least - _SLACK)


@kernel
def _contact(
    course: Course, path: FloatArray, state: FloatArray, x: float, y: float, vx: float, vy: float, heading: float
) -> tuple[float, float]:
    """Return fraction of the tick and speed of the car at the contact; infinity: there is none."""
    front, rear, half_width = course.footprint
    if course.shape[0] > 0.0 and path[0, 2] == path[1, 2] and is_straight_north(course.line):
        fraction = first_contact(
            state[_Y] - path[0, 1], -state[_X], y - path[1, 1], -x, front, rear, half_width, course.shape[0]
        )
        if fraction > 1.0:
            return math.inf, 0.0
        return fraction, path[0, 3] + fraction * (path[1, 3] - path[0, 3])
    return sweep(
        path,
        (state[_X], state[_Y]),
        (x, y),
        (vx, vy),
        heading,
        course.footprint,
        course.shape,
        course.time_step,
        0,
        1,
    )


@kernel
def _reach(course: Course, gap: float, right: float) -> float:
    """Return how far the adversary is from touching the car, m, or less: by its place ahead and to the right."""
    front, rear, half_width = course.footprint
    radius = course.shape[0] if course.shape[0] > 0.0 else math.hypot(course.shape[1], course.shape[2])
    return float(rectangle_distance(gap + front, right, front, rear, half_width)) - radius


@kernel
def _failed(failures: FloatArray, tick: int, x: float, y: float, along: float, way: int) -> bool:
    for row in range(failures.shape[0]):
        one = failures[row]
        if one[0] != tick or one[4] != way or abs(one[3] - along) > _SAME_CAR:
            continue
        if math.hypot(one[1] - x, one[2] - y) <= _SAME_PLACE:
            return True
    return False


@kernel
def _cell(course: Course, tick: int, state: FloatArray, offsets: FloatArray, coarseness: float) -> np.uint64:
    """Return the cell of a moment as a number; two cells hardly ever have the same."""
    held = min(tick, course.phi.shape[0] - 1)
    level = 0
    size = coarseness * _FINEST
    while size < coarseness * _OF_STRAYED * state[_STRAYED]:
        size *= 2.0
        level += 1
    coarse = max(coarseness * _CAR_CELL, size)
    key = np.uint64(tick * 64 + level)
    for value in (
        math.floor((state[_X] - course.phi[held, 0]) / size + offsets[0]),
        math.floor((state[_Y] - course.phi[held, 1]) / size + offsets[1]),
        math.floor(state[_ALONG] / coarse + offsets[2]),
        math.floor(state[_SPEED] / (coarseness * _SPEED_CELL) + offsets[3]),
        1 if state[_ACCELERATION] < _BRAKES else 0,
    ):
        key = (key ^ np.uint64(int(value) + 1048576)) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    return key | np.uint64(1)


@kernel
def _known(room: Room, key: np.uint64, strayed: float) -> bool:
    """Tell whether a cell was reached before with no more deformation; if not, remember this moment."""
    mask = room.keys.shape[0] - 1
    slot = int(key >> np.uint64(20)) & mask
    while room.keys[slot] != 0:
        if room.keys[slot] == key:
            if room.least[slot] <= strayed:
                return True
            room.least[slot] = strayed
            return False
        slot = (slot + 1) & mask
    room.keys[slot] = key
    room.least[slot] = strayed
    return False


@kernel
def plan(
    course: Course,
    view: View,
    moments: FloatArray,
    ticks: IntArray,
    tried: IntArray,
    failures: FloatArray,
    bound: float,
    offsets: FloatArray,
    coarseness: float,
    buckets: int,
    room: Room,
    most: int,
    ways: IntArray,
    foreseen: FloatArray,
) -> tuple[float, int, int, int]:
    """Find the planned hit of least deformation.

    Args:
        course: what is known of the attempt beforehand.
        view: how the learned picture of the controller is asked.
        moments: the moments that were simulated, n × COLUMNS.
        ticks: the tick of each moment.
        tried: bits of the ways that were tried from each moment.
        failures: planned contacts that were none, m × FAILURES.
        bound: only hits with less deformation than this count, m.
        offsets: offsets of the cells, 4 numbers in [0, 1).
        coarseness: factor of the cells' size.
        buckets: number of buckets for moments, by their bounds. Within a bucket the moment that was found last goes
            first: with few buckets some plan is found soon, and the least one late.
        room: arrays to work in.
        most: greatest number of moments that may be planned.
        ways: receives the ways of the plan, one for each tick.
        foreseen: receives path coordinate and speed of the car after each of them.

    Returns:
        Deformation (infinity: no plan), number of the simulated moment at which the plan begins, number of its ways,
        and of the moments that were planned.
    """
    heads = np.full(buckets, -1, np.int64)
    room.keys[:] = 0
    situation, path, state = np.empty(SITUATION), np.empty((2, 4)), np.empty(COLUMNS)
    straight = is_straight_north(course.line)
    capacity = min(most, room.states.shape[0])
    least, winner, last_way = bound, -1, -1
    count = 0
    held = course.phi.shape[0] - 1
    scale = buckets / bound
    ending = _last_tick(course, bound)
    for number in range(moments.shape[0]):
        if moments[number, _STRAYED] >= bound or count >= capacity:
            continue
        room.states[count] = moments[number]
        right, at = moments[number, _X], moments[number, _Y]
        if not straight:
            at, left = road_position(course.line, right, at)
            right = -left
        still = _still(course, view, ticks[number], ending, right, at, moments[number, _ALONG], moments[number, _SPEED])
        value = max(moments[number, _STRAYED], still)
        if value >= bound:
            continue
        bucket = min(buckets - 1, int(value * scale))
        room.bounds[count] = value
        room.links[count, 0], room.links[count, 1], room.links[count, 2] = ticks[number], -2 - number, -1
        room.links[count, 3] = heads[bucket]
        heads[bucket] = count
        count += 1
    at_bucket = 0
    while at_bucket < buckets:
        node = heads[at_bucket]
        if node < 0:
            at_bucket += 1
            continue
        heads[at_bucket] = room.links[node, 3]
        if room.bounds[node] >= least:
            continue
        now = room.states[node]
        tick = room.links[node, 0]
        done = tried[-2 - room.links[node, 1]] if room.links[node, 1] < -1 else 0
        speed, along = now[_SPEED], now[_ALONG]
        x_car, y_car, heading = road_pose(course.line, along)
        cos, sin = math.cos(heading), math.sin(heading)
        right, at = now[_X], now[_Y]
        if not straight:
            at, left = road_position(course.line, right, at)
            right = -left
        situation[0] = at - along - course.footprint[0]
        situation[1], situation[2], situation[3] = right, speed, now[_ACCELERATION]
        speed_noise, noise = course.noise[tick, 0], course.noise[tick, 1]
        path[0, 0], path[0, 1], path[0, 2], path[0, 3] = x_car, y_car, heading, speed
        acceleration = 0.0
        asked = False
        near = _reach(course, situation[0], right) <= course.time_step * (1.2 * speed + course.fastest + _SPURT)
        here, there = min(tick, held), min(tick + 1, held)
        for way in range(course.velocities.shape[1]):
            vx, vy = course.velocities[tick, way, 0], course.velocities[tick, way, 1]
            if math.isnan(vx) or done >> way & 1:
                continue
            x, y = now[_X] + course.time_step * vx, now[_Y] + course.time_step * vy
            ex, ey = x - course.phi[there, 0], y - course.phi[there, 1]
            strayed = math.hypot(ex, ey)
            if not near and max(now[_STRAYED], strayed) >= least:
                continue  # whatever the car does
            if course.within_ticks or not asked:
                east, north = (vx, vy) if course.within_ticks else (now[_VX], now[_VY])
                if straight:
                    situation[4], situation[5] = east, north
                else:
                    situation[4], situation[5] = sin * east - cos * north, cos * east + sin * north
                acceleration, asked = _foreseen(view, situation), True
                after = max(0.0, speed + speed_noise * speed + course.time_step * acceleration * (1.0 + noise))
                along_after = along + 0.5 * course.time_step * (speed + after)
                if straight:
                    path[1, 0], path[1, 1], path[1, 2] = x_car, y_car + along_after - along, heading
                else:
                    path[1, 0], path[1, 1], path[1, 2] = road_pose(course.line, along_after)
                path[1, 3] = after
            own_heading = now[_HEADING]
            if course.shape[0] == 0.0 and (vx != 0.0 or vy != 0.0):
                own_heading = math.atan2(vy, vx)
            fraction, impact = _contact(course, path, now, x, y, vx, vy, own_heading)
            if fraction <= 1.0 and impact >= course.least_impact:
                if impact < course.hit_speed:
                    continue
                ex0, ey0 = now[_X] - course.phi[here, 0], now[_Y] - course.phi[here, 1]
                away = math.hypot(ex0 + fraction * (ex - ex0), ey0 + fraction * (ey - ey0))
                reached = max(now[_STRAYED], away)
                if reached < least and not _failed(failures, tick, now[_X], now[_Y], along, way):
                    least, winner, last_way = reached, node, way
                continue
            strayed = max(now[_STRAYED], strayed)
            if strayed >= least or tick + 1 >= course.ticks or count >= capacity:
                continue
            if speed <= 0.0 and after <= 0.0:
                continue  # it stands, and nothing that is seen makes it go on
            right, at = x, y
            if not straight:
                at, left = road_position(course.line, x, y)
                right = -left
            if within(course.loss, right, at) or runs_into(course.obstacles, now[_X], now[_Y], x, y, course.core):
                continue
            state[_X], state[_Y], state[_VX], state[_VY], state[_HEADING] = x, y, vx, vy, own_heading
            state[_ALONG], state[_SPEED], state[_ACCELERATION] = along_after, after, acceleration
            state[_STRAYED] = strayed
            if _known(room, _cell(course, tick + 1, state, offsets, coarseness), strayed):
                continue
            value = max(strayed, _still(course, view, tick + 1, ending, right, at, along_after, after))
            if value >= least:
                continue
            value = max(value, room.bounds[node])
            room.states[count] = state
            room.bounds[count] = value
            room.links[count, 0], room.links[count, 1], room.links[count, 2] = tick + 1, node, way
            bucket = min(buckets - 1, int(value * scale))
            room.links[count, 3] = heads[bucket]
            heads[bucket] = count
            count += 1
    if winner < 0:
        return math.inf, -1, 0, count
    length, node = 1, winner
    while room.links[node, 1] >= 0:
        length, node = length + 1, room.links[node, 1]
    begin = -2 - room.links[node, 1]
    ways[length - 1], foreseen[length - 1, 0], foreseen[length - 1, 1] = last_way, math.nan, math.nan
    node = winner
    for index in range(length - 2, -1, -1):
        ways[index] = room.links[node, 2]
        foreseen[index, 0], foreseen[index, 1] = room.states[node, _ALONG], room.states[node, _SPEED]
        node = room.links[node, 1]
    return least, begin, length, count
