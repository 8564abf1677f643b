"""What an adversary that knows the car itself believes of it: particles, each a car driven by a controller of its own.

Each particle has a place and a speed of the car and a controller that has seen all that was done so far, from that
place; none shares a draw with the episode. The sensor's likelihood weighs them; systematic resampling where their
effective number falls below half (Kitagawa 1996).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.controllers import Controller
from skd_sim.controllers.copying import Copier
from skd_sim.dynamics.interface import make_dynamics
from skd_sim.encounter.road import road_position
from skd_sim.episode.episode import Episode
from skd_sim.simulation.world import World

from skd_adversary.itself.costs import Cost
from skd_adversary.itself.future import Course, Draws, Node
from skd_adversary.itself.moves import Moves, Velocity
from skd_adversary.model.parts import Sensor

RESAMPLE_BELOW: Final = 0.5


class Particles:
    """Weighted moments of car and adversary.

    Attributes:
        nodes: the moment of each particle.
        weights: weight of each particle; they sum to 1.
        depletions: how often none of them agreed with what happened.
    """

    def __init__(
        self,
        episode: Episode,
        controller: Controller,
        course: Course,
        moves: Moves,
        cost: Cost,
        copier: Copier,
        sensor: Sensor,
        count: int,
        rng: np.random.Generator,
        *,
        senses: bool,
    ) -> None:
        """Draw the start of the car, and have copies of the controller begin there.

        Args:
            episode: the episode; its scenario says how the car's start is drawn. The episode's own draw is not used.
            controller: controller to be copied; every copy forgets its state and begins anew, with random draws of its
                own.
            course: leads particles on.
            moves: the actions of the adversary.
            cost: the cost of ways.
            copier: copies controllers.
            sensor: how the adversary sees the car.
            count: number of particles.
            rng: generator of all draws.
            senses: whether the controller takes scans.
        """
        self._episode, self._course, self._copier, self._rng, self._senses = episode, course, copier, rng, senses
        self._sensor, self._moves, self._cost = sensor, moves, cost
        scenario = episode.scenario
        self.nodes: list[Node] = []
        for one in rng.spawn(count):
            world = World(scenario, adversary_start=episode.start, gap=episode.start_gap, start_rng=one, car_rng=one)
            dynamics = make_dynamics(scenario)
            dynamics.reset(world.car)
            own = copier.afresh(controller, one)
            own.reset(episode.shown_scenario, one.spawn(1)[0])
            place = world.adversary
            velocities = moves.velocities(moves.start, 0)
            self.nodes.append(
                Node(0, world.car, dynamics, own, place, moves.start, velocities, cost.start(place.x, place.y))
            )
        self.weights: FloatArray = np.full(count, 1.0 / count)
        self.depletions = 0

    def predict(self, velocity: Velocity) -> None:
        """Lead all particles on by a tick in which the adversary moved at a velocity; who touched is dropped."""
        touched = np.zeros(len(self.nodes), dtype=bool)
        moved = []
        for index, node in enumerate(self.nodes):
            draws = Draws(self._episode, node.dynamics, self._rng, senses=self._senses)
            after = self._course.tick(node, velocity, draws.noise(0), node.controller, draws.laser)
            touched[index] = after.contact is not None
            if not touched[index]:
                after.cost = None
            moved.append(node if touched[index] else after)
        self.nodes = moved
        self.weights[touched] = 0.0
        total = float(self.weights.sum())
        if total == 0.0:  # what happened is nothing that any of them foresaw: go on from where they stopped short of it
            self.depletions += 1
            self.nodes = [self._short_of(node, velocity) for node in moved]
            self.weights = np.full(len(moved), 1.0 / len(moved))
            return
        self.weights /= total
        if touched.any():  # there is nothing to be made of them any more
            self._resample()

    def _short_of(self, node: Node, velocity: Velocity) -> Node:
        """Return a moment at which the adversary has moved on and the car has not."""
        step, place = self._episode.scenario.time_step, node.place
        moved = place._replace(x=place.x + step * velocity[0], y=place.y + step * velocity[1])
        own = self._moves.settle(node.own, velocity)
        velocities = self._moves.velocities(own, node.tick + 1)
        so_far = self._cost.step(node.so_far, node.tick, moved.x, moved.y)
        return Node(node.tick + 1, node.car, node.dynamics, node.controller, moved, own, velocities, so_far)

    def correct(self, own: tuple[float, float], seen: FloatArray) -> None:
        """Weigh all particles by what was seen from (x, y), m; resample if few of them have most of the weight."""
        errors = np.array([self._expected(node, own) for node in self.nodes]) - seen[0]
        body = self._episode.scenario.adversary
        noise = body.distance_noise if self._sensor.name == "distance" else body.position_noise
        with np.errstate(divide="ignore"):
            logs = np.log(self.weights) - 0.5 * (errors / noise) ** 2
        weights = np.exp(logs - logs.max())
        self.weights = weights / weights.sum()
        if 1.0 / float(self.weights @ self.weights) < RESAMPLE_BELOW * len(self.nodes):
            self._resample()

    def _expected(self, node: Node, own: tuple[float, float]) -> float:
        """Return what would be seen of a car without noise."""
        x, y = node.car.x, node.car.y
        if self._sensor.name == "distance":
            return math.hypot(x - own[0], y - own[1])
        line = self._episode.scenario.road.line
        return float(road_position(line, x, y)[0] - road_position(line, *own)[0])

    def _resample(self) -> None:
        self.nodes = [self._again(self.nodes[index], again) for index, again in self.drawn(len(self.nodes))]
        self.weights = np.full(len(self.nodes), 1.0 / len(self.nodes))

    def _again(self, node: Node, again: bool) -> Node:
        if not again:
            return node
        controller = self._copier.afresh(node.controller, self._rng)
        dynamics = self._copier.copy(node.dynamics)
        return Node(node.tick, node.car, dynamics, controller, node.place, node.own, node.velocities, node.so_far)

    def drawn(self, count: int) -> Sequence[tuple[int, bool]]:
        """Draw some particles by their weights, systematically: each one's number, and whether it was drawn already."""
        places = (np.arange(count) + self._rng.random()) / count
        found = np.minimum(np.searchsorted(np.cumsum(self.weights), places), len(self.nodes) - 1)
        return [(int(one), bool(i and found[i - 1] == one)) for i, one in enumerate(found)]
