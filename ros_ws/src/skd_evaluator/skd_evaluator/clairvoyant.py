"""The clairvoyant kamikaze: what the best kamikaze could have done in an episode, had it known the car's noise.

An episode's draws do not depend on what the pedestrian does, so there is a colliding action sequence whose discrete
Fréchet distance from φ is least. No adversary, however good, comes closer in that episode: it is a floor under SKD.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from skd_adversary.crossing import action_velocity
from skd_sim.controllers import BasicController
from skd_sim.episode import Episode, Mode
from skd_sim.randomness import Role, generator
from skd_sim.trajectory import Trajectory
from skd_sim.world import make_world

from skd_evaluator.clairvoyant_search import FOUND, FULL, Course, search_floor, workspace
from skd_evaluator.frechet import discrete_frechet

_FIRST_CAPACITY = 1 << 15  # nodes
_LAST_CAPACITY = 1 << 24
_TOLERANCE = 1e-9  # m, between the search and the trajectory that the world gives for its actions


@dataclass(frozen=True, eq=False)
class ClairvoyantKamikaze:
    """The colliding action sequence of an episode that is nearest to φ.

    Attributes:
        distance: discrete Fréchet distance of its trajectory from φ, m.
        actions: one per tick, as numbered in `skd_adversary.crossing`.
        trajectory: the pedestrian's positions, to the end of the tick of the collision.
    """

    distance: float
    actions: npt.NDArray[np.int64]
    trajectory: Trajectory


def clairvoyant_floor(episode: Episode, upper_bound: float | None = None) -> ClairvoyantKamikaze | None:
    """Return the nearest colliding action sequence under an episode's draws.

    Args:
        episode: kamikaze mode, basic controller.
        upper_bound: a distance (m) that some colliding sequence is known to have, as that of the episode's own
            kamikaze; it makes the search quicker and does not change the result.

    Returns:
        The nearest sequence; None where no sequence collides within the horizon (or, with `upper_bound`, none that
        near).

    Raises:
        ValueError: the episode is not in kamikaze mode, or not with the basic controller.
    """
    if episode.controller != "basic":
        raise ValueError(f"what controller {episode.controller} answers to other actions is not known")
    if episode.mode != Mode.KAMIKAZE or episode.safe_trajectory is None:
        raise ValueError(f"only a kamikaze episode has a floor, not mode {episode.mode.name}")
    course = _course(episode)
    upper = math.inf if upper_bound is None else upper_bound * (1.0 + _TOLERANCE) + _TOLERANCE
    actions = np.empty(episode.scenario.ticks, np.int64)
    capacity = _FIRST_CAPACITY
    while True:
        state, distance, length = search_floor(course, workspace(len(course.path), capacity), upper, actions)
        if state != FULL:
            break
        if capacity >= _LAST_CAPACITY:
            raise MemoryError(
                f"more than {capacity} states in the search for the floor of episode {episode.episode_id}"
            )
        capacity *= 4
    if state != FOUND:
        return None
    trajectory = _walk(episode, actions[:length])
    assert trajectory is not None, f"the world sees no collision in the search's sequence of {episode.episode_id}"
    exact = discrete_frechet(episode.safe_trajectory.positions, trajectory.positions)
    assert abs(exact - distance) <= _TOLERANCE, f"world {exact!r}, search {distance!r}"
    return ClairvoyantKamikaze(exact, actions[:length].copy(), trajectory)


def _course(episode: Episode) -> Course:
    """Return an episode in numbers, the car's noise of every tick included."""
    scenario, world = episode.scenario, make_world(episode)
    car, walker, ticks = scenario.car, scenario.pedestrian, scenario.ticks
    assert episode.safe_trajectory is not None
    # The world draws two numbers a tick, for the speed and for the acceleration, whatever happens.
    draws = generator(episode.seed, episode.episode_id, Role.CAR).random((ticks, 2))
    noise = (2.0 * draws - 1.0) * np.array([car.speed_noise, car.acceleration_noise])
    slowest = np.ones(ticks + 1)
    for tick in range(ticks - 1, -1, -1):
        slowest[tick] = min(1.0, (1.0 + noise[tick, 0]) * slowest[tick + 1])
    return Course(
        path=np.array(episode.safe_trajectory.positions, order="C"),
        noise=noise,
        slowest=slowest,
        car_x=world.car.x,
        car_y=world.car.y,
        car_speed=world.car.speed,
        cos_heading=math.cos(world.car.heading),
        sin_heading=math.sin(world.car.heading),
        front=car.front,
        rear=car.rear,
        half_width=car.half_width,
        radius=walker.radius,
        trigger=episode.multiplier * car.safe_distance,
        deceleration=car.deceleration,
        time_step=scenario.time_step,
        pedestrian_speed=walker.speed,
        path_edge=scenario.path_edge,
        minimum_impact_speed=scenario.collision.minimum_impact_speed,
    )


def _walk(episode: Episode, actions: npt.NDArray[np.int64]) -> Trajectory | None:
    """Return the trajectory of a sequence in the episode's world; None unless its last tick collides, and no other."""
    world = make_world(episode)
    controller = BasicController(episode.multiplier)
    controller.reset(episode.scenario, generator(episode.seed, episode.episode_id, Role.CONTROLLER))
    walked = [world.pedestrian[:2]]
    for number, action in enumerate(actions.tolist(), start=1):
        velocity = action_velocity(action, episode.scenario.pedestrian.speed)
        contact = world.step(controller.command(world.car, world.pedestrian), velocity)
        walked.append(world.pedestrian[:2])
        if (contact is not None) != (number == len(actions)):
            return None
    return Trajectory(np.array(walked), episode.scenario.time_step)
