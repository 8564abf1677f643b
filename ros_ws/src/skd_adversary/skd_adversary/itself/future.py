"""The car and its adversary led on, tick by tick, in copies: what would follow from the adversary's actions.

A node is a moment at the beginning of a tick. What an action leads to is simulated once and kept, so that ways which
begin alike share what they have in common. All nodes of a future draw the same noise in the same tick, whatever the
adversary does, as the episode does.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.controllers import Controller, sight_of
from skd_sim.controllers.copying import Copier
from skd_sim.dynamics.basic import BasicCar
from skd_sim.dynamics.interface import CarDynamics, Noise, make_dynamics
from skd_sim.dynamics.limits import command_limits
from skd_sim.encounter.road import HEADING_NORTH, road_position, straight_from
from skd_sim.episode.episode import Episode
from skd_sim.geometry.heading import on_grid
from skd_sim.sensors.laser import PlanarLaser
from skd_sim.simulation.world import first_contact_of
from skd_sim.state import AdversaryState, CarState

from skd_adversary.itself.costs import Cost
from skd_adversary.itself.moves import Moves, Own, Velocity

_SLACK: Final = 0.01  # m, within which a contact is looked for in earnest
_LARGEST: Final = 2**63 - 1
_PLACE: Final = (
    tuple.__new__
)  # a named tuple without the call of its own constructor, which takes as long as the motion


class Draws:
    """What a future draws: the noise of each tick, and a laser with noise of its own."""

    __slots__ = ("_dynamics", "_noise", "_rng", "laser")

    def __init__(self, episode: Episode, dynamics: CarDynamics, rng: np.random.Generator, *, senses: bool) -> None:
        """Draw from `rng`, with the dynamics of the car, which says how; a laser where the car senses."""
        self._rng = np.random.Generator(np.random.PCG64(int(rng.integers(_LARGEST))))
        self._dynamics = dynamics
        self._noise: list[Noise] = []
        self.laser = PlanarLaser(episode.scenario, int(rng.integers(_LARGEST)), 0) if senses else None

    def noise(self, ahead: int) -> Noise:
        """Return the noise of the tick that is so many ahead of the first."""
        while len(self._noise) <= ahead:
            self._noise.append(self._dynamics.draw(self._rng))
        return self._noise[ahead]


class Node:
    """A moment at the beginning of a tick, of car and adversary.

    Attributes:
        tick: number of the tick.
        car: state of the car.
        dynamics: dynamics of the car at this moment; what follows does not change them.
        controller: controller of the car at this moment; what follows does not change it.
        place: place of the adversary, with its velocity in the tick before.
        own: state of the adversary's kind beyond its place.
        velocities: velocities that the adversary can choose now.
        so_far: what the cost needs to know of the way so far.
        cost: cost of the way if it ends here; None if it goes on.
        contact: (fraction of the tick, impact speed in m/s) of the contact with which it ended, if it did.
        after: the nodes to which actions lead, as far as they were tried.
        stood: for how many ticks the car has been standing.
        towards: the action that leads towards the car; −1: not asked yet.
    """

    __slots__ = (
        "after",
        "car",
        "contact",
        "controller",
        "cost",
        "dynamics",
        "own",
        "place",
        "so_far",
        "stood",
        "tick",
        "towards",
        "velocities",
    )

    def __init__(
        self,
        tick: int,
        car: CarState,
        dynamics: CarDynamics,
        controller: Controller,
        place: AdversaryState,
        own: Own,
        velocities: tuple[Velocity, ...],
        so_far: Any,
    ) -> None:
        self.tick, self.car, self.dynamics, self.controller = tick, car, dynamics, controller
        self.place, self.own, self.velocities, self.so_far = place, own, velocities, so_far
        self.cost: float | None = None
        self.contact: tuple[float, float] | None = None
        self.after: list[Node | None] = [None] * len(velocities)
        self.stood = 0
        self.towards = -1


class Course:
    """Leads nodes of an episode on.

    Attributes:
        calls: how many calls of controllers have been made.
    """

    def __init__(self, episode: Episode, moves: Moves, cost: Cost, copier: Copier, controller: Controller) -> None:
        """Take the world from the episode's scenario; neither its draws nor its own state, nor the controller's."""
        scenario = episode.scenario
        self._sight = sight_of(controller, scenario)
        self._episode, self._moves, self._cost, self._copier = episode, moves, cost, copier
        self._scenario = scenario
        self._periods, self._step = scenario.control_periods, scenario.time_step
        self._duration = scenario.time_step / scenario.control_periods
        limits = command_limits(scenario)
        self._clip, self._lowest, self._highest = limits.clip, limits.least, limits.greatest
        car, body = scenario.car, scenario.adversary
        self._footprint = car.front, car.rear, car.half_width
        self._front, self._rear = car.front + body.reach + _SLACK, car.rear + body.reach + _SLACK
        self._aside = car.half_width + body.reach + _SLACK
        # The basic car on the straight lane is most of all cars, and its motion two lines.
        basic = scenario.road.straight and isinstance(make_dynamics(scenario), BasicCar)
        self._simple = basic and not scenario.others
        heading = float(on_grid(HEADING_NORTH))
        self._direction = math.cos(heading), math.sin(heading)
        self._straight_from = straight_from(scenario.road.line)
        self.calls = 0

    def lead_on(self, node: Node, action: int, draws: Draws, first: int) -> Node:
        """Return the node after a tick of an action; simulate it, where that was not done yet.

        Args:
            node: not an end.
            action: number of the adversary's action.
            draws: random draws of the future.
            first: tick of its first node.
        """
        found = node.after[action]
        if found is None:
            velocity = node.velocities[action]
            controller = self._copier.copy(node.controller)
            noise = draws.noise(node.tick - first)
            found = node.after[action] = self.tick(node, velocity, noise, controller, draws.laser)
        return found

    def tick(
        self, node: Node, velocity: Velocity, noise: Noise, controller: Controller, laser: PlanarLaser | None
    ) -> Node:
        """Simulate a tick, with a controller of its own, which is changed by it."""
        vx, vy = velocity
        x, y = node.place.x, node.place.y
        step, periods, car = self._step, self._periods, node.car
        x_end, y_end = x + step * vx, y + step * vy
        heading = 0.0
        scenario = self._scenario
        if scenario.adversary.is_box:
            heading = float(on_grid(scenario.adversary.heading(node.place.heading, vx, vy)))
        drive = self._drive if self._simple else self._advance
        place = node.place
        spread = noise.speed / periods
        dynamics = node.dynamics if self._simple else self._copier.copy(node.dynamics)
        contact = None
        for period in range(periods):
            if laser is not None:
                controller.sense(laser.scan(car, place, node.tick, period))  # type: ignore[attr-defined]
            command = float(controller.command(car, self._sight(car, place, node.tick, period)))
            if not self._lowest <= command <= self._highest:
                command = self._clip(command)
            path, car = drive(dynamics, car, command, spread, noise.acceleration, place.x, place.y, vx, vy)
            if path is not None:
                share, speed = first_contact_of(scenario, path, node.place, velocity, heading, node.tick, period)
                if share <= 1.0:
                    contact = share, speed
                    break
            if period == periods - 1:
                place = AdversaryState(x_end, y_end, vx, vy, heading)
            else:
                passed = step * (period + 1) / periods
                place = _PLACE(AdversaryState, (x + passed * vx, y + passed * vy, vx, vy, heading))
        self.calls += period + 1
        return self._after(node, velocity, place, car, dynamics, controller, contact)

    def _after(
        self,
        node: Node,
        velocity: Velocity,
        place: AdversaryState,
        car: CarState,
        dynamics: CarDynamics,
        controller: Controller,
        contact: tuple[float, float] | None,
    ) -> Node:
        cost, tick = self._cost, node.tick
        if contact is not None:
            share, speed = contact
            x = node.place.x + share * self._step * velocity[0]
            y = node.place.y + share * self._step * velocity[1]
            end = Node(tick + 1, car, dynamics, controller, place, node.own, (), node.so_far)
            end.contact = contact
            end.cost = cost.hit(node.so_far, tick, share, x, y, speed)
            return end
        so_far = cost.step(node.so_far, tick, place.x, place.y)
        own = self._moves.settle(node.own, velocity)
        scenario = self._scenario
        ends = tick + 1 >= scenario.ticks or scenario.end.missed(place.x, place.y)
        ends = ends or scenario.ran_into_obstacle(place)
        found = Node(
            tick + 1,
            car,
            dynamics,
            controller,
            place,
            own,
            () if ends else self._moves.velocities(own, tick + 1),
            so_far,
        )
        found.stood = node.stood + 1 if car.speed < 1e-3 else 0
        if ends or self._passed(car, place):
            found.cost = cost.missed(so_far)
        return found

    def _advance(
        self,
        dynamics: CarDynamics,
        car: CarState,
        command: float,
        speed_noise: float,
        noise: float,
        x: float,
        y: float,
        vx: float,
        vy: float,
    ) -> tuple[FloatArray | None, CarState]:
        """Return the way of any car in a period, and its state after it."""
        path = dynamics.advance(command, self._duration, Noise(speed_noise, noise))
        return path, CarState(*path[-1].tolist())

    def _drive(
        self,
        dynamics: CarDynamics,
        car: CarState,
        command: float,
        speed_noise: float,
        noise: float,
        x: float,
        y: float,
        vx: float,
        vy: float,
    ) -> tuple[FloatArray | None, CarState]:
        """Return the same of the basic car on the straight lane, by the operations of `skd_sim.dynamics.basic`.

        The way is left out where it cannot lead to a contact with who is at (x, y), m, and moves at (vx, vy), m/s: for
        the two are certainly apart then.
        """
        car_x, car_y, heading, speed = car
        applied = command + noise * command
        duration = self._duration
        after = speed + speed_noise * speed + duration * applied
        if not after > 0.0:
            after = 0.0
        distance = 0.5 * duration * (speed + after)
        cos, sin = self._direction
        x_after, y_after = car_x + distance * cos, car_y + distance * sin
        found = _PLACE(CarState, (x_after, y_after, heading, after))
        left, left_after = x - car_x, x + duration * vx - x_after
        aside = self._aside
        if (left > aside and left_after > aside) or (left < -aside and left_after < -aside):
            return None, found
        ahead, ahead_after = y - car_y, y + duration * vy - y_after
        front, rear = self._front, self._rear
        if (ahead > front and ahead_after > front) or (ahead < -rear and ahead_after < -rear):
            return None, found
        return np.array([car, found]), found

    def _passed(self, car: CarState, place: AdversaryState) -> bool:
        """Return whether the car has gone by, faster than the adversary could follow, and will not turn back to it."""
        line = self._scenario.road.line
        if not self._scenario.road.straight and road_position(line, car.x, car.y)[0] < self._straight_from:
            return False
        ahead = math.cos(car.heading) * (place.x - car.x) + math.sin(car.heading) * (place.y - car.y)
        return ahead < -self._rear and car.speed > self._moves.fastest

    def towards(self, node: Node) -> int:
        """Return the action that ends nearest to where the car will be if it keeps its speed."""
        if node.towards < 0:
            car, step = node.car, self._step
            cos, sin = math.cos(car.heading), math.sin(car.heading)
            way = step * car.speed
            front, rear, half_width = self._footprint
            dx, dy = node.place.x - car.x - way * cos, node.place.y - car.y - way * sin
            best = math.inf
            for action in range(len(node.velocities) - 1, -1, -1):
                vx, vy = node.velocities[action]
                x, y = dx + step * vx, dy + step * vy
                ahead, left = cos * x + sin * y, abs(cos * y - sin * x)
                out = max(0.0, ahead - front, -rear - ahead)
                beside = max(0.0, left - half_width)
                away = out * out + beside * beside
                if away < best:
                    best, node.towards = away, action
        return node.towards
