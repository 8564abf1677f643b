"""Cars that are simple to foresee, and cars that are hard to copy; φ and episodes for both."""

from __future__ import annotations

import copy
import math
import random
import threading
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from skd_adversary.adversary import car_model_for
from skd_adversary.itself.adversary import ItselfAdversary
from skd_sim.choices.knowledge import Knowledge
from skd_sim.choices.objective import Objective
from skd_sim.controllers import Controller
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.episode.randomness import Role, generator
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.simulation.world import World, make_world
from skd_sim.state import AdversaryState, CarState

CROSSING = load_scenario("crossing")
FAST = replace(CROSSING, control_period=0.05)
BENT = [(-3.5, 0.0), (-2.75, 0.0), (-2.2, 0.5), (-1.7, 0.6), (-0.9, 0.5), (0.1, 0.0), (0.9, -0.1), (2.4, 0.0)]
STRAIGHT = [(-3.5 + 0.75 * tick, 0.0) for tick in range(9)]
FEW = 6000


class Brakes:
    """Brakes for anybody in or near its lane within some distance."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Be as new."""
        self._rng = rng
        self._hold = 0

    def wants(self, car: CarState, adversary: AdversaryState) -> bool:
        """Whether it would brake now."""
        ahead = adversary.y - car.y - 2.25
        return 0.0 < ahead < 9.0 and abs(adversary.x) < 1.6

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Go on braking for a while."""
        self._hold = 4 if self.wants(car, adversary) else max(0, self._hold - 1)
        return -4.0 if self._hold else 0.0


class Moody(Brakes):
    """Draws its distance at reset, and how hard it brakes each time."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Draw the distance."""
        super().reset(scenario, rng)
        self.distance = 4.0 + 10.0 * rng.random()

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Draw the brake."""
        ahead = adversary.y - car.y - 2.25
        return -6.0 * self._rng.random() if 0.0 < ahead < self.distance else 0.0


class Locked(Brakes):
    """Holds what cannot be copied."""

    def __init__(self) -> None:
        self._lock = threading.Lock()


class Latched(Brakes):
    """All its copies brake as soon as one has braked."""

    braking: ClassVar[bool] = False

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Let the class forget."""
        super().reset(scenario, rng)
        Latched.braking = False

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Remember it in the class."""
        Latched.braking = Latched.braking or self.wants(car, adversary)
        return -4.0 if Latched.braking else 0.0


class Enclosed(Brakes):
    """Keeps what it remembers in a function, which copies share."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Remember nothing."""
        super().reset(scenario, rng)
        held = [0]

        def hold(wanted: bool) -> bool:
            held[0] = 4 if wanted else max(0, held[0] - 1)
            return held[0] > 0

        self._holds = hold

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Ask the function."""
        return -4.0 if self._holds(self.wants(car, adversary)) else 0.0


class Forgetful(Brakes):
    """Its copies forget how long it has been driving."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Begin to count."""
        super().reset(scenario, rng)
        self._count = 0

    def __deepcopy__(self, memo: dict[int, Any]) -> Forgetful:
        made = Forgetful()
        made._rng, made._hold, made._count = copy.deepcopy(self._rng, memo), self._hold, 0
        return made

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Slow down after a second."""
        self._count += 1
        return -1.0 if self._count > 3 else 0.0


class Global(Brakes):
    """Draws from a generator that everybody has."""

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Draw the brake."""
        return -random.random()


def an_episode(
    points: Sequence[tuple[float, float]] = BENT, number: int = 0, scenario: Scenario = CROSSING, **fields: Any
) -> Episode:
    """A kamikaze episode with knowledge itself."""
    settings = {
        "objective": Objective.DEFORMATION,
        "knowledge": Knowledge.ITSELF,
        "told": True,
        "controller_calls": FEW,
        **fields,
    }
    phi = Trajectory(np.array(points), scenario.time_step)
    return Episode(scenario, Mode.KAMIKAZE, 3, number, safe_trajectory=phi, **settings)


def ready(controller: Controller, episode: Episode, seed: int | None = None) -> Controller:
    """A controller that has been reset, with draws of the episode or of a seed."""
    rng = generator(episode.seed, episode.episode_id, Role.CONTROLLER)
    controller.reset(episode.scenario, rng if seed is None else np.random.default_rng(seed))
    return controller


def an_adversary(episode: Episode, controller: Controller, world: World | None = None) -> ItselfAdversary:
    """The adversary of an episode that meets a controller, told the state if it is shown the world."""
    return ItselfAdversary(
        episode, controller, car_model_for(episode.car), told=world, calls=episode.controller_calls or 0
    )


def a_world(episode: Episode, seed: int | None = None) -> World:
    """The world of an episode, with the car's noise of another seed if one is given."""
    world = make_world(episode)
    if seed is not None:
        world._rng = np.random.default_rng(seed)
    return world


def velocities(adversary: ItselfAdversary, cars: Sequence[CarState]) -> list[tuple[float, float]]:
    """What it does as it meets a car at these states."""
    return [adversary.act(car) for car in cars]


def coming(episode: Episode, ticks: int = 6) -> list[CarState]:
    """States of a car that comes and brakes a little, at the ticks."""
    start = make_world(episode).car
    speeds = [start.speed - 0.6 * tick for tick in range(ticks)]
    places = start.y + np.concatenate([[0.0], np.cumsum(0.3 * np.array(speeds[:-1]))])
    return [CarState(start.x, float(y), start.heading, v) for y, v in zip(places, speeds, strict=True)]


def is_hit(log: EpisodeLog) -> bool:
    """Whether the moving car hit."""
    return log.outcome == Outcome.COLLISION and log.impact_speed >= log.episode.scenario.collision.hit_speed


def headings(log: EpisodeLog) -> tuple[list[float], list[float]]:
    """Speed (m/s) and direction (rad) of the adversary in each tick."""
    steps = np.diff(log.adversary, axis=0) / log.episode.scenario.time_step
    return [math.hypot(*step) for step in steps], [math.atan2(step[1], step[0]) for step in steps]
