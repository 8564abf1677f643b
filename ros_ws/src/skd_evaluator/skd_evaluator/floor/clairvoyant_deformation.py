"""The clairvoyant kamikaze by deformation: how far, at least, one has to be from where φ is to be hit in an episode.

As `clairvoyant`, for the distance in space and time, and over seven actions: the six of the crossing, and *as φ*.

Where the steps of φ are among the six, sequences meet and the least is found exactly. Every step of a recorded φ is
another: then millions of sequences come to as many places within millimetres of each other, and where that is too many
the search leaves out what could only be better by a tolerance, which `ClairvoyantKamikaze.gap` gives.
"""

from __future__ import annotations

import math

import numpy as np
from skd_sim.episode import Episode
from skd_sim.errors import UsageError

from skd_evaluator.floor.clairvoyant import TOLERANCE, ClairvoyantKamikaze, require_foretold, walk
from skd_evaluator.floor.clairvoyant_course import make_course
from skd_evaluator.floor.clairvoyant_deformation_search import (
    FOUND,
    FULL,
    keys_as_phi,
    make_queue,
    search_least_deformation,
)
from skd_evaluator.floor.clairvoyant_foresight import make_foresight
from skd_evaluator.measure.deformation import deformation

_EFFORTS = (
    (1 << 14, 0, 0.0, False),
    (1 << 16, 64, 0.0, False),
    (1 << 17, 64, 1e-3, False),
    (1 << 17, 64, 1e-2, False),
    (1 << 17, 64, 0.1, False),
    (1 << 17, 32, 0.5, True),
)
"""Tried one after the other until one has room: nodes, cells of the chart along an axis, tolerance in m, and whether a
greater gap will do."""
_EFFORTS_WHERE_ALL_MEET = (
    (1 << 14, 0, 0.0, False),
    (1 << 17, 0, 0.0, False),
    (1 << 20, 0, 0.0, False),
    *_EFFORTS[2:],
)
"""The same for φ whose every step is one of the other actions."""


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
    for capacity, cells, tolerance, loose in _EFFORTS if keys_as_phi(course).any() else _EFFORTS_WHERE_ALL_MEET:
        foresight, queue = make_foresight(capacity), make_queue(capacity)
        state, distance, gap, length = search_least_deformation(
            course, foresight, queue, upper, cells, tolerance, loose, actions
        )
        if state != FULL:
            break
    else:
        raise UsageError(f"--floor: more than {capacity} states in the search for episode {episode.episode_id}")
    if state != FOUND:
        return None
    trajectory, duration = walk(episode, actions[:length])
    assert episode.safe_trajectory is not None
    exact = deformation(episode.safe_trajectory.positions, trajectory.positions, duration)
    assert abs(exact - distance) <= TOLERANCE, f"world {exact!r}, search {distance!r}"
    return ClairvoyantKamikaze(exact, actions[:length].copy(), trajectory, duration, gap)
