"""The world: advances car and road users by control periods, and finds the first contact."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from skd_sim.scenario.road import beyond, road_pose
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import sweep
from skd_sim.world.dynamics.basic import CarDynamics, Command, Noise, as_pair, command_limits, make_dynamics
from skd_sim.world.episode import EpisodeSpec, Role, generator
from skd_sim.world.state import AdversaryState, CarState, FloatArray, Pair, on_grid, velocity_on_grid


class Contact(NamedTuple):
    """First touch within a tick: the fraction of the tick at which it happened, and the car's speed at that time (m/s).

    It is the adversary whom the car touches, one of the others of the scenario, or the edge of the road.
    """

    fraction: float
    speed: float


class World:
    """Ground truth of one episode.

    Attributes:
        car: state of the car now.
        adversary: state of the adversary now.
        tick: number of time steps taken.
        period: number of control periods taken since the last tick.
        limits: of the commands that the car can follow.
        clipped: how many commands were beyond these limits.
        dynamics: dynamics of the car, as they are now.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        adversary_start: Pair | None = None,
        gap: float | None = None,
        start_rng: np.random.Generator,
        car_rng: np.random.Generator,
    ) -> None:
        """Place the car and the adversary.

        Args:
            scenario: fixed description of the test.
            adversary_start: place (x, y) at which the adversary starts, m; by default the scenario's.
            gap: distance from the front bumper to the crossing line before the draw, m; by default the scenario's.
            start_rng: generator that draws the car's start distance.
            car_rng: generator that draws the noise of the car's motion.
        """
        car, adversary = scenario.car, scenario.adversary
        x, y = adversary_start if adversary_start is not None else (adversary.start_x, adversary.start_y)
        self.scenario = scenario
        self.car = first_car_state(scenario, car.start_gap if gap is None else gap, start_rng)
        self.adversary = adversary.first_state(x, y)
        self.tick = 0
        self.period = 0
        self.limits = command_limits(scenario)
        self.clipped = 0
        self._rng = car_rng
        self.dynamics: CarDynamics = make_dynamics(scenario)
        self.dynamics.reset(self.car)
        self._origin = self.adversary  # where the adversary was when the tick began

    def step(self, command: Command, velocity: Pair) -> Contact | None:
        """Advance by one control period, which may be the whole time step; return the collision in it, if any.

        A tick in which there is one runs to its end under the same command: nothing is decided after the contact.

        Args:
            command: of the car, finite; what it cannot do is clipped, counted.
            velocity: velocity of the adversary over the time step, (East, North), m/s; constant in it.
        """
        vx, vy = float(velocity[0]), float(velocity[1])
        if self.period == 0:
            self._origin = self.adversary
        pair = as_pair(command)
        possible = self.limits.possible(pair)
        self.clipped += possible != pair
        tick, period = self.tick, self.period
        self.adversary, contact = self._meet(self.advance(possible), (vx, vy), tick, period)
        while contact is not None and self.period > 0:
            self.advance(possible)
        return contact

    def advance(self, command: Pair) -> FloatArray:
        """Drive the car on by one control period under a command that it can follow; return its path."""
        if self.period == 0:
            self._noise = self.dynamics.draw(self._rng)
        periods = self.scenario.control_periods
        noise = Noise(self._noise.speed / periods, self._noise.acceleration)
        path = self.dynamics.advance(command, self.scenario.time_step / periods, noise)
        self.car = CarState(*path[-1].tolist())
        tick, self.period = divmod(self.period + 1, periods)
        self.tick += tick
        return path

    def _meet(self, path: FloatArray, velocity: Pair, tick: int, period: int) -> tuple[AdversaryState, Contact | None]:
        """Return where the adversary is after a period beside the car's path, and the collision in it; change nothing.

        Args:
            path: path of the car in the period; see `CarDynamics.advance`.
            velocity: velocity of the adversary, (East, North), m/s.
            tick: number of the tick.
            period: number of the period in it.

        Returns:
            The state at the end of the period, or of the tick where there is a collision; its fraction is of the tick.
        """
        origin, periods = self._origin, self.scenario.control_periods
        heading = 0.0
        if self.scenario.adversary.is_box:
            heading = float(on_grid(self.scenario.adversary.heading(origin.heading, *velocity)))
        step = self.scenario.time_step
        x, y = origin.x + step * velocity[0], origin.y + step * velocity[1]
        moves: list[Move] = [(origin[:2], (x, y), velocity, heading)]
        if self.scenario.others:
            others = self.scenario.others_at(tick), self.scenario.others_at(tick + 1)
            moves += [(one[:2], then[:2], then[2:4], then.heading) for one, then in zip(*others, strict=True)]
        contact = first_contact_of(self.scenario, path, moves, self.dynamics.steered, step, period, periods)
        counts = contact.fraction <= 1.0
        if not counts and period < periods - 1:
            passed = step * (period + 1) / periods
            x, y = origin.x + passed * velocity[0], origin.y + passed * velocity[1]
        if self.scenario.adversary.is_box:
            velocity = velocity_on_grid(*velocity)
        return AdversaryState(x, y, *velocity, heading), contact if counts else None


def first_car_state(scenario: Scenario, gap: float, start_rng: np.random.Generator) -> CarState:
    """Return the state of the car at the start of an episode.

    Args:
        scenario: fixed description of the test.
        gap: distance from the front bumper to the crossing line before the draw, m.
        start_rng: generator that draws the start distance.
    """
    car = scenario.car
    start_gap = gap + car.start_gap_range * start_rng.random()
    x, y, heading = road_pose(scenario.road.line, -start_gap - car.front)
    return CarState(x, y, float(on_grid(heading)), car.start_speed)


Move = tuple[Pair, Pair, Pair, float]
"""Places (x, y) of a road user when a step begins and ends, m, its velocity, m/s, and its heading, rad."""


def first_contact_of(
    scenario: Scenario, path: FloatArray, moves: Iterable[Move], steered: bool, step: float, period: int, periods: int
) -> Contact:
    """Return the car's first contact that counts as a collision; its fraction of the step is infinite without one.

    Args:
        scenario: fixed description of the test.
        path: path of the car in the period, see `CarDynamics.advance`.
        moves: of the adversary, and of the others of the scenario.
        steered: whether a corner of the car off the road is a contact, too.
        step: duration of the step, s.
        period: number of the period in the step.
        periods: number of periods in a step.
    """
    car, road, first = scenario.car, scenario.road, Contact(math.inf, 0.0)
    least = scenario.collision.minimum_impact_speed
    for body, move in zip((scenario.adversary, *scenario.others), moves, strict=True):
        found = Contact(*sweep(path, *move, car.footprint, body.shape, step, period, periods))
        if found.fraction < first.fraction and found.speed >= least:
            first = found
    row = beyond(road.line, road.edges, car.footprint, path) if steered else -1
    if row >= 0 and path[row, 3] >= least:
        first = min(first, Contact((period + row / (len(path) - 1)) / periods, float(path[row, 3])))
    return first


def make_world(episode: EpisodeSpec) -> World:
    """Return the world at the start of an episode, seeded from its specification."""
    return World(
        episode.scenario,
        adversary_start=episode.start,
        gap=episode.start_gap,
        start_rng=generator(episode.seed, episode.episode_id, Role.START),
        car_rng=generator(episode.seed, episode.episode_id, Role.CAR),
    )
