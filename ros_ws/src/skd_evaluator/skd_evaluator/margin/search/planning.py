"""Plan in the picture of the controller, follow the plan on the car, learn where it did otherwise, and plan again."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from skd_sim.encounter.road import right_and_along
from skd_sim.episode.episode import Outcome

from skd_evaluator.margin.search import planning_kernels as kernels
from skd_evaluator.margin.search.picture import RADIUS, WEIGHTS, Picture
from skd_evaluator.margin.search.planning_parts import (
    BOLD,
    CAUTIOUS,
    COLUMNS,
    FAILURES,
    NEAREST,
    VARIED,
    Course,
    View,
    make_room,
)
from skd_evaluator.margin.search.tree import Node, Tree
from skd_evaluator.margin.ways.ways import FIRST_HALF

MODES: Final = 4
ROOM: Final = 1 << 15, 1 << 12
"""Moments that a plan may have, at most, of a car that decides once a tick, and of another, of which each takes longer;
it has fewer as long as that is enough."""
_LITTLE_ROOM = 1 << 12, 1 << 11
_LESS = 1e-3  # a plan has to be better by this share
_ASTRAY = 0.05, 0.15  # m and m/s by which the car may be elsewhere than was planned
_COARSER, _COARSEST, _FINEST = 1.5, 3.0, 0.5  # factors of the planned cells
_BUCKETS, _FEW_BUCKETS = 128, 6
_LEAST_RADIUS = 0.25
_VARIATION = 0.5  # standard deviation of the logarithm of weights and radius


def course_of(tree: Tree) -> Course:
    """Return what of an attempt is known beforehand."""
    scenario, line = tree.scenario, tree.scenario.road.line
    steps = np.linalg.norm(np.diff(tree.phi, axis=0), axis=1) / scenario.time_step
    table = np.array([tree.table(tick) for tick in range(scenario.ticks)])
    for row in table:
        for way in range(len(row)):
            if (row[:way] == row[way]).all(axis=1).any():
                row[way] = math.nan
    noise = np.array(tree.noise)
    factors = np.concatenate([[1.0], np.cumprod(1.0 + noise[:, 0])])
    rolled = np.concatenate([[0.0], np.cumsum(0.5 * scenario.time_step * (factors[1:] + factors[:-1]))])
    return Course(
        tree.phi,
        right_and_along(line, tree.phi),
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
        tree.within_ticks,
        np.array(scenario.rectangles),
        scenario.adversary.core,
    )


class Planning:
    """The plans of one attempt.

    Attributes:
        planned: moments that were planned so far.
    """

    def __init__(self, tree: Tree, picture: Picture, rng: np.random.Generator) -> None:
        self._tree, self._picture, self._rng = tree, picture, rng
        self._course = course_of(tree)
        # Plans without half speeds have fewer ways to try and so look further: each finds what the other does not.
        whole = np.ascontiguousarray(self._course.velocities[:, :FIRST_HALF])
        self._courses = self._course, self._course._replace(velocities=whole)
        self._turns = 0
        self._room = make_room(ROOM[tree.within_ticks])
        self._nodes: list[Node] = []
        self._rows = np.empty((64, COLUMNS))
        self._seen = 0
        self._failures: list[tuple[float, ...]] = []
        self._mode, self._radius = MODES - 1, RADIUS
        self._ways = np.empty(tree.scenario.ticks + 1, np.int64)
        self._foreseen = np.empty((tree.scenario.ticks + 1, 2))
        self._coarseness, self._greedy, self._most = 1.0, False, _LITTLE_ROOM[tree.within_ticks]
        self.planned = 0

    def turn(self) -> bool:
        """Make one plan and follow it; tell whether there was one.

        Raises:
            OverError: see `Tree.step`.
        """
        self._mode = (self._mode + 1) % MODES
        self._turns += 1
        course = self._courses[self._turns // MODES % 2]
        self._note_moments()
        tree = self._tree
        failures = np.array(self._failures).reshape(-1, FAILURES)
        _, begin, length, planned = kernels.plan(
            course,
            self._view(),
            self._rows[: len(self._nodes)],
            np.array([node.tick for node in self._nodes], np.int64),
            np.array([node.tried for node in self._nodes], np.int64),
            failures,
            tree.least * (1.0 - _LESS),
            self._rng.random(4),
            self._coarseness,
            _FEW_BUCKETS if self._greedy else _BUCKETS,
            self._room,
            self._most,
            self._ways,
            self._foreseen,
        )
        self.planned += planned
        full = planned >= self._most
        self._greedy = full and begin < 0 and not self._greedy
        if full and begin < 0:
            self._most = min(ROOM[self._tree.within_ticks], 2 * self._most)
        elif not full:
            self._most = max(_LITTLE_ROOM[self._tree.within_ticks], self._most // 2)
        if full:
            self._coarseness = min(_COARSEST, self._coarseness * _COARSER)
        elif begin < 0:
            self._coarseness = max(_FINEST, self._coarseness / _COARSER)
        if begin < 0:
            if self._mode == CAUTIOUS:
                self._radius = max(_LEAST_RADIUS, 0.7 * self._radius)
            return False
        self._follow(self._nodes[begin], length)
        return True

    def _follow(self, node: Node, length: int) -> None:
        for index in range(length):
            before = node
            way = int(self._ways[index])
            node = self._tree.step(node, way)
            if not self._tree.within_ticks:
                self._tree.expand(before)
            last = index == length - 1
            if last and node.outcome != Outcome.COLLISION:
                self._failures.append((before.tick, before.user.x, before.user.y, before.along, way))
            if last or node.outcome != Outcome.RUNNING or node.strayed >= self._tree.least:
                return
            along, speed = self._foreseen[index]
            if abs(node.along - along) > _ASTRAY[0] or abs(node.speed - speed) > _ASTRAY[1]:
                return

    def _note_moments(self) -> None:
        tree = self._tree
        for node in tree.nodes[self._seen :]:
            self._add(node)
        self._seen = len(tree.nodes)
        every = (1 << self._course.velocities.shape[1]) - 1
        keep = [i for i, node in enumerate(self._nodes) if node.strayed < tree.least and node.tried != every]
        if 2 * len(keep) < len(self._nodes):
            self._rows[: len(keep)] = self._rows[keep]
            self._nodes = [self._nodes[i] for i in keep]

    def _add(self, node: Node) -> None:
        count = len(self._nodes)
        if count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        user = node.user
        self._rows[count] = (
            user.x,
            user.y,
            user.vx,
            user.vy,
            user.heading,
            node.along,
            node.speed,
            node.acceleration,
            node.strayed,
        )
        self._nodes.append(node)

    def _view(self) -> View:
        weights, radius, unknown = np.array(WEIGHTS), self._radius, 0.0
        if self._mode == VARIED:
            weights = self._picture.telling(self._rng)
        if self._mode == BOLD:
            weights *= np.exp(_VARIATION * self._rng.standard_normal(len(weights)))
        if self._mode == BOLD:
            radius *= math.exp(_VARIATION * self._rng.standard_normal())
            if self._rng.random() < 0.5 and self._picture.count:
                unknown = float(self._picture.rows[int(self._rng.integers(self._picture.count)), -1])
        hardest, strongest = self._picture.range()
        rows, count = self._picture.rows, self._picture.count
        cruise = self._tree.scenario.car.start_speed
        return View(rows, count, weights, self._mode, radius, unknown, hardest, strongest, cruise)


assert NEAREST == 0  # modes are taken in turn
assert MODES == BOLD + 1
