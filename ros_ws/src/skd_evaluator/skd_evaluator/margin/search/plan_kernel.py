"""The trajectory of least deviation that hits in a surrogate model of the car: best first, near places merged.

A planned moment has the road user's place and velocity, the car's path coordinate, speed and last acceleration, and the
deviation so far. The surrogate says how the car goes on; its noise is the trial's own. Moments are taken in the order
of their deviation or, if that is more, of how far from φ at least the car can still be met. Cells in which moments
merge grow with the deviation: a tenth of it.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from skd_adversary.crossing.parts import within
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import is_straight_north, road_pose, road_position
from skd_sim.world.contact import first_contact, rectangle_distance, runs_into, sweep

from skd_evaluator.margin.search.surrogate import SITUATION, nearest_sample

NEAREST, CAUTIOUS, VARIED, BOLD = range(4)
"""How the surrogate is queried: by the nearest sample; by none beyond a radius, where the car goes on unbraked; by the
weights that tell most; by random weights and another radius, beyond which a given acceleration counts."""
COLUMNS: Final = 9
"""Numbers of a moment: x, y, velocity to the East and North, heading, path coordinate, speed and last acceleration of
the car, deviation."""
FAILURES: Final = 5
"""Numbers of a contact that was planned and was none: tick, x, y, path coordinate of the car, action."""


class PlanProblem(NamedTuple):
    """What is known of a trial beforehand.

    Attributes:
        phi: φ, n × 2, m.
        phi_road: the same as offset to the right and path coordinate, n × 2, m.
        velocities: velocities of the actions, ticks × actions × 2, m/s; nan: the same as that of another action.
        noise: relative noise of speed and acceleration, ticks × 2.
        unbraked: speed after so many ticks without a command, and distance until then, s, both per speed at first,
            (ticks + 1) × 2.
        line: centre line of the road.
        footprint: front, rear and half width of the car, m.
        shape: shape of the road user: radius, half length and half width, m.
        ticks: number of ticks of the episode.
        time_step: duration of a tick, s.
        fastest: greatest speed of the road user, m/s.
        loss: bounds of the region from which the road user cannot meet the car any more, m.
        least_impact: speed of the car from which on a touch ends the contact, m/s.
        hit_speed: speed of the car from which on a touch is a hit, m/s.
        within_ticks: whether the car decides more often than once a tick.
        obstacles: parked rectangles, as `Scenario.rectangles` returns them.
        core: radius of the road user's body where obstacles count, m.
    """

    phi: FloatArray
    phi_road: FloatArray
    velocities: FloatArray
    noise: FloatArray
    unbraked: FloatArray
    line: FloatArray
    footprint: tuple[float, float, float]
    shape: tuple[float, float, float]
    ticks: int
    time_step: float
    fastest: float
    loss: tuple[float, float, float, float]
    least_impact: float
    hit_speed: float
    within_ticks: bool
    obstacles: FloatArray
    core: float


class SurrogateQuery(NamedTuple):
    """How the surrogate is queried.

    Attributes:
        samples: samples of the controller in the order of their gaps, at least `count` × 7.
        known: how many of the samples count.
        weights: weights of a situation's 6 numbers.
        mode: how the surrogate is queried: one of NEAREST, CAUTIOUS, VARIED and BOLD.
        radius: distance, among samples, beyond which nothing is known.
        unknown: acceleration where nothing is known, m/s².
        hardest: strongest braking of which the car is believed capable, m/s², below 0.
        strongest: greatest acceleration of which the car is believed capable, m/s².
        cruise: speed above which it does not speed up, m/s.
    """

    samples: FloatArray
    known: int
    weights: FloatArray
    mode: int
    radius: float
    unknown: float
    hardest: float
    strongest: float
    cruise: float


class Room(NamedTuple):
    """Arrays to work in.

    Attributes:
        states: numbers of each planned moment, capacity × COLUMNS.
        bounds: bound of each entry, m; as long as the capacity.
        links: capacity × 4: tick, parent (before −1: −2 − number of the simulated moment), action, next of its bucket.
        keys: table of the cells.
        least: least deviation in each cell, m.
    """

    states: FloatArray
    bounds: FloatArray
    links: IntArray
    keys: npt.NDArray[np.uint64]
    least: FloatArray


def make_room(capacity: int) -> Room:
    """Return arrays for so many moments; their number is made a power of two."""
    size = 1 << (capacity - 1).bit_length()
    return Room(
        np.empty((size, COLUMNS)),
        np.empty(size),
        np.empty((size, 4), np.int64),
        np.zeros(2 * size, np.uint64),
        np.empty(2 * size),
    )


_X, _Y, _VX, _VY, _HEADING, _ALONG, _SPEED, _ACCELERATION, _DEVIATION = range(COLUMNS)
_FINEST = 0.02  # m, cell of places
_OF_DEVIATION = 0.1  # cell of places by deviation
_CAR_CELL, _SPEED_CELL = 0.25, 0.5  # m, m/s
_BRAKES = -0.5  # m/s²
_SAME_PLACE, _SAME_CAR = 0.03, 0.1  # m
_SLACK = 0.02  # m
_SPURT = 2.0  # m/s, by which a car may get faster in a tick


@kernel
def _predicted(view: SurrogateQuery, situation: FloatArray) -> float:
    row, away = nearest_sample(view.samples, view.known, view.weights, situation)
    if row < 0:
        return 0.0
    if (view.mode == CAUTIOUS or view.mode == BOLD) and away > view.radius:
        return view.unknown
    return float(view.samples[row, SITUATION])


@kernel
def _last_tick(problem: PlanProblem, bound: float) -> int:
    """Return the tick from which on φ is further from the strip that the car sweeps than a bound (m)."""
    radius = problem.shape[0] if problem.shape[0] > 0.0 else math.hypot(problem.shape[1], problem.shape[2])
    edge = problem.footprint[2] + radius + bound
    last = problem.phi_road.shape[0] - 1
    if abs(problem.phi_road[last, 0]) <= edge:
        return problem.ticks
    while last > 0 and abs(problem.phi_road[last, 0]) > edge:
        last -= 1
    return int(min(problem.ticks, last + 1))


@kernel
def _still(
    problem: PlanProblem,
    view: SurrogateQuery,
    tick: int,
    ticks: int,
    right: float,
    at: float,
    along: float,
    speed: float,
) -> float:
    """Return how far from φ, at least, the car can be met, wherever between full brake and none it is; or infinity.

    Args:
        problem: what is known of the trial beforehand.
        view: says what the car can do.
        tick: number of the tick that is now.
        ticks: the ticks in which φ is near enough.
        right: offset of the road user, m.
        at: path coordinate of the road user, m.
        along: path coordinate of the car, m.
        speed: speed of the car, m/s.
    """
    front, rear, half_width = problem.footprint
    radius, half_length, other_half_width = problem.shape
    if radius == 0.0:
        radius = math.hypot(half_length, other_half_width)
    last = problem.phi_road.shape[0] - 1
    least = math.inf
    standing_way = -0.5 * speed * speed / view.hardest
    standing_time = -speed / view.hardest
    most = max(speed, view.cruise)
    for later in range(tick, ticks):
        before = (later - tick) * problem.time_step
        after = before + problem.time_step
        rolled = (problem.unbraked[later + 1, 1] - problem.unbraked[tick, 1]) / problem.unbraked[tick, 0]
        furthest = along + min(speed + 0.5 * view.strongest * after, most) * rolled + front
        nearest = along + (
            standing_way if before >= standing_time else speed * before + 0.5 * view.hardest * before * before
        )
        nearest -= rear
        middle, half = 0.5 * (furthest + nearest), 0.5 * (furthest - nearest)
        there = rectangle_distance(at - middle, right, half, half, half_width) - radius
        if there > problem.fastest * after:
            continue
        for end in (min(later, last), min(later + 1, last)):
            ahead, across = problem.phi_road[end, 1] - middle, problem.phi_road[end, 0]
            away = rectangle_distance(ahead, across, half, half, half_width)
            least = min(least, away - radius)
        if least <= 0.0:
            return 0.0
    return max(0.0, least - _SLACK)


@kernel
def _contact(
    problem: PlanProblem, path: FloatArray, state: FloatArray, x: float, y: float, vx: float, vy: float, heading: float
) -> tuple[float, float]:
    """Return fraction of the tick and speed of the car at the contact; infinity: there is none."""
    front, rear, half_width = problem.footprint
    if problem.shape[0] > 0.0 and path[0, 2] == path[1, 2] and is_straight_north(problem.line):
        fraction = first_contact(
            state[_Y] - path[0, 1], -state[_X], y - path[1, 1], -x, front, rear, half_width, problem.shape[0]
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
        problem.footprint,
        problem.shape,
        problem.time_step,
        0,
        1,
    )


@kernel
def _reach(problem: PlanProblem, gap: float, right: float) -> float:
    """Return how far the road user is from touching the car, m, or less: by its place ahead and to the right."""
    front, rear, half_width = problem.footprint
    radius = problem.shape[0] if problem.shape[0] > 0.0 else math.hypot(problem.shape[1], problem.shape[2])
    return float(rectangle_distance(gap + front, right, front, rear, half_width)) - radius


@kernel
def _failed(failures: FloatArray, tick: int, x: float, y: float, along: float, action: int) -> bool:
    for row in range(failures.shape[0]):
        one = failures[row]
        if one[0] != tick or one[4] != action or abs(one[3] - along) > _SAME_CAR:
            continue
        if math.hypot(one[1] - x, one[2] - y) <= _SAME_PLACE:
            return True
    return False


@kernel
def _cell(problem: PlanProblem, tick: int, state: FloatArray, offsets: FloatArray, coarseness: float) -> np.uint64:
    """Return the cell of a moment as a number; two cells hardly ever have the same."""
    held = min(tick, problem.phi.shape[0] - 1)
    level = 0
    size = coarseness * _FINEST
    while size < coarseness * _OF_DEVIATION * state[_DEVIATION]:
        size *= 2.0
        level += 1
    coarse = max(coarseness * _CAR_CELL, size)
    key = np.uint64(tick * 64 + level)
    for value in (
        math.floor((state[_X] - problem.phi[held, 0]) / size + offsets[0]),
        math.floor((state[_Y] - problem.phi[held, 1]) / size + offsets[1]),
        math.floor(state[_ALONG] / coarse + offsets[2]),
        math.floor(state[_SPEED] / (coarseness * _SPEED_CELL) + offsets[3]),
        1 if state[_ACCELERATION] < _BRAKES else 0,
    ):
        key = (key ^ np.uint64(int(value) + 1048576)) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    return key | np.uint64(1)


@kernel
def _known(room: Room, key: np.uint64, deviation: float) -> bool:
    """Tell whether a cell was reached before with no more deviation; if not, remember this moment."""
    mask = room.keys.shape[0] - 1
    slot = int(key >> np.uint64(20)) & mask
    while room.keys[slot] != 0:
        if room.keys[slot] == key:
            if room.least[slot] <= deviation:
                return True
            room.least[slot] = deviation
            return False
        slot = (slot + 1) & mask
    room.keys[slot] = key
    room.least[slot] = deviation
    return False


@kernel
def plan(
    problem: PlanProblem,
    view: SurrogateQuery,
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
    actions: IntArray,
) -> tuple[float, int, int, int]:
    """Find the planned hit of least deviation.

    Args:
        problem: what is known of the trial beforehand.
        view: how the surrogate of the controller is queried.
        moments: the moments that were simulated, n × COLUMNS.
        ticks: the tick of each moment.
        tried: bits of the actions that were tried from each moment.
        failures: planned contacts that were none, m × FAILURES.
        bound: only hits with less deviation than this count, m.
        offsets: offsets of the cells, 4 numbers in [0, 1).
        coarseness: factor of the cells' size.
        buckets: number of buckets for moments, by their bounds. Within a bucket the moment that was found last goes
            first: with few buckets some plan is found soon, and the least one late.
        room: arrays to work in.
        most: greatest number of moments that may be planned.
        actions: receives the actions of the plan, one for each tick.

    Returns:
        Deviation (infinity: no plan), number of the simulated moment at which the plan begins, number of its actions,
        and of the moments that were planned.
    """
    heads = np.full(buckets, -1, np.int64)
    room.keys[:] = 0
    situation, path, state = np.empty(SITUATION), np.empty((2, 4)), np.empty(COLUMNS)
    straight = is_straight_north(problem.line)
    capacity = min(most, room.states.shape[0])
    least, winner, last_action = bound, -1, -1
    count = 0
    held = problem.phi.shape[0] - 1
    scale = buckets / bound
    ending = _last_tick(problem, bound)
    for number in range(moments.shape[0]):
        if moments[number, _DEVIATION] >= bound or count >= capacity:
            continue
        room.states[count] = moments[number]
        right, at = moments[number, _X], moments[number, _Y]
        if not straight:
            at, left = road_position(problem.line, right, at)
            right = -left
        along, speed = moments[number, _ALONG], moments[number, _SPEED]
        still = _still(problem, view, ticks[number], ending, right, at, along, speed)
        value = max(moments[number, _DEVIATION], still)
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
        x_car, y_car, heading = road_pose(problem.line, along)
        cos, sin = math.cos(heading), math.sin(heading)
        right, at = now[_X], now[_Y]
        if not straight:
            at, left = road_position(problem.line, right, at)
            right = -left
        situation[0] = at - along - problem.footprint[0]
        situation[1], situation[2], situation[3] = right, speed, now[_ACCELERATION]
        speed_noise, noise = problem.noise[tick, 0], problem.noise[tick, 1]
        path[0, 0], path[0, 1], path[0, 2], path[0, 3] = x_car, y_car, heading, speed
        acceleration = 0.0
        known = False
        near = _reach(problem, situation[0], right) <= problem.time_step * (1.2 * speed + problem.fastest + _SPURT)
        here, there = min(tick, held), min(tick + 1, held)
        for action in range(problem.velocities.shape[1]):
            vx, vy = problem.velocities[tick, action, 0], problem.velocities[tick, action, 1]
            if math.isnan(vx) or done >> action & 1:
                continue
            x, y = now[_X] + problem.time_step * vx, now[_Y] + problem.time_step * vy
            ex, ey = x - problem.phi[there, 0], y - problem.phi[there, 1]
            deviation = math.hypot(ex, ey)
            if not near and max(now[_DEVIATION], deviation) >= least:
                continue  # whatever the car does
            if problem.within_ticks or not known:
                east, north = (vx, vy) if problem.within_ticks else (now[_VX], now[_VY])
                if straight:
                    situation[4], situation[5] = east, north
                else:
                    situation[4], situation[5] = sin * east - cos * north, cos * east + sin * north
                acceleration, known = _predicted(view, situation), True
                after = max(0.0, speed + speed_noise * speed + problem.time_step * acceleration * (1.0 + noise))
                along_after = along + 0.5 * problem.time_step * (speed + after)
                if straight:
                    path[1, 0], path[1, 1], path[1, 2] = x_car, y_car + along_after - along, heading
                else:
                    path[1, 0], path[1, 1], path[1, 2] = road_pose(problem.line, along_after)
                path[1, 3] = after
            own_heading = now[_HEADING]
            if problem.shape[0] == 0.0 and (vx != 0.0 or vy != 0.0):
                own_heading = math.atan2(vy, vx)
            fraction, impact = _contact(problem, path, now, x, y, vx, vy, own_heading)
            if fraction <= 1.0 and impact >= problem.least_impact:
                if impact < problem.hit_speed:
                    continue
                ex0, ey0 = now[_X] - problem.phi[here, 0], now[_Y] - problem.phi[here, 1]
                away = math.hypot(ex0 + fraction * (ex - ex0), ey0 + fraction * (ey - ey0))
                reached = max(now[_DEVIATION], away)
                if reached < least and not _failed(failures, tick, now[_X], now[_Y], along, action):
                    least, winner, last_action = reached, node, action
                continue
            deviation = max(now[_DEVIATION], deviation)
            if deviation >= least or tick + 1 >= problem.ticks or count >= capacity:
                continue
            if speed <= 0.0 and after <= 0.0:
                continue  # it stands, and nothing that is seen makes it go on
            right, at = x, y
            if not straight:
                at, left = road_position(problem.line, x, y)
                right = -left
            if within(problem.loss, right, at) or runs_into(problem.obstacles, now[_X], now[_Y], x, y, problem.core):
                continue
            state[_X], state[_Y], state[_VX], state[_VY], state[_HEADING] = x, y, vx, vy, own_heading
            state[_ALONG], state[_SPEED], state[_ACCELERATION] = along_after, after, acceleration
            state[_DEVIATION] = deviation
            if _known(room, _cell(problem, tick + 1, state, offsets, coarseness), deviation):
                continue
            value = max(deviation, _still(problem, view, tick + 1, ending, right, at, along_after, after))
            if value >= least:
                continue
            value = max(value, room.bounds[node])
            room.states[count] = state
            room.bounds[count] = value
            room.links[count, 0], room.links[count, 1], room.links[count, 2] = tick + 1, node, action
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
    actions[length - 1] = last_action
    node = winner
    for index in range(length - 2, -1, -1):
        actions[index] = room.links[node, 2]
        node = room.links[node, 1]
    return least, begin, length, count
