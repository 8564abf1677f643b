"""The clairvoyant kamikaze: what the best kamikaze could have done in an episode, had it known the car's noise.

An episode's draws do not depend on what the adversary does, so there is a colliding action sequence whose discrete
Fréchet distance from φ is least, and one of least deformation. No adversary, however good, comes closer in that
episode: it is a floor under what is measured. This module has the first; the second is the margin
(`skd_evaluator.margin.exact.exact`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from skd_adversary.model.road_user.pedestrian import AS_PHI, action_velocity
from skd_adversary.model.safe_path import path_velocity
from skd_sim.controllers import BasicController
from skd_sim.episode.episode import Episode
from skd_sim.episode.randomness import controller_generator, controller_seed
from skd_sim.errors import UsageError
from skd_sim.geometry.trajectory import Trajectory
from skd_sim.simulation.world import make_world

from skd_evaluator.floor.clairvoyant_lattice import make_lattice
from skd_evaluator.floor.clairvoyant_search import FOUND, FULL, search_floor
from skd_evaluator.floor.clairvoyant_tree import make_tree
from skd_evaluator.margin.exact.course import make_course
from skd_evaluator.margin.ways.foretold import require_foretold
from skd_evaluator.measure.distances.frechet import discrete_frechet

_FIRST_CAPACITY = 1 << 15  # nodes
_LAST_CAPACITY = 1 << 19  # 0.4 GB for 35 points of φ
TOLERANCE = 1e-9
"""m, between a search and the trajectory that the world gives for its actions."""


@dataclass(frozen=True, eq=False)
class ClairvoyantKamikaze:
    """The colliding action sequence of an episode that is nearest to φ.

    Attributes:
        distance: distance of its trajectory from φ, m: discrete Fréchet distance, or deformation.
        actions: one action for each tick, as numbered in `skd_adversary.model.road_user.pedestrian`.
        trajectory: the adversary's positions, up to the place of the first contact.
        duration: time until the contact, ticks.
        gap: the least distance is no more than this below `distance`, m; 0: up to rounding it is `distance`.
    """

    distance: float
    actions: npt.NDArray[np.int64]
    trajectory: Trajectory
    duration: float
    gap: float = 0.0


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
        ValueError: it is not in kamikaze mode, not with the basic controller and the basic car, or not on a straight
            road with a disc.
        UsageError: the search would need too much memory.
    """
    require_foretold(episode)
    course = make_course(episode)
    points = len(course.path)
    upper = math.inf if upper_bound is None else upper_bound * (1.0 + TOLERANCE) + TOLERANCE
    actions = np.empty(episode.scenario.ticks, np.int64)
    capacity = _FIRST_CAPACITY
    while True:
        lattice, tree = make_lattice(points, capacity // 8), make_tree(points, capacity)
        state, distance, length = search_floor(course, lattice, tree, upper, actions)
        if state != FULL:
            break
        if capacity >= _LAST_CAPACITY:
            raise UsageError(
                f"--floor: more than {capacity} states in the search for episode {episode.episode_id}; it is meant for "
                "safe trajectories that end near the car's path"
            )
        capacity *= 4
    if state != FOUND:
        return None
    trajectory, duration = walk(episode, actions[:length])
    assert episode.safe_trajectory is not None
    exact = discrete_frechet(episode.safe_trajectory.positions, trajectory.positions)
    assert abs(exact - distance) <= TOLERANCE, f"world {exact!r}, search {distance!r}"
    return ClairvoyantKamikaze(exact, actions[:length].copy(), trajectory, duration)


def walk(episode: Episode, actions: npt.NDArray[np.int64]) -> tuple[Trajectory, float]:
    """Return the trajectory of a sequence in the episode's own world, and its duration in ticks.

    Its last tick has to collide, and no other: a search that found something else is wrong.
    """
    assert episode.safe_trajectory is not None
    world = make_world(episode)
    controller = BasicController(episode.multiplier)
    controller.reset(episode.scenario, controller_generator(controller_seed(episode.seed, episode.episode_id)))
    walked = [world.adversary[:2]]
    for tick, action in enumerate(actions.tolist()):
        if action == AS_PHI:
            velocity = path_velocity(episode.safe_trajectory.positions, tick, episode.scenario.time_step)
        else:
            velocity = action_velocity(action, episode.scenario.adversary.speed)
        contact = world.step(controller.command(world.car, world.adversary), velocity)
        walked.append(world.adversary[:2])
        ends = tick + 1 == len(actions)
        assert (contact is not None) == ends, f"episode {episode.episode_id}: collision in the world at tick {tick}"
    assert contact is not None
    before, after = np.array(walked[-2]), np.array(walked[-1])
    walked[-1] = tuple(before + contact.fraction * (after - before))
    return Trajectory(np.array(walked), episode.scenario.time_step), len(actions) - 1 + contact.fraction
