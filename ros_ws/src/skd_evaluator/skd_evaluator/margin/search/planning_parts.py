"""What a plan is made from: the attempt's course, a view of the picture of the controller, and room to work in."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from skd_sim.arrays import FloatArray, IntArray

NEAREST, CAUTIOUS, VARIED, BOLD = range(4)
"""How the picture is asked: the nearest sample; nothing known beyond a radius, so the car goes on unbraked; the nearest
by the weights that tell most; by other weights and another radius, and beyond it an acceleration that is given."""
COLUMNS: Final = 9
"""Numbers of a moment: x, y, velocity to the East and North, heading, path coordinate, speed and last acceleration of
the car, what was strayed."""
FAILURES: Final = 5
"""Numbers of a contact that was planned and was none: tick, x, y, path coordinate of the car, way."""


class Course(NamedTuple):
    """What of an attempt is known beforehand.

    Attributes:
        phi: φ, n × 2, m.
        phi_road: the same as offset to the right and path coordinate, n × 2, m.
        velocities: velocities of the ways, ticks × ways × 2, m/s; nan: the same as that of another way.
        noise: relative noise of speed and acceleration, ticks × 2.
        unbraked: speed after so many ticks without a command, and way until then, s, both per speed at first, (ticks +
            1) × 2.
        line: centre line of the road.
        footprint: front, rear and half width of the car, m.
        shape: shape of the adversary: radius, half length and half width, m.
        ticks: number of ticks of the episode.
        time_step: duration of a tick, s.
        fastest: greatest speed of the adversary, m/s.
        loss: bounds of the region from which the adversary cannot meet the car any more, m.
        least_impact: speed of the car from which on a touch ends the way, m/s.
        hit_speed: speed of the car from which on a touch is a hit, m/s.
        within_ticks: whether the car decides more often than once a tick.
        obstacles: parked rectangles, as `Scenario.rectangles` returns them.
        core: radius of the adversary's body where obstacles count, m.
    """

    phi: FloatArray
    phi_road: FloatArray
    velocities: FloatArray
    noise: FloatArray
    unbraked: FloatArray
    line: FloatArray
    footprint: tuple[float, float, float]
    shape: tuple[float, float, float]
    ticks: int
    time_step: float
    fastest: float
    loss: tuple[float, float, float, float]
    least_impact: float
    hit_speed: float
    within_ticks: bool
    obstacles: FloatArray
    core: float


class View(NamedTuple):
    """How the picture is asked.

    Attributes:
        samples: samples of the controller in the order of their gaps, at least `count` × 7.
        known: how many of the samples count.
        weights: weights of a situation's 6 numbers.
        mode: how the picture is asked: one of NEAREST, CAUTIOUS, VARIED and BOLD.
        radius: distance, among samples, beyond which nothing is known.
        unknown: acceleration where nothing is known, m/s².
        hardest: strongest braking of which the car is believed capable, m/s², below 0.
        strongest: greatest acceleration of which the car is believed capable, m/s².
        cruise: speed above which it does not speed up, m/s.
    """

    samples: FloatArray
    known: int
    weights: FloatArray
    mode: int
    radius: float
    unknown: float
    hardest: float
    strongest: float
    cruise: float


class Room(NamedTuple):
    """Arrays to work in.

    Attributes:
        states: numbers of each planned moment, capacity × COLUMNS.
        bounds: bound of each entry, m; as long as the capacity.
        links: capacity × 4: tick, parent (before −1: −2 − number of the simulated moment), way, next of its bucket.
        keys: table of the cells.
        least: least deformation in each cell, m.
    """

    states: FloatArray
    bounds: FloatArray
    links: IntArray
    keys: npt.NDArray[np.uint64]
    least: FloatArray


def make_room(capacity: int) -> Room:
    """Return arrays for so many moments; their number is made a power of two."""
    size = 1 << (capacity - 1).bit_length()
    return Room(
        np.empty((size, COLUMNS)),
        np.empty(size),
        np.empty((size, 4), np.int64),
        np.zeros(2 * size, np.uint64),
        np.empty(2 * size),
    )
