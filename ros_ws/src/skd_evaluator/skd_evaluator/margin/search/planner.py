"""Plans of a trial: detours from what was driven by which the road user is hit, if the car drives as its surrogate.

A plan leaves a trajectory that was driven at any tick. Up to there the car is where it was; from there on the surrogate
says how it goes on, with the trial's own noise. Ticks are gone through in order, and of moments that are nearly alike
the one of least deviation is kept.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import is_straight_north, right_and_along, road_pose, road_position
from skd_sim.world.contact import rectangle_distance, sweep
from skd_sim.world.dynamics.basic import make_dynamics
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Outcome, Role, generator

from skd_evaluator.margin.search.candidates import ActionSpace
from skd_evaluator.margin.search.surrogate import RADIUS, SITUATION, WEIGHTS, Surrogate, nearest_sample

MOMENTS_A_DRIVE: Final = 300, 60
"""Planned moments that take as long as to drive a candidate, of a car that decides once a tick, or more often."""
_X, _Y, _EAST, _NORTH, _ALONG, _SPEED, _ACCELERATION, _DEVIATION = range(8)
_CAPACITY: Final = 1 << 13  # moments
_SLOTS: Final = 1 << 15
_CELL, _LEAST_CELL = 0.08, 0.02  # of places: of the bound, and m
_CAR_CELL, _SPEED_CELL = 0.5, 0.5  # m, m/s


class PlanProblem(NamedTuple):
    """What is known of a trial beforehand.

    Attributes:
        phi: φ at ticks, m.
        table: velocities of the actions, ticks × actions × 2, m/s.
        noise: relative noise of the car's speed and acceleration, ticks × 2.
        line: centre line of the road.
        footprint: front, rear and half width of the car, m.
        shape: shape of the road user: radius, half length and half width, m.
        time_step: duration of a tick, s.
        hit_speed: speed of the car from which on a touch is a hit, m/s.
        within_ticks: whether the car decides more often than once a tick.
    """

    phi: FloatArray
    table: FloatArray
    noise: FloatArray
    line: FloatArray
    footprint: tuple[float, float, float]
    shape: tuple[float, float, float]
    time_step: float
    hit_speed: float
    within_ticks: bool


class DetourPlanner:
    """Plans for one trial."""

    def __init__(self, episode: EpisodeSpec, space: ActionSpace, surrogate: Surrogate) -> None:
        """Draw the car's noise; all trials of a φ may share a surrogate."""
        assert space.table is not None
        scenario, self._surrogate = episode.scenario, surrogate
        dynamics, rng = make_dynamics(scenario), generator(episode.seed, episode.episode_id, Role.CAR)
        car = scenario.car
        self._problem = PlanProblem(
            space.phi,
            space.table,
            np.array([dynamics.draw(rng) for _ in range(scenario.ticks)]),
            scenario.road.line,
            (car.front, car.rear, car.half_width),
            scenario.adversary.shape,
            scenario.time_step,
            scenario.collision.hit_speed,
            scenario.control_periods > 1,
        )

    def moments(self, log: EpisodeLog) -> FloatArray:
        """Return what was driven, (ticks + 1) × 8.

        These are place and last velocity of the road user, path coordinate, speed and last acceleration of the car, and
        the deviation so far.
        """
        problem, count = self._problem, len(log.adversary)
        step, noise = problem.time_step, problem.noise[: count - 1]
        along, speeds = log.car[:, 1], log.car[:, 3]
        if not log.episode.scenario.road.straight:
            along = np.array([road_position(problem.line, x, y)[0] for x, y in log.car[:, :2].tolist()])
        seen = (speeds[1:] - speeds[:-1] * (1.0 + noise[:, 0])) / (step * (1.0 + noise[:, 1]))
        before = np.concatenate([[0.0], seen])
        before[1:][speeds[1:] <= 0.0] = np.minimum(before[1:], before[:-1])[speeds[1:] <= 0.0]  # it stands: at least so
        moved = np.concatenate([np.zeros((1, 2)), np.diff(log.adversary, axis=0) / step])
        away = log.adversary - problem.phi[:count]
        deviations = np.maximum.accumulate(np.hypot(away[:, 0], away[:, 1]))
        return np.column_stack([log.adversary, moved, along, speeds, before, deviations])

    def learn(self, log: EpisodeLog, moments: FloatArray) -> None:
        """Have the surrogate learn from what was driven."""
        problem, here = self._problem, moments[:-1]
        place, velocity = here[:, _X : _Y + 1], (moments[1:] if problem.within_ticks else here)[:, _EAST : _NORTH + 1]
        if not log.episode.scenario.road.straight:
            place = right_and_along(problem.line, place)
            heading = log.car[:-1, 2]
            cos, sin, (east, north) = np.cos(heading), np.sin(heading), velocity.T
            velocity = np.column_stack([sin * east - cos * north, cos * east + sin * north])
        gaps = place[:, 1] - here[:, _ALONG] - problem.footprint[0]
        known = np.column_stack([gaps, place[:, 0], here[:, _SPEED], here[:, _ACCELERATION], velocity])
        ticks = len(known) - (log.outcome == Outcome.COLLISION)
        self._surrogate.learn(
            np.ascontiguousarray(known[:ticks]), np.ascontiguousarray(moments[1:, _ACCELERATION][:ticks])
        )

    def plan(
        self, actions: IntArray, moments: FloatArray, bound: float, steps: int, rng: np.random.Generator
    ) -> tuple[IntArray | None, float]:
        """Return the detour of least deviation that is hit, None where there is none, and what it cost, in drives.

        Args:
            actions: what was driven.
            moments: what was seen then.
            bound: only hits with less deviation count, m.
            steps: ticks, at most, from leaving the trajectory to the hit.
            rng: draws how the surrogate is queried, and moments are merged.
        """
        surrogate, found = self._surrogate, actions.copy()
        weights, offsets = np.array(WEIGHTS), np.zeros(4)
        if steps > 1:
            offsets = rng.random(4)
            if rng.random() < 0.5:
                weights = surrogate.telling_weights(rng)
        contact, planned = plan_detour(
            self._problem, surrogate.rows, surrogate.count, weights, moments, bound, steps, offsets, found
        )
        return (found if contact >= 0 else None), planned / MOMENTS_A_DRIVE[self._problem.within_ticks]


@kernel
def plan_detour(
    problem: PlanProblem,
    samples: FloatArray,
    known: int,
    weights: FloatArray,
    moments: FloatArray,
    bound: float,
    steps: int,
    offsets: FloatArray,
    actions: IntArray,
) -> tuple[int, int]:
    """Plan the detour of least deviation that is hit; `actions` of the trajectory become those of the detour.

    Returns:
        The tick of the hit, −1 where there is none, and how many moments were planned.
    """
    front, rear, half_width = problem.footprint
    reach = problem.shape[0] if problem.shape[0] > 0.0 else math.hypot(problem.shape[1], problem.shape[2])
    step, straight, ticks = problem.time_step, is_straight_north(problem.line), problem.table.shape[0]
    cell = max(_LEAST_CELL, _CELL * bound)
    capacity = _CAPACITY if steps > 1 else moments.shape[0]
    slots = np.full(_SLOTS if steps > 1 else 1, -1, np.int64)
    states, links = np.empty((capacity, 8)), np.empty((capacity, 4), np.int64)  # parent, action, steps left, slot
    situation, path = np.empty(SITUATION), np.empty((2, 4))
    least, winner, contact, last_action = bound, -1, -1, -1
    begin = count = 0
    for tick in range(ticks):
        if tick < moments.shape[0] - 1 and moments[tick, _DEVIATION] < least and count < capacity:
            states[count] = moments[tick]
            links[count, 0], links[count, 2], links[count, 3] = -1, steps, -1
            count += 1
        end = count
        if begin == end:
            break
        for node in range(begin, end):
            now = states[node]
            if now[_DEVIATION] >= least:
                continue
            driven = links[node, 0] < 0
            speed, along, x, y = now[_SPEED], now[_ALONG], now[_X], now[_Y]
            path[0, 0], path[0, 1], path[0, 2] = road_pose(problem.line, along)
            path[0, 3] = speed
            cos, sin = math.cos(path[0, 2]), math.sin(path[0, 2])
            at, right = y, x
            if not straight:
                at, left = road_position(problem.line, x, y)
                right = -left
            situation[0], situation[1], situation[2], situation[3] = (
                at - along - front,
                right,
                speed,
                now[_ACCELERATION],
            )
            gap = rectangle_distance(at - along, right, front, rear, half_width) - reach
            east, north = x - problem.phi[tick, 0], y - problem.phi[tick, 1]
            known_yet = False
            for action in range(problem.table.shape[1]):
                vx, vy = problem.table[tick, action, 0], problem.table[tick, action, 1]
                x_after, y_after = x + step * vx, y + step * vy
                east_after, north_after = x_after - problem.phi[tick + 1, 0], y_after - problem.phi[tick + 1, 1]
                deviation = max(now[_DEVIATION], math.hypot(east_after, north_after))
                near = gap <= 1.2 * step * (speed + 2.0 + math.hypot(vx, vy))
                if not near and (deviation >= least or links[node, 2] <= 1):
                    continue
                if problem.within_ticks or not known_yet:
                    known_yet = True
                    if driven and (steps == 1 or not problem.within_ticks):
                        acceleration, along_after = moments[tick + 1, _ACCELERATION], moments[tick + 1, _ALONG]
                        after = moments[tick + 1, _SPEED]
                    else:
                        v_east, v_north = (vx, vy) if problem.within_ticks else (now[_EAST], now[_NORTH])
                        situation[4], situation[5] = sin * v_east - cos * v_north, cos * v_east + sin * v_north
                        row, unlike = nearest_sample(samples, known, weights, situation)
                        acceleration = 0.0 if row < 0 or unlike > RADIUS else samples[row, SITUATION]
                        faster = problem.noise[tick, 0] * speed + step * acceleration * (1.0 + problem.noise[tick, 1])
                        after = max(0.0, speed + faster)
                        along_after = along + 0.5 * step * (speed + after)
                    path[1, 0], path[1, 1], path[1, 2] = road_pose(problem.line, along_after)
                    path[1, 3] = after
                if near:
                    heading, ends = math.atan2(vy, vx), (x_after, y_after)
                    fraction, impact = sweep(
                        path, (x, y), ends, (vx, vy), heading, problem.footprint, problem.shape, step, 0, 1
                    )
                    if fraction <= 1.0:
                        e, n = east + fraction * (east_after - east), north + fraction * (north_after - north)
                        reached = max(now[_DEVIATION], math.hypot(e, n))
                        if impact >= problem.hit_speed and reached < least:
                            least, winner, contact, last_action = reached, node, tick, action
                        continue
                stands = speed <= 0.0 and after <= 0.0
                if stands or deviation >= least or links[node, 2] <= 1 or (driven and action == actions[tick]):
                    continue
                key = np.uint64(1)
                for value in (
                    math.floor(east_after / cell + offsets[0]),
                    math.floor(north_after / cell + offsets[1]),
                    math.floor(along_after / _CAR_CELL + offsets[2]),
                    math.floor(after / _SPEED_CELL + offsets[3]),
                ):
                    key = (key ^ np.uint64(int(value) + 1048576)) * np.uint64(0x9E3779B97F4A7C15)
                    key ^= key >> np.uint64(29)
                slot = int(key >> np.uint64(20)) & (_SLOTS - 1)
                other = slots[slot]
                if other < 0:
                    if count == capacity:
                        continue
                    other = slots[slot] = count
                    count += 1
                elif states[other, _DEVIATION] <= deviation:
                    continue
                child = states[other]
                child[_X], child[_Y], child[_EAST], child[_NORTH] = x_after, y_after, vx, vy
                child[_ALONG], child[_SPEED], child[_ACCELERATION] = along_after, after, acceleration
                child[_DEVIATION] = deviation
                links[other, 0], links[other, 1], links[other, 2], links[other, 3] = (
                    node,
                    action,
                    links[node, 2] - 1,
                    slot,
                )
        for node in range(end, count):
            slots[links[node, 3]] = -1
        begin = end
    if winner < 0:
        return -1, count
    tick = contact
    actions[tick] = last_action
    while links[winner, 0] >= 0:
        tick -= 1
        actions[tick] = links[winner, 1]
        winner = links[winner, 0]
    return contact, count
