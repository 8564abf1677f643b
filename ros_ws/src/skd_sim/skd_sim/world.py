"""The world: advances car and pedestrian by one tick and says whether they touched."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from skd_sim.compilation import kernel
from skd_sim.episode import Episode
from skd_sim.geometry import first_contact, to_car_frame
from skd_sim.motion import draw_relative, next_speed, travelled
from skd_sim.randomness import Role, generator
from skd_sim.scenario import HEADING_NORTH, Scenario
from skd_sim.state import CarState, PedestrianState


class Contact(NamedTuple):
    """First touch within a tick: fraction of the tick at which it happened, and the car's speed there (m/s)."""

    fraction: float
    speed: float


@kernel
def _advance(
    car: CarState,
    pedestrian: PedestrianState,
    acceleration: float,
    vx: float,
    vy: float,
    footprint: tuple[float, float, float, float],
    noise: tuple[float, float],
    time_step: float,
    rng: np.random.Generator,
) -> tuple[float, float, float, float, float, float]:
    """Return (car x, car y, car speed, pedestrian x, pedestrian y, contact fraction or infinity)."""
    front, rear, half_width, radius = footprint
    speed_noise, acceleration_noise = noise
    # Both are drawn at every tick, so that a car that brakes and one that does not use up the same numbers.
    speed_draw = draw_relative(speed_noise, rng)
    acceleration_draw = draw_relative(acceleration_noise, rng)
    applied = acceleration + acceleration_draw * acceleration
    speed = next_speed(car.speed, applied, speed_draw, time_step)
    distance = travelled(car.speed, speed, time_step)
    x = car.x + distance * math.cos(car.heading)
    y = car.y + distance * math.sin(car.heading)
    px = pedestrian.x + time_step * vx
    py = pedestrian.y + time_step * vy
    ahead, left = to_car_frame(pedestrian.x, pedestrian.y, car.x, car.y, car.heading)
    ahead_after, left_after = to_car_frame(px, py, x, y, car.heading)
    contact = first_contact(ahead, left, ahead_after, left_after, front, rear, half_width, radius)
    return x, y, speed, px, py, contact


class World:
    """Ground truth of one episode.

    Attributes:
        car: state of the car now.
        pedestrian: state of the pedestrian now.
        tick: number of steps taken.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        pedestrian_start: tuple[float, float] | None = None,
        gap: float | None = None,
        start_rng: np.random.Generator,
        car_rng: np.random.Generator,
    ) -> None:
        """Place both road users.

        Args:
            scenario: fixed description of the test.
            pedestrian_start: (x, y) in m; the scenario's start by default.
            gap: front bumper to the crossing line before the draw, m; the scenario's by default.
            start_rng: draws the start distance.
            car_rng: draws the car's motion noise.
        """
        car, walker = scenario.car, scenario.pedestrian
        x, y = pedestrian_start if pedestrian_start is not None else (walker.start_x, walker.start_y)
        start_gap = (car.start_gap if gap is None else gap) + car.start_gap_range * start_rng.random()
        self.scenario = scenario
        self.car = CarState(0.0, -start_gap - car.front, HEADING_NORTH, car.start_speed)
        self.pedestrian = PedestrianState(float(x), float(y), 0.0, 0.0)
        self.tick = 0
        self._rng = car_rng
        self._footprint = (car.front, car.rear, car.half_width, walker.radius)
        self._noise = (car.speed_noise, car.acceleration_noise)

    @property
    def time(self) -> float:
        """Simulated time since the start, s."""
        return self.tick * self.scenario.time_step

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Contact | None:
        """Advance by one time step and return the collision in it, if there is one.

        Args:
            acceleration: commanded to the car, m/s².
            velocity: of the pedestrian over the step, (East, North), m/s.
        """
        vx, vy = float(velocity[0]), float(velocity[1])
        before = self.car.speed
        x, y, speed, px, py, fraction = _advance(
            self.car,
            self.pedestrian,
            float(acceleration),
            vx,
            vy,
            self._footprint,
            self._noise,
            self.scenario.time_step,
            self._rng,
        )
        self.car = CarState(x, y, self.car.heading, speed)
        self.pedestrian = PedestrianState(px, py, vx, vy)
        self.tick += 1
        if fraction > 1.0:
            return None
        impact = before + fraction * (speed - before)
        return Contact(fraction, impact) if impact >= self.scenario.collision.minimum_impact_speed else None


def make_world(episode: Episode) -> World:
    """Return the world at the start of an episode, seeded from its specification."""
    return World(
        episode.scenario,
        pedestrian_start=episode.start,
        gap=episode.start_gap,
        start_rng=generator(episode.seed, episode.episode_id, Role.START),
        car_rng=generator(episode.seed, episode.episode_id, Role.CAR),
    )
