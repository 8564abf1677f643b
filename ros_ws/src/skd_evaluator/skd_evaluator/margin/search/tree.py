"""What has been simulated of an attempt: a tree of ticks in which the adversary went one way or another."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from skd_adversary.model.road_user import pedestrian
from skd_adversary.model.road_users import road_user_named
from skd_sim.arrays import FloatArray
from skd_sim.dynamics.interface import Noise, make_dynamics
from skd_sim.encounter.road import road_position
from skd_sim.episode.episode import Episode, Outcome
from skd_sim.episode.randomness import Role, generator
from skd_sim.simulation.branching import Branch, Way
from skd_sim.state import AdversaryState

from skd_evaluator.margin.search.picture import SITUATION, Picture
from skd_evaluator.margin.ways.ways import velocities

Velocity = tuple[float, float]

ENOUGH = 1e-9
"""m: nobody has strayed who has strayed less."""
_BEGINNINGS = 3.0
"""Times η_max: so far may stray, until something is found, who keeps heading and speed: small changes of a hit beyond
η_max lead to hits within it, and most of the first hits that are found lie beyond."""


class OverError(Exception):
    """The search is over: its budget is spent, or there is nothing less to be found."""


class Node:
    """A moment that was simulated.

    Attributes:
        branch: the car at the moment; not used if the episode has ended.
        user: state of the adversary.
        tick: number of the tick of this moment.
        strayed: the greatest distance of the adversary from φ so far, m.
        parent: the moment a tick before.
        way: number of the way that led here from the moment before.
        outcome: how the episode stands; COLLISION is a hit, and a slower contact is MISSED.
        along: path coordinate of the car, m.
        speed: speed of the car, m/s.
        acceleration: acceleration of the car in the tick before, as the picture counts it, m/s².
        children: the moments that follow, by number of the way.
        tried: a bit for each way that was tried, or is the same as another.
    """

    __slots__ = (
        "_choices",
        "_drive",
        "acceleration",
        "along",
        "branch",
        "children",
        "outcome",
        "parent",
        "speed",
        "strayed",
        "tick",
        "tried",
        "user",
        "way",
    )

    def __init__(self, branch: Branch, user: AdversaryState, tick: int, parent: Node | None, way: int) -> None:
        self.branch, self.user, self.tick, self.parent, self.way = branch, user, tick, parent, way
        self.strayed = 0.0
        self.outcome = Outcome.RUNNING
        self.along = self.speed = self.acceleration = 0.0
        self.children: dict[int, Node] = {}
        self.tried = 0
        self._choices: list[Velocity] | None = None
        self._drive: Way | None = None

    @property
    def chain(self) -> list[Node]:
        """All moments up to this one."""
        chain, node = [self], self.parent
        while node is not None:
            chain.append(node)
            node = node.parent
        return chain[::-1]


class Tree:
    """The moments of one attempt that were simulated, and the best way among them.

    Attributes:
        root: the start of the attempt.
        nodes: all moments from which it can go on.
        best: the hit of least deformation; of who keeps heading and speed it may lie beyond η_max, see `found`.
        least: deformation of the best way, m; before there is one, how far it may lie from φ.
        steps: how many ticks of the car were simulated.
        trace: `least` when 1, 2, 4, … ticks had been simulated; infinity where there was no hit.
    """

    def __init__(self, episode: Episode, budget: int, root: Branch, picture: Picture) -> None:
        assert episode.safe_trajectory is not None
        self.episode, self.scenario, self.picture = episode, episode.scenario, picture
        self.phi = np.ascontiguousarray(episode.safe_trajectory.positions, dtype=np.float64)
        last = len(self.phi) - 1
        self._phi = [tuple(self.phi[min(tick, last)].tolist()) for tick in range(self.scenario.ticks + 2)]
        self.is_pedestrian = road_user_named(self.scenario.adversary.kind) is pedestrian.ROAD_USER
        self.within_ticks = not root.shares
        self._line, self._straight = self.scenario.road.line, self.scenario.road.straight
        self.noise = self._draws()
        self._table: list[list[Velocity]] = []
        if self.is_pedestrian:
            for tick in range(self.scenario.ticks + 1):
                self._table.append(_pairs(velocities(self.scenario, self.phi, tick)))
        self.root = Node(root, root.world.adversary, 0, None, -1)
        self._describe(self.root, root)
        self.nodes = [self.root]
        self.best: Node | None = None
        self._most = self.scenario.eta_max * (1.0 + ENOUGH)
        self.least = self._most if self.is_pedestrian else _BEGINNINGS * self._most
        self.steps, self._budget = 0, budget
        self.trace: list[float] = []

    def _draws(self) -> list[Noise]:
        dynamics = make_dynamics(self.scenario)
        rng = generator(self.episode.seed, self.episode.episode_id, Role.CAR)
        return [dynamics.draw(rng) for _ in range(self.scenario.ticks + 1)]

    @property
    def found(self) -> Node | None:
        """The hit of least deformation, at most η_max."""
        return self.best if self.least < self._most else None

    @property
    def bound(self) -> float:
        """Deformation, m, beyond which nothing is of use but as a beginning."""
        return min(self.least, self._most)

    def choices(self, node: Node) -> list[Velocity]:
        """Return the velocities of all ways from a moment, m/s."""
        if self.is_pedestrian:
            return self._table[node.tick]
        if node._choices is None:
            walked = np.array([one.user[:2] for one in node.chain])
            node._choices = _pairs(velocities(self.scenario, self.phi, node.tick, walked))
        return node._choices

    def ways(self, node: Node) -> Sequence[int]:
        """Return the ways from a moment, of equal ones the first."""
        choices = self.choices(node)
        return [way for way, velocity in enumerate(choices) if choices.index(velocity) == way]

    def step(self, node: Node, way: int) -> Node:
        """Return the moment to which a way leads; it is simulated if it was not yet.

        Raises:
            OverError: the budget was spent before, or what was found cannot be bettered.
        """
        choices = self.choices(node)
        way = choices.index(choices[way])
        child = node.children.get(way)
        if child is not None:
            return child
        if node._drive is None or self.within_ticks:
            self._spend()
        if node._drive is None:
            node._drive = node.branch.drive(node.user)
            if node._drive.after is not None:
                self.picture.learn(self._situation(node, node.user[2:4]), self._seen(node, node._drive.after))
        branch, user, contact = node._drive.go(choices[way])
        child = Node(branch, user, node.tick + 1, node, way)
        self._describe(child, branch)
        child.acceleration = self._seen(node, branch)
        if self.within_ticks and contact is None:
            self.picture.learn(self._situation(node, choices[way]), child.acceleration)
        share = 1.0 if contact is None else contact.fraction
        here, there = self._phi[node.tick], self._phi[node.tick + 1]
        ex = node.user.x + share * (user.x - node.user.x) - (here[0] + share * (there[0] - here[0]))
        ey = node.user.y + share * (user.y - node.user.y) - (here[1] + share * (there[1] - here[1]))
        child.strayed = max(node.strayed, math.hypot(ex, ey))
        if contact is None:
            child.outcome = self.episode.outcome(child.tick, user, collided=False)
        else:
            hit = self.scenario.collision.is_hit(contact.speed)
            child.outcome = Outcome.COLLISION if hit else Outcome.MISSED
        node.children[way] = child
        node.tried |= 1 << way
        if child.outcome == Outcome.RUNNING and child.strayed < self.least:
            self.nodes.append(child)
        if child.outcome == Outcome.COLLISION and child.strayed < self.least:
            self.best, self.least = child, child.strayed
            if self.least <= ENOUGH:
                raise OverError
        return child

    def expand(self, node: Node) -> None:
        """Simulate all ways from a moment.

        Raises:
            OverError: see `step`.
        """
        for way in self.ways(node):
            self.step(node, way)

    def table(self, tick: int) -> list[Velocity]:
        """Return the velocities of a pedestrian's ways in a tick, m/s."""
        return self._table[tick]

    def _spend(self) -> None:
        while self.steps >= 1 << len(self.trace):
            self.trace.append(math.inf if self.found is None else self.least)
        if self.steps >= self._budget:
            raise OverError
        self.steps += 1

    def _describe(self, node: Node, branch: Branch) -> None:
        car = branch.world.car
        node.speed = car.speed
        node.along = car.y if self._straight else float(road_position(self._line, car.x, car.y)[0])

    def _situation(self, node: Node, velocity: Velocity) -> FloatArray:
        car, user = node.branch.world.car, node.user
        (right, along), (vx, vy) = (user.x, user.y), velocity
        if not self._straight:
            along, left = road_position(self._line, user.x, user.y)
            cos, sin = math.cos(car.heading), math.sin(car.heading)
            right, vx, vy = -left, sin * vx - cos * vy, cos * vx + sin * vy
        gap = along - node.along - self.scenario.car.front
        found = np.empty(SITUATION)
        found[:] = (gap, right, node.speed, node.acceleration, vx, vy)
        return found

    def _seen(self, node: Node, after: Branch) -> float:
        """Return the acceleration of the tick behind a moment, freed of its noise, m/s²."""
        speed, noise = after.world.car.speed, self.noise[node.tick]
        seen = (speed - node.speed * (1.0 + noise.speed)) / (self.scenario.time_step * (1.0 + noise.acceleration))
        return min(seen, node.acceleration) if speed <= 0.0 else seen  # who stands may have braked harder


def _pairs(array: FloatArray) -> list[Velocity]:
    return [(vx, vy) for vx, vy in array.tolist()]
