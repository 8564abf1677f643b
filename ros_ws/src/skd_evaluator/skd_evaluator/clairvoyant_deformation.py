"""The clairvoyant kamikaze by deformation: how far, at least, one has to be from where φ is to be hit in an episode.

As `clairvoyant`, for the distance in space and time, and over seven actions: the six of the crossing, and *as φ*.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.episode import Episode
from skd_sim.errors import UsageError

from skd_evaluator.clairvoyant import TOLERANCE, ClairvoyantKamikaze, require_foretold, walk
from skd_evaluator.clairvoyant_course import make_course
from skd_evaluator.clairvoyant_deformation_search import FOUND, FULL, make_queue, search_least_deformation
from skd_evaluator.clairvoyant_foresight import make_foresight
from skd_evaluator.deformation import deformation

_FIRST_CAPACITY = 1 << 14  # nodes
_LAST_CAPACITY = 1 << 24  # 1.5 GB


def deformation_floor(episode: Episode, upper_bound: float | None = None) -> ClairvoyantKamikaze | None:
    """Return the colliding action sequence of least deformation under an episode's draws.

    Args:
        episode: kamikaze mode, basic controller, basic car; its objective does not matter.
        upper_bound: only a sequence of at most this deformation (m) is looked for: that of a kamikaze known to have
            collided, or the largest one of interest. It makes the search quicker.

    Returns:
        The sequence; None where none collides within the horizon and the bound.

    Raises:
        ValueError: the episode is not in kamikaze mode, or not with the basic controller and the basic car.
        UsageError: the search would need too much memory.
    """
    require_foretold(episode)
    course = make_course(episode)
    upper = math.inf if upper_bound is None else upper_bound * (1.0 + TOLERANCE) + TOLERANCE
    actions = np.empty(episode.scenario.ticks, np.int64)
    capacity = _FIRST_CAPACITY
    while True:
        foresight, queue = make_foresight(capacity), make_queue(capacity)
        state, distance, length = search_least_deformation(course, foresight, queue, upper, actions)
        if state != FULL:
            break
        if capacity >= _LAST_CAPACITY:
            raise UsageError(f"--floor: more than {capacity} states in the search for episode {episode.episode_id}")
        capacity *= 4
    if state != FOUND:
        return None
    trajectory, duration = walk(episode, actions[:length])
    assert episode.safe_trajectory is not None
    exact = deformation(episode.safe_trajectory.positions, trajectory.positions, duration)
    assert abs(exact - distance) <= TOLERANCE, f"world {exact!r}, search {distance!r}"
    return ClairvoyantKamikaze(exact, actions[:length].copy(), trajectory, duration)
