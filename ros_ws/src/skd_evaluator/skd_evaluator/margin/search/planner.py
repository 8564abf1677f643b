"""Plans of a trial: the hit of least deviation in the surrogate model of the controller."""

from __future__ import annotations

import functools
import math
from typing import Final

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.scenario.road import right_and_along, road_pose, road_position
from skd_sim.world.dynamics.basic import make_dynamics
from skd_sim.world.episode import EpisodeLog, Outcome, Role, generator

from skd_evaluator.margin.actions import FIRST_HALF
from skd_evaluator.margin.search import plan_kernel
from skd_evaluator.margin.search.plan_kernel import (
    BOLD,
    CAUTIOUS,
    COLUMNS,
    FAILURES,
    VARIED,
    PlanProblem,
    Room,
    SurrogateQuery,
    make_room,
)
from skd_evaluator.margin.search.surrogate import RADIUS, SITUATION, WEIGHTS, Surrogate
from skd_evaluator.margin.search.trial import ActionSpace, Candidate, Trial

MODES: Final = 4
ROOM: Final = 1 << 14, 1 << 12
_LITTLE_ROOM = 1 << 12, 1 << 11
MOMENTS_A_DRIVE: Final = 300, 60
"""Planned moments that take as long as to drive a candidate, of a car that decides once a tick, or more often."""
_LESS = 1e-3
_COARSER, _COARSEST, _FINEST = 1.5, 3.0, 0.5
_BUCKETS, _FEW_BUCKETS = 128, 6
_LEAST_RADIUS = 0.25
_VARIATION = 0.5


@functools.cache
def _room(size: int) -> Room:
    return make_room(size)


class TrialPlanner:
    """Plans for one trial, from the moments that its candidates went through."""

    def __init__(self, trial: Trial, surrogate: Surrogate) -> None:
        self._trial, self._surrogate = trial, surrogate
        episode = trial.episode
        scenario = self._scenario = episode.scenario
        self.within = scenario.control_periods > 1
        dynamics, rng = make_dynamics(scenario), generator(episode.seed, episode.episode_id, Role.CAR)
        self.noise = np.array([dynamics.draw(rng) for _ in range(scenario.ticks + 1)])
        self._problems = _problems(trial.space, self.noise, self.within)
        self._turns, self._mode, self._radius = 0, MODES - 1, RADIUS
        self._coarseness, self._greedy, self._most = 1.0, False, _LITTLE_ROOM[self.within]
        self._moves = np.empty(scenario.ticks + 1, np.int64)
        self._failures: list[tuple[float, ...]] = []
        self._index: dict[bytes, int] = {}
        self._rows = np.empty((0, COLUMNS))
        self._ticks: list[int] = []
        self._tried: list[int] = []
        self._prefixes: list[IntArray] = []

    def observe(
        self, candidate: Candidate, log: EpisodeLog, *, remember: bool, planned: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Return what a drive shows of the controller: situations, n × 6, and accelerations, m/s².

        Args:
            candidate: what was driven.
            log: what happened.
            remember: whether later plans may begin at the moments that it went through.
            planned: whether it was a plan: one that did not hit is not planned again.
        """
        situations, accelerations, car = self._states(log)
        if remember:
            self._remember(candidate, log, car)
        if planned and not log.hit:
            last = len(log.adversary) - 2
            x, y = candidate.positions[last]
            self._failures.append((last, x, y, car[last, 0], int(candidate.actions[last])))
        return situations, accelerations

    def _states(self, log: EpisodeLog) -> tuple[FloatArray, FloatArray, FloatArray]:
        scenario = self._scenario
        step, line = scenario.time_step, scenario.road.line
        ticks = len(log.adversary) - 1
        velocity = np.diff(log.adversary, axis=0) / step
        speeds = log.car[:, 3]
        noise = self.noise[:ticks]
        seen = (speeds[1:] - speeds[:-1] * (1.0 + noise[:, 0])) / (step * (1.0 + noise[:, 1]))
        before = np.concatenate([[0.0], seen])
        for tick in range(ticks):
            if speeds[tick + 1] <= 0.0:
                seen[tick] = before[tick + 1] = min(seen[tick], before[tick])
        if scenario.road.straight:
            place, along, moved = log.adversary, log.car[:, 1], velocity
        else:
            place = right_and_along(line, log.adversary)
            along = np.array([road_position(line, x, y)[0] for x, y in log.car[:, :2].tolist()])
            heading = np.array([road_pose(line, one)[2] for one in along[:-1].tolist()])
            cos, sin = np.cos(heading), np.sin(heading)
            moved = np.column_stack(
                [sin * velocity[:, 0] - cos * velocity[:, 1], cos * velocity[:, 0] + sin * velocity[:, 1]]
            )
        if not self.within:
            moved = np.concatenate([np.zeros((1, 2)), moved[:-1]])
        gaps = place[:, 1] - along - scenario.car.front
        situations = np.column_stack([gaps[:-1], place[:-1, 0], speeds[:-1], before[:-1], moved])
        if log.outcome == Outcome.COLLISION:
            situations, seen = situations[:-1], seen[:-1]
        return np.ascontiguousarray(situations), np.ascontiguousarray(seen), np.column_stack([along, speeds, before])

    def _remember(self, candidate: Candidate, log: EpisodeLog, car: FloatArray) -> None:
        actions, positions = candidate.actions, candidate.positions
        rows = []
        for tick in range(len(log.adversary) - 1):
            key = actions[:tick].tobytes()
            number = self._index.get(key)
            if number is None:
                number = self._index[key] = len(self._ticks)
                x, y = positions[tick]
                vx, vy = (positions[tick] - positions[tick - 1]) / self._scenario.time_step if tick else (0.0, 0.0)
                rows.append((x, y, vx, vy, 0.0, *car[tick], candidate.deviations[tick]))
                self._ticks.append(tick)
                self._tried.append(0)
                self._prefixes.append(actions[:tick])
            self._tried[number] |= 1 << int(actions[tick])
        if rows:
            self._rows = np.concatenate([self._rows, np.array(rows)])

    def plan(self, rng: np.random.Generator) -> tuple[IntArray | None, float]:
        """Return the next plan, actions up to the contact, None where there is none, and what it cost, in drives."""
        self._mode = (self._mode + 1) % MODES
        self._turns += 1
        self._forget()
        most = self._most
        _, begin, length, planned = plan_kernel.plan(
            self._problems[self._turns // MODES % 2],
            self._view(rng),
            self._rows,
            np.array(self._ticks, np.int64),
            np.array(self._tried, np.int64),
            np.array(self._failures).reshape(-1, FAILURES),
            self._trial.least * (1.0 - _LESS),
            rng.random(4),
            self._coarseness,
            _FEW_BUCKETS if self._greedy else _BUCKETS,
            _room(ROOM[self.within]),
            most,
            self._moves,
        )
        full = planned >= most
        self._greedy = full and begin < 0 and not self._greedy
        if full and begin < 0:
            self._most = min(ROOM[self.within], 2 * self._most)
        elif not full:
            self._most = max(_LITTLE_ROOM[self.within], self._most // 2)
        if full:
            self._coarseness = min(_COARSEST, self._coarseness * _COARSER)
        elif begin < 0:
            self._coarseness = max(_FINEST, self._coarseness / _COARSER)
        cost = planned / MOMENTS_A_DRIVE[self.within]
        if begin < 0:
            if self._mode == CAUTIOUS:
                self._radius = max(_LEAST_RADIUS, 0.7 * self._radius)
            return None, cost
        return np.concatenate([self._prefixes[begin], self._moves[:length]]), cost

    def _forget(self) -> None:
        every = (1 << self._problems[0].velocities.shape[1]) - 1
        least = self._trial.least
        keep = [i for i in range(len(self._ticks)) if self._rows[i, -1] < least and self._tried[i] != every]
        if 2 * len(keep) < len(self._ticks):
            self._rows = self._rows[keep]
            self._ticks = [self._ticks[i] for i in keep]
            self._tried = [self._tried[i] for i in keep]
            self._prefixes = [self._prefixes[i] for i in keep]
            self._index = {one.tobytes(): i for i, one in enumerate(self._prefixes)}

    def _view(self, rng: np.random.Generator) -> SurrogateQuery:
        weights, radius, unknown = np.array(WEIGHTS), self._radius, 0.0
        surrogate = self._surrogate
        if self._mode == VARIED:
            weights = surrogate.telling_weights(rng)
        if self._mode == BOLD:
            weights *= np.exp(_VARIATION * rng.standard_normal(SITUATION))
            radius *= math.exp(_VARIATION * rng.standard_normal())
            if rng.random() < 0.5 and surrogate.count:
                unknown = float(surrogate.rows[int(rng.integers(surrogate.count)), -1])
        hardest, strongest = surrogate.range()
        cruise = self._scenario.car.start_speed
        return SurrogateQuery(
            surrogate.rows, surrogate.count, weights, self._mode, radius, unknown, hardest, strongest, cruise
        )


def _problems(space: ActionSpace, noise: FloatArray, within: bool) -> tuple[PlanProblem, PlanProblem]:
    scenario, line = space.scenario, space.scenario.road.line
    steps = np.linalg.norm(np.diff(space.path, axis=0), axis=1) / scenario.time_step
    assert space.table is not None
    table = space.table.copy()
    for row in table:
        for move in range(len(row)):
            if (row[:move] == row[move]).all(axis=1).any():
                row[move] = math.nan
    factors = np.concatenate([[1.0], np.cumprod(1.0 + noise[:, 0])])
    rolled = np.concatenate([[0.0], np.cumsum(0.5 * scenario.time_step * (factors[1:] + factors[:-1]))])
    whole = PlanProblem(
        space.path,
        right_and_along(line, space.path),
        table,
        noise,
        np.column_stack([factors, rolled]),
        line,
        (scenario.car.front, scenario.car.rear, scenario.car.half_width),
        scenario.adversary.shape,
        scenario.ticks,
        scenario.time_step,
        float(max(scenario.adversary.speed, steps.max(initial=0.0))),
        scenario.end.loss,
        scenario.collision.minimum_impact_speed,
        scenario.collision.hit_speed,
        within,
        np.array(scenario.rectangles),
        scenario.adversary.core,
    )
    return whole, whole._replace(velocities=np.ascontiguousarray(table[:, :FIRST_HALF]))
