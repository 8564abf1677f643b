"""Labelled scans for training and testing: many short episodes of the simulator with varied crossings.

Adversaries start anywhere ahead, on either side, walk at 0.5 to 3 m/s mostly towards the lane, and change their mind
now and then; the car drives anything from 0 to 10 m/s; parked cars beside the lane hide a part of the view.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from skd_sim.encounter.definition import Obstacle
from skd_sim.encounter.road import HEADING_NORTH
from skd_sim.encounter.scenario import Scenario
from skd_sim.geometry.contact import to_car_frame
from skd_sim.hazard.perception import FEATURES, Perception
from skd_sim.hazard.region import MARGIN, MARGIN_TIME, on_collision_course
from skd_sim.sensors.laser import PlanarLaser
from skd_sim.simulation.world import World
from skd_sim.state import AdversaryState

FloatArray = NDArray[np.float64]

TICKS = 16
FASTEST_CAR = 10.0  # m/s
VISIBLE_BEAMS = 3  # that have to reach an adversary for it to count as visible
CLEARANCE = 0.5  # m between an adversary's centre and a parked car: nobody walks through one
MATCH = 0.7  # m from its centre, within which an object is the adversary


@dataclass(frozen=True, eq=False)
class Scenes:
    """Objects seen, with their labels, and the moments that they come from.

    Attributes:
        features: n × FEATURES, one row per object seen.
        labels: n: 1 where the object is an adversary whose course meets the zone with its margin.
        moment: n: index of the scan that the object was seen in.
        course: m: whether the adversary is on a collision course within braking range (no margin).
        hazard: m: the same with the margin, which is what the network is taught.
        visible: m: whether enough beams reach it, in this scan and in the last: its velocity can be seen.
    """

    features: FloatArray
    labels: FloatArray
    moment: NDArray[np.int64]
    course: NDArray[np.bool_]
    hazard: NDArray[np.bool_]
    visible: NDArray[np.bool_]


def _walk(x: float, rng: np.random.Generator) -> tuple[float, float]:
    """Draw a velocity, m/s: to stand, or to walk, mostly across the road from the side that x is on."""
    if rng.random() < 0.2:
        return 0.0, 0.0
    speed = rng.uniform(0.5, 3.0)
    across = math.pi if x > 0.0 else 0.0
    direction = across + rng.normal(0.0, 0.6) if rng.random() < 0.8 else rng.uniform(-math.pi, math.pi)
    return speed * math.cos(direction), speed * math.sin(direction)


def _parked(rng: np.random.Generator) -> tuple[Obstacle, ...]:
    if rng.random() < 0.7:
        return ()
    cars = []
    for _ in range(rng.integers(1, 4)):
        side = -1.0 if rng.random() < 0.5 else 1.0
        cars.append(Obstacle(side * rng.uniform(2.6, 4.5), rng.uniform(-12.0, 8.0), HEADING_NORTH, 4.3, 1.8))
    return tuple(cars)


def _clear(x: float, y: float, parked: tuple[Obstacle, ...]) -> bool:
    """Return whether an adversary at (x, y), m, keeps off the parked cars."""
    return all(
        abs(x - car.x) > 0.5 * car.width + CLEARANCE or abs(y - car.y) > 0.5 * car.length + CLEARANCE for car in parked
    )


def _start(parked: tuple[Obstacle, ...], rng: np.random.Generator) -> tuple[float, float]:
    """Draw where the adversary starts."""
    while True:
        x, y = rng.uniform(-6.0, 6.0), rng.uniform(-4.0, 4.0)
        if _clear(x, y, parked):
            return float(x), float(y)


class _Collector:
    def __init__(self) -> None:
        self.features: list[FloatArray] = []
        self.labels: list[float] = []
        self.moment: list[int] = []
        self.course: list[bool] = []
        self.hazard: list[bool] = []
        self.visible: list[bool] = []

    def add(self, scenario: Scenario, world: World, perception: Perception, visible: bool) -> None:
        """Label what is seen now."""
        car, adversary = world.car, world.adversary
        front, half_width, radius = scenario.car.front, scenario.car.half_width, scenario.adversary.reach
        ahead, left = to_car_frame(adversary.x, adversary.y, car.x, car.y, car.heading)
        va, vl = to_car_frame(adversary.vx, adversary.vy, 0.0, 0.0, car.heading)
        state = (ahead - front, left, va, vl, car.speed, half_width, radius, scenario.car.deceleration)
        hazard = bool(on_collision_course(*state, MARGIN, MARGIN_TIME))
        objects = perception.objects
        distances = np.hypot(objects[:, 0] - state[0], objects[:, 1] - left)
        nearest = int(distances.argmin()) if len(distances) and distances.min() < MATCH else -1
        self.features.append(perception.features(car.speed))
        self.labels += [float(hazard and index == nearest) for index in range(len(objects))]
        self.moment += [len(self.course)] * len(objects)
        self.course.append(bool(on_collision_course(*state, 0.0, 0.0)))
        self.hazard.append(hazard)
        self.visible.append(visible)

    def scenes(self) -> Scenes:
        """Return what was collected."""
        features = np.concatenate(self.features) if self.features else np.empty((0, FEATURES))
        return Scenes(
            features,
            np.array(self.labels),
            np.array(self.moment, dtype=np.int64),
            np.array(self.course),
            np.array(self.hazard),
            np.array(self.visible),
        )


def _count_beams(laser: PlanarLaser, world: World) -> int:
    """Return how many beams of a perfect scanner end on the adversary."""
    nowhere = AdversaryState(1e6, 1e6, 0.0, 0.0)
    seen = laser.true_ranges(world.car, world.adversary)
    without = laser.true_ranges(world.car, nowhere)
    return int(np.count_nonzero(seen < without))


def generate_scenes(scenario: Scenario, episodes: range, seed: int) -> Scenes:
    """Run episodes of varied crossings and return what the scanner saw in them, labelled.

    Args:
        scenario: scenario from which footprints, sensor and time step are taken.
        episodes: numbers of the episodes, which with the seed determine all that is drawn.
        seed: seed of every random draw.
    """
    collector = _Collector()
    for episode in episodes:
        rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(episode,))))
        parked = _parked(rng)
        car = replace(scenario.car, start_speed=float(rng.uniform(0.0, FASTEST_CAR)))
        varied = replace(scenario, car=car, obstacles=parked)
        start = _start(parked, rng)
        world = World(varied, adversary_start=start, gap=float(rng.uniform(2.0, 30.0)), start_rng=rng, car_rng=rng)
        laser = PlanarLaser(varied, seed, episode)
        perception = Perception(varied)
        velocity, acceleration, seen_before = _walk(start[0], rng), 0.0, False
        for tick in range(TICKS):
            perception.update(laser.scan(world.car, world.adversary, tick), world.car)
            seen = _count_beams(laser, world) >= VISIBLE_BEAMS
            collector.add(varied, world, perception, seen and (seen_before or tick == 0))
            seen_before = seen
            if rng.random() < 0.15:
                velocity = _walk(world.adversary.x, rng)
            if rng.random() < 0.3:
                acceleration = float(rng.choice((-varied.car.deceleration, 0.0, 2.0)))
            if world.car.speed > FASTEST_CAR:
                acceleration = min(0.0, acceleration)
            behind = world.adversary.y < world.car.y + varied.car.front - 1.0
            touched = world.step(acceleration, velocity) is not None
            if touched or behind or not _clear(world.adversary.x, world.adversary.y, parked):
                break
    return collector.scenes()
