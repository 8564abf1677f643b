"""Search without a picture: best first through what was reached, small changes of the best way, walking up to the car.

Best first goes in the order of what was strayed and of what it would take to meet a car that drives on as it does now;
of places in a cell of a few centimetres, beside a car in nearly the same state, the others wait until nothing else is
left. When they, too, have been tried, nothing is left to be found.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable

import numpy as np
from skd_adversary.model.road_user.pedestrian import AS_PHI
from skd_sim.arrays import FloatArray
from skd_sim.episode.episode import Outcome
from skd_sim.geometry.contact import rectangle_distance
from skd_sim.kernels.compilation import kernel

from skd_evaluator.margin.search.tree import Node, Tree
from skd_evaluator.margin.ways.ways import FIRST_HALF

_CELL = 0.06  # m, in which places count as one
_CAR_CELL = (0.05, 0.1)  # m and m/s, likewise for the car
_BUCKET = 0.05  # m: of moments that differ by less, the later one in time goes first
_EVERY = 3  # ticks along φ, from its end on, from which it is tried to walk up to the car
_LEAVING = 128  # ticks, at most, in which it is tried to leave φ for one action
_KEPT_UP = 8  # ticks: in fewer any full effort leads η_max away
_SAME = 1e-9  # m/s
_SUB_STEPS = 4  # of a tick, in which the car that drives on is looked at
_BRAKES = -0.5  # m/s², below which the car is taken to go on braking
_NEVER = 1e3  # m


@kernel
def _still(
    phi: FloatArray,
    tick: int,
    ticks: int,
    time_step: float,
    x: float,
    y: float,
    fastest: float,
    car: tuple[float, float, float, float],
    acceleration: float,
    footprint: tuple[float, float, float, float],
) -> float:
    """Return how far from φ, at least, one meets a car that goes on as it does, within one's reach; infinity: never.

    Args:
        phi: φ, n × 2, m.
        tick: number of the tick that is now.
        ticks: number of ticks until the end of the episode.
        time_step: duration of a tick, s.
        x: the adversary's x now, m.
        y: the adversary's y now, m.
        fastest: speed of the adversary, m/s.
        car: x, y (m), heading (rad) and speed (m/s) of the car now.
        acceleration: acceleration of the car, m/s².
        footprint: front, rear and half width of the car, and the adversary's reach, m.
    """
    front, rear, half_width, radius = footprint
    cos, sin = math.cos(car[2]), math.sin(car[2])
    last = phi.shape[0] - 1
    least = math.inf
    for sub in range(1, (ticks - tick) * _SUB_STEPS + 1):
        time = sub * time_step / _SUB_STEPS
        driving = time if acceleration >= 0.0 else min(time, car[3] / -acceleration)
        way = car[3] * driving + 0.5 * min(acceleration, 0.0) * driving * driving
        x_car, y_car = car[0] + way * cos, car[1] + way * sin
        whole = tick + sub // _SUB_STEPS
        share = (sub % _SUB_STEPS) / _SUB_STEPS
        before, after = min(whole, last), min(whole + 1, last)
        dx = phi[before, 0] + share * (phi[after, 0] - phi[before, 0]) - x_car
        dy = phi[before, 1] + share * (phi[after, 1] - phi[before, 1]) - y_car
        away = rectangle_distance(cos * dx + sin * dy, cos * dy - sin * dx, front, rear, half_width) - radius
        if away >= least:
            continue
        dx, dy = x - x_car, y - y_car
        way_there = rectangle_distance(cos * dx + sin * dy, cos * dy - sin * dx, front, rear, half_width) - radius
        if way_there <= fastest * time:
            least = max(0.0, away)
    return least


class LocalSearch:
    """The searches without a picture, on one tree."""

    def __init__(self, tree: Tree, rng: np.random.Generator) -> None:
        self._tree, self._rng = tree, rng
        scenario = tree.scenario
        steps = np.linalg.norm(np.diff(tree.phi, axis=0), axis=1) / scenario.time_step
        self._fastest = float(max(scenario.adversary.speed, steps.max(initial=0.0)))
        self._footprint = (scenario.car.front, scenario.car.rear, scenario.car.half_width, scenario.adversary.reach)
        self._seen: dict[tuple[int, ...], float] = {}
        self._queue: list[tuple[bool, int, int, int, Node]] = []
        self._pushed = 0
        self._push(tree.root)

    def as_phi(self, node: Node) -> int:
        """Return the way as φ."""
        return AS_PHI if self._tree.is_pedestrian else len(self._tree.choices(node)) - 1

    def roll_out(self, node: Node, choose: Callable[[Node], int]) -> Node:
        """Follow a rule until the way ends or has strayed as far as the best; return the last moment.

        Raises:
            OverError: see `Tree.step`.
        """
        while node.outcome == Outcome.RUNNING and node.strayed < self._tree.least:
            node = self._tree.step(node, choose(node))
        return node

    def leave(self, last: Node) -> None:
        """Leave a way for one action that is kept up: where the car is nearest, then earlier, until that gets worse.

        Who keeps heading and speed gets furthest in a given time by full effort: so these are the first plans of such
        kinds, as of their kamikazes.

        Raises:
            OverError: see `Tree.step`.
        """
        tree, chain = self._tree, last.chain
        nearest = min(range(len(chain)), key=lambda tick: self._away(chain[tick]))
        most = tree.steps + _LEAVING
        for node in chain[nearest::-1]:
            least = tree.least
            if node.outcome != Outcome.RUNNING:
                continue
            as_phi = tree.choices(node)[self.as_phi(node)]
            for way in tree.ways(node):
                after = node
                if math.dist(tree.choices(node)[way], as_phi) < _SAME:
                    continue
                while after.outcome == Outcome.RUNNING and after.strayed < tree.bound and tree.steps < most:
                    if after.tick - node.tick >= _KEPT_UP:
                        break
                    after = tree.step(after, way)
            if tree.steps >= most or (tree.found is not None and tree.least >= least):
                return

    def walk_up(self, last: Node) -> None:
        """Walk up to the car from late on a way, then from earlier, until that hits.

        Who keeps heading and speed does so first from where the car is nearest, then from earlier, and last from later:
        past the car nothing leads back to it soon, and each walk up to it costs ticks.

        Raises:
            OverError: see `Tree.step`.
        """
        chain = last.chain
        begins = chain[::-_EVERY]
        if not self._tree.is_pedestrian:
            nearest = min(range(len(chain)), key=lambda tick: self._away(chain[tick]))
            begins = [*chain[nearest::-_EVERY], *chain[:nearest:-_EVERY]]
        for node in begins:
            if self._tree.best is None:
                self.roll_out(node, self._towards_the_car)

    def _away(self, node: Node) -> float:
        """Return how far the adversary's centre is from the car, m."""
        car, (front, rear, half_width, _) = node.branch.world.car, self._footprint
        cos, sin = math.cos(car.heading), math.sin(car.heading)
        dx, dy = node.user.x - car.x, node.user.y - car.y
        return rectangle_distance(cos * dx + sin * dy, cos * dy - sin * dx, front, rear, half_width)

    def follow(self, positions: FloatArray) -> None:
        """Walk as near to given positions per tick as can be, and towards the car from their end.

        The last of the positions may be amid a tick, at a contact.

        Raises:
            OverError: see `Tree.step`.
        """
        node, step = self._tree.root, self._tree.scenario.time_step
        for index, (x, y) in enumerate(positions[1:].tolist()):
            if node.outcome != Outcome.RUNNING or node.strayed >= self._tree.least:
                return
            last = index == len(positions) - 2
            away = []
            for vx, vy in self._tree.choices(node):
                dx, dy, mx, my = x - node.user.x, y - node.user.y, step * vx, step * vy
                length = mx * mx + my * my
                share = min(1.0, max(0.0, (dx * mx + dy * my) / length)) if last and length > 0.0 else 1.0
                away.append(math.hypot(dx - share * mx, dy - share * my))
            nearest = min(away)
            if last:
                for way, one in enumerate(away):
                    if one <= nearest + 1e-6:
                        self._tree.step(node, way)
                nearest_way = away.index(nearest)
                self.roll_out(self._tree.step(node, nearest_way), self._towards_the_car)
                return
            node = self._tree.step(node, away.index(nearest))

    @property
    def exhausted(self) -> bool:
        """Whether every moment with less deformation than the best way was tried."""
        while self._queue and self._queue[0][-1].strayed >= self._tree.bound:
            heapq.heappop(self._queue)
        return not self._queue

    def expand_best(self) -> None:
        """Try all ways from the most promising moment.

        Raises:
            OverError: see `Tree.step`.
        """
        if self.exhausted:
            return
        node = self._queue[0][-1]
        self._tree.expand(node)  # a longer budget goes on with it
        heapq.heappop(self._queue)
        for way in self._tree.ways(node)[::-1]:
            after = node.children[way]
            if after.outcome == Outcome.RUNNING and after.strayed < self._tree.bound:
                self._push(after)

    def vary(self) -> None:
        """Try the best way with one to three ticks changed, or a tick left out or put in.

        Raises:
            OverError: see `Tree.step`.
        """
        best = self._tree.best
        if best is None:
            return
        chain = best.chain
        ways = [node.way for node in chain[1:]]
        at = int(self._rng.integers(len(ways)))
        kind, many = int(self._rng.integers(4)), len(self._tree.choices(self._tree.root))
        if self._rng.random() < 0.5:
            many = min(many, FIRST_HALF)
        if kind == 0:
            del ways[at]
        elif kind == 1:
            ways.insert(at, int(self._rng.integers(many)))
        else:
            for tick in range(at, min(len(ways), at + int(self._rng.integers(1, 4)))):
                ways[tick] = int(self._rng.integers(many))
        self.roll_out(chain[at], lambda node: ways[node.tick] if node.tick < len(ways) else self.as_phi(node))

    def _known(self, node: Node) -> bool:
        """Tell whether a moment near this one was reached with no more deformation; if not, remember this one."""
        tree = self._tree
        car, at = node.branch.world.car, tree.phi[min(node.tick, len(tree.phi) - 1)]
        key = (
            node.tick,
            round(car.x / _CAR_CELL[0]),
            round(car.y / _CAR_CELL[0]),
            round(car.speed / _CAR_CELL[1]),
            round((node.user.x - at[0]) / _CELL),
            round((node.user.y - at[1]) / _CELL),
        )
        if self._seen.get(key, math.inf) <= node.strayed:
            return True
        self._seen[key] = node.strayed
        return False

    def _push(self, node: Node) -> None:
        scenario, car = self._tree.scenario, node.branch.world.car
        still = _still(
            self._tree.phi,
            node.tick,
            scenario.ticks,
            scenario.time_step,
            node.user.x,
            node.user.y,
            self._fastest,
            (car.x, car.y, car.heading, car.speed),
            node.acceleration if node.acceleration < _BRAKES else 0.0,
            self._footprint,
        )
        total = min(_NEVER, max(node.strayed, still))
        self._pushed += 1
        heapq.heappush(self._queue, (self._known(node), int(total / _BUCKET), -node.tick, self._pushed, node))

    def _towards_the_car(self, node: Node) -> int:
        """Return the way that ends nearest to where the car will be if it keeps its speed."""
        car, step = node.branch.world.car, self._tree.scenario.time_step
        front, rear, half_width, _ = self._footprint
        cos, sin = math.cos(car.heading), math.sin(car.heading)
        driven = step * car.speed
        best, chosen = math.inf, self.as_phi(node)
        for way, (vx, vy) in enumerate(self._tree.choices(node)):
            dx = node.user.x + step * vx - car.x - driven * cos
            dy = node.user.y + step * vy - car.y - driven * sin
            away = rectangle_distance(cos * dx + sin * dy, cos * dy - sin * dx, front, rear, half_width)
            if away < best:
                best, chosen = away, way
        return chosen
