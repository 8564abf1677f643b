"""The exact margin of the basic car: the least deviation with which anybody could have been hit in a trial.

A trial's draws do not depend on what the adversary does, and what the basic car answers to every sequence of ways is
known. The search is over all of them. If it runs out of memory, which happens where all steps of φ differ,
`LeastWay.gap` says how far the result may be from the least.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from skd_sim.controllers import BasicController
from skd_sim.errors import UsageError
from skd_sim.world.episode import Episode, controller_generator, controller_seed
from skd_sim.world.state import Trajectory
from skd_sim.world.world import Contact, make_world

from skd_evaluator.margin.actions import FIRST_HALF, WAY_COUNT, require_exact, way_velocity
from skd_evaluator.margin.exact.course import make_course
from skd_evaluator.margin.exact.exact_search import CROWDED, FOUND, FULL, make_nodes, search_least_way
from skd_evaluator.margin.exact.reachability import make_reachability
from skd_evaluator.metrics.distances.deviation import deviation
from skd_evaluator.metrics.distances.least_way import LeastWay

_EFFORTS = ((1 << 10, 1 << 12, False), (1 << 13, 1 << 16, True), (1 << 17, 1 << 18, True))
"""Tried one after the other until one has room: histories, nodes, and whether a gap will do."""
TOLERANCE = 1e-9
"""m, between a search and the trajectory that the world gives for its ways."""


def exact_margin(episode: Episode, upper_bound: float | None = None, *, half_speed: bool = True) -> LeastWay | None:
    """Return the way of least deviation that ends in a hit, under an episode's draws.

    A hit is a contact at `collision.hit_speed` or more of the car's own speed. A slower one that the world counts ends
    a way without a hit; one below `collision.minimum_impact_speed` does not end it.

    Args:
        episode: kamikaze mode, basic controller, basic car, pedestrian; its objective does not matter.
        upper_bound: only ways of at most this deviation (m) are looked for; the scenario's `eta_max` by default.
        half_speed: whether directions at half speed are among the ways; without, it is no margin, for comparison.

    Returns:
        The way; None where there is none within the bound and the horizon, or, where there was no room for all, none
        was found: then the least, if there is one, is just below the bound.

    Raises:
        ValueError: the episode is none of those that are predictable.
        UsageError: the search would need too much memory.
    """
    require_exact(episode)
    course = make_course(episode, WAY_COUNT if half_speed else FIRST_HALF)
    ticks = episode.scenario.ticks
    upper = (episode.scenario.eta_max if upper_bound is None else upper_bound) * (1.0 + TOLERANCE) + TOLERANCE
    ways = np.empty(ticks, np.int64)
    for histories, nodes, loose in _EFFORTS:
        reachability = make_reachability(histories, ticks)
        state, distance, gap, length = search_least_way(course, reachability, make_nodes(nodes), upper, loose, ways)
        if state not in (FULL, CROWDED):
            break
    if state == CROWDED:
        raise UsageError(f"margin: more than {histories} histories of the car in episode {episode.episode_id}")
    if state != FOUND:
        return None
    trajectory, duration, contact = _walk(episode, ways[:length])
    assert episode.safe_trajectory is not None
    exact = deviation(episode.safe_trajectory.positions, trajectory.positions, duration)
    assert abs(exact - distance) <= TOLERANCE, f"world {exact!r}, search {distance!r}"
    return LeastWay(exact, trajectory, duration, contact.speed, gap)


def _walk(episode: Episode, ways: npt.NDArray[np.int64]) -> tuple[Trajectory, float, Contact]:
    """Return the trajectory of ways in the episode's own world, its duration in ticks, and the contact at its end.

    The last tick has to end in a hit, and none before in a collision: a search that found something else is wrong.
    """
    assert episode.safe_trajectory is not None
    scenario, path = episode.scenario, episode.safe_trajectory.positions
    world = make_world(episode)
    controller = BasicController(episode.multiplier)
    controller.reset(scenario, controller_generator(controller_seed(episode.seed, episode.episode_id)))
    walked = [world.adversary[:2]]
    contact = None
    for tick, way in enumerate(ways.tolist()):
        assert contact is None, f"episode {episode.episode_id}: collision in the world before tick {tick}"
        velocity = way_velocity(way, path, tick, scenario.time_step, scenario.adversary.speed)
        contact = world.step(controller.command(world.car, world.adversary), velocity)
        walked.append(world.adversary[:2])
    assert contact is not None, f"episode {episode.episode_id}: no collision in the world"
    assert scenario.collision.is_hit(contact.speed), f"episode {episode.episode_id}: no hit at {contact.speed!r} m/s"
    before, after = np.array(walked[-2]), np.array(walked[-1])
    walked[-1] = tuple(before + contact.fraction * (after - before))
    return Trajectory(np.array(walked), scenario.time_step), len(ways) - 1 + contact.fraction, contact
