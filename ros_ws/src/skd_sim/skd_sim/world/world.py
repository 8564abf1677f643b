"""The world: advances everybody in it, a control period at a time, and says whom the car touched."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.scenario.road import road_pose
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import sweep
from skd_sim.world.dynamics.basic import CarDynamics, Noise, command_limits, make_dynamics
from skd_sim.world.episode import EpisodeSpec, Role, generator
from skd_sim.world.state import AdversaryState, CarState, RoadUserState, on_grid, velocity_on_grid


class Contact(NamedTuple):
    """First touch within a tick: the fraction of the tick at which it happened, and the car's speed at that time (m/s).

    It is the adversary whom the car touches, or one of the others of the scenario.
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
        limits: least and greatest acceleration that the car can be commanded.
        clipped: how many commands were beyond these limits.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        adversary_start: tuple[float, float] | None = None,
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
        self._dynamics = make_dynamics(scenario)
        self._dynamics.reset(self.car)
        self._origin = self.adversary  # where the adversary was when the tick began

    @property
    def dynamics(self) -> CarDynamics:
        """Dynamics of the car, as they are now."""
        return self._dynamics

    @property
    def time(self) -> float:
        """Simulated time since the start, s."""
        return (self.tick + self.period / self.scenario.control_periods) * self.scenario.time_step

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Contact | None:
        """Advance by one control period, which may be the whole time step; return the collision in it, if any.

        A tick in which there is one runs to its end under the same command: nothing is decided after the contact.

        Args:
            acceleration: commanded acceleration of the car, m/s², finite; what it cannot do is clipped, counted.
            velocity: velocity of the adversary over the time step, (East, North), m/s; constant in it.
        """
        vx, vy = float(velocity[0]), float(velocity[1])
        if self.period == 0:
            self._origin = self.adversary
        command = float(acceleration)
        possible = self.limits.clip(command)
        self.clipped += possible != command
        self.adversary, contact = self._meet(self._advance(possible), (vx, vy))
        self.period += 1
        while contact is not None and self.period < self.scenario.control_periods:
            self._advance(possible)
            self.period += 1
        if self.period == self.scenario.control_periods:
            self.tick, self.period = self.tick + 1, 0
            self._origin = self.adversary
        return contact

    def _advance(self, acceleration: float) -> FloatArray:
        if self.period == 0:
            self._noise = self._dynamics.draw(self._rng)
        periods = self.scenario.control_periods
        noise = Noise(self._noise.speed / periods, self._noise.acceleration)
        path = self._dynamics.advance(acceleration, self.scenario.time_step / periods, noise)
        self.car = CarState(*path[-1].tolist())
        return path

    def _meet(self, path: FloatArray, velocity: tuple[float, float]) -> tuple[AdversaryState, Contact | None]:
        """Return where the adversary is after a period beside the car's path, and the collision in it; change nothing.

        Args:
            path: path of the car in the period; see `CarDynamics.advance`.
            velocity: velocity of the adversary, (East, North), m/s.

        Returns:
            The state at the end of the period, or of the tick where there is a collision; its fraction is of the tick.
        """
        origin = self._origin if self.period else self.adversary
        period, periods = self.period, self.scenario.control_periods
        heading = 0.0
        if self.scenario.adversary.is_box:
            heading = float(on_grid(self.scenario.adversary.heading(origin.heading, *velocity)))
        step = self.scenario.time_step
        x, y = origin.x + step * velocity[0], origin.y + step * velocity[1]
        fraction, impact = first_contact_of(self.scenario, path, origin, velocity, heading, self.tick, period)
        counts = fraction <= 1.0
        if not counts and period < periods - 1:
            passed = step * (period + 1) / periods
            x, y = origin.x + passed * velocity[0], origin.y + passed * velocity[1]
        if self.scenario.adversary.is_box:
            velocity = velocity_on_grid(*velocity)
        return AdversaryState(x, y, *velocity, heading), Contact(fraction, impact) if counts else None


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


def first_contact_of(
    scenario: Scenario,
    path: FloatArray,
    adversary: RoadUserState,
    velocity: tuple[float, float],
    heading: float,
    tick: int,
    period: int,
) -> tuple[float, float]:
    """Return the car's first contact in a control period with the adversary or one of the others.

    Args:
        scenario: fixed description of the test.
        path: path of the car in the period, see `CarDynamics.advance`.
        adversary: state of the adversary when the tick began.
        velocity: velocity of the adversary over the tick, (East, North), m/s.
        heading: heading of the adversary's box in the tick, rad.
        tick: number of the tick in which the period is.
        period: number of the period in the tick.

    Returns:
        Fraction of the tick, infinity without a contact that counts as a collision, and the car's speed there, m/s.
    """
    car, step, periods = scenario.car, scenario.time_step, scenario.control_periods
    footprint, least = (car.front, car.rear, car.half_width), scenario.collision.minimum_impact_speed
    end = adversary.x + step * velocity[0], adversary.y + step * velocity[1]
    share, speed = sweep(
        path, adversary[:2], end, velocity, heading, footprint, scenario.adversary.shape, step, period, periods
    )
    if not speed >= least:
        share = math.inf
    if scenario.others:
        moves = zip(scenario.others, scenario.others_at(tick), scenario.others_at(tick + 1), strict=True)
        for other, (x, y, *_), after in moves:
            found, impact = sweep(
                path, (x, y), after[:2], after[2:4], after.heading, footprint, other.shape, step, period, periods
            )
            if found < share and impact >= least:
                share, speed = found, impact
    return share, speed


def make_world(episode: EpisodeSpec) -> World:
    """Return the world at the start of an episode, seeded from its specification."""
    return World(
        episode.scenario,
        adversary_start=episode.start,
        gap=episode.start_gap,
        start_rng=generator(episode.seed, episode.episode_id, Role.START),
        car_rng=generator(episode.seed, episode.episode_id, Role.CAR),
    )
