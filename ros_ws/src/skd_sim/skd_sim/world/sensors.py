"""Sensors of the car: a planar laser scanner (ray casting, range noise, dropouts) and an inertial unit.

The laser sees the adversary, the others and the parked obstacles of the scenario, discs or boxes, and not the car that
carries it. A beam that hits nothing within the maximum range, or is lost, reads +inf (REP 117). Without ROS.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import NO_CONTACT, slab, to_car_frame
from skd_sim.world.episode import EpisodeSpec, Role, generator
from skd_sim.world.state import AdversaryState, CarState, FloatArray, RoadUserState, Triple

FloatRanges = NDArray[np.float32]


class Scan(NamedTuple):
    """Ranges by bearing, in the frame of the sensor (x ahead, y left); as single precision as on the wire.

    Attributes:
        ranges: range of each beam, m; +inf where nothing came back (REP 117).
        angle_min: bearing of the first beam, rad, counter-clockwise from straight ahead.
        angle_increment: angle between neighbouring beams, rad.
        range_max: greatest range that is measured, m.
    """

    ranges: FloatRanges
    angle_min: float
    angle_increment: float
    range_max: float

    def points(self) -> FloatRanges:
        """Return where something came back: n × 3, m, in the frame of the sensor, in its plane (z = 0)."""
        hit = np.flatnonzero(np.isfinite(self.ranges))
        bearings = self.angle_min + hit * self.angle_increment
        found = np.zeros((len(hit), 3), np.float32)
        found[:, 0] = self.ranges[hit] * np.cos(bearings)
        found[:, 1] = self.ranges[hit] * np.sin(bearings)
        return found


STANDARD_GRAVITY = 9.80665  # m/s²


class Inertia(NamedTuple):
    """What is measured, in the frame of the car (x ahead, y left, z up).

    Attributes:
        heading: heading of the car in the world, counter-clockwise from East, rad (REP 103).
        yaw_rate: rate at which the heading changes, rad/s.
        acceleration: proper acceleration, m/s²: standing still it is gravity's, upwards (REP 145).
    """

    heading: float
    yaw_rate: float
    acceleration: Triple


class InertialUnit:
    """Tells accelerations from one state to the next, as means over the time in between."""

    def __init__(self) -> None:
        """Begin an episode: at its first state only the heading is known."""
        self._newest: tuple[int, CarState] | None = None
        self._measured = Inertia(0.0, 0.0, (0.0, 0.0, STANDARD_GRAVITY))

    def measure(self, car: CarState, stamp: int) -> Inertia:
        """Return what is measured at a state; for one that was seen already, the same again.

        Args:
            car: true state of the car.
            stamp: time stamp of the state, ns; never before those of earlier calls.
        """
        if self._newest is None:
            self._measured = Inertia(car.heading, 0.0, (0.0, 0.0, STANDARD_GRAVITY))
        elif stamp > self._newest[0]:
            before = self._newest[1]
            seconds = (stamp - self._newest[0]) * 1e-9
            turned = math.remainder(car.heading - before.heading, 2.0 * math.pi)
            yaw_rate = turned / seconds
            # Speed is along the heading, so the acceleration to the side is that of turning.
            ahead, left = (car.speed - before.speed) / seconds, 0.5 * (car.speed + before.speed) * yaw_rate
            self._measured = Inertia(car.heading, yaw_rate, (ahead, left, STANDARD_GRAVITY))
        self._newest = stamp, car
        return self._measured


@kernel
def disc_range(x: float, y: float, radius: float, cos: float, sin: float) -> float:
    """Return the distance (m) along a ray from the origin to a disc, 0 from inside, else infinity.

    Args:
        x: x of the disc's centre, m.
        y: y of the disc's centre, m.
        radius: radius of the disc, m.
        cos: cosine of the ray's bearing.
        sin: sine of the ray's bearing.
    """
    off_axis = cos * y - sin * x
    along = cos * x + sin * y
    half_chord_squared = radius * radius - off_axis * off_axis
    if half_chord_squared < 0.0:
        return NO_CONTACT
    half_chord = math.sqrt(half_chord_squared)
    if along + half_chord < 0.0:
        return NO_CONTACT
    return max(0.0, along - half_chord)


@kernel
def rectangle_range(
    x: float, y: float, heading: float, half_length: float, half_width: float, cos: float, sin: float
) -> float:
    """Return the distance (m) along a ray from the origin to an oriented rectangle, 0 from inside, else infinity.

    Args:
        x: x of the rectangle's centre, m.
        y: y of the rectangle's centre, m.
        heading: direction of its length, rad.
        half_length: half length of the rectangle, m.
        half_width: half width of the rectangle, m.
        cos: cosine of the ray's bearing.
        sin: sine of the ray's bearing.
    """
    ahead, left = to_car_frame(0.0, 0.0, x, y, heading)
    along, across = to_car_frame(cos, sin, 0.0, 0.0, heading)
    ahead_in, ahead_out = slab(ahead, along, -half_length, half_length)
    left_in, left_out = slab(left, across, -half_width, half_width)
    enter, leave = max(0.0, ahead_in, left_in), min(ahead_out, left_out)
    return enter if enter <= leave else NO_CONTACT


@kernel
def cast_beams(
    origin: Triple, fan: tuple[float, float, int], discs: FloatArray, rectangles: FloatArray, maximum_range: float
) -> FloatArray:
    """Return the true range of each beam, m; infinity where it hits nothing within the maximum range.

    Args:
        origin: position (m) and heading (rad) of the sensor, world frame.
        fan: bearing of the first beam (rad), increment (rad), number of beams.
        discs: n × 3: centre (m) and radius (m), world frame.
        rectangles: m × 5: centre (m), heading (rad), half length, half width (m), world frame.
        maximum_range: greatest range of the laser, m.
    """
    x, y, heading = origin
    first, increment, beams = fan
    ranges = np.empty(beams)
    for beam in range(beams):
        bearing = heading + first + beam * increment
        cos, sin = math.cos(bearing), math.sin(bearing)
        nearest = NO_CONTACT
        for disc in discs:
            nearest = min(nearest, disc_range(disc[0] - x, disc[1] - y, disc[2], cos, sin))
        for row in rectangles:
            nearest = min(nearest, rectangle_range(row[0] - x, row[1] - y, row[2], row[3], row[4], cos, sin))
        ranges[beam] = nearest if nearest <= maximum_range else NO_CONTACT
    return ranges


@kernel
def measure(
    ranges: FloatArray, noise: float, dropout: float, maximum_range: float, rng: np.random.Generator
) -> FloatRanges:
    """Return the measured ranges for true ranges (m): noise is added, and some beams are lost.

    Every beam draws the same numbers whether it hits or not, so that the noise of one does not depend on the others.
    """
    measured = np.empty(len(ranges), np.float32)
    for beam in range(len(ranges)):
        lost = rng.random() < dropout
        noisy = max(0.0, ranges[beam] + noise * rng.standard_normal())
        measured[beam] = NO_CONTACT if lost or noisy > maximum_range else noisy
    return measured


class PlanarLaser:
    """The scanner of one episode. The scan of a moment is the same, however often it is taken and by whom."""

    def __init__(self, scenario: Scenario, seed: int, episode_id: int) -> None:
        """Mount the scanner of `scenario`.

        Its noise is drawn from (seed, episode_id, Role.SCAN, tick), and between ticks from (…, tick, control period).
        """
        assert scenario.sensor is not None
        self._sensor = scenario.sensor
        hides = [one.hides is not False for one in scenario.obstacles]
        self._scenario, self._parked = scenario, scenario.rectangles[: len(hides)][hides]
        self._draw = (seed, episode_id)
        # Angles are those that the message carries, so that a receiver's bearings are the ones that were cast.
        first = self._sensor.first_bearing
        self._first = float(np.float32(-0.5 * self._sensor.field_of_view if first is None else first))
        self._increment = float(np.float32(self._sensor.field_of_view / (self._sensor.beams - 1)))

    def true_ranges(
        self, car: CarState, adversary: AdversaryState, others: tuple[RoadUserState, ...] = ()
    ) -> FloatArray:
        """Return the ranges without noise and dropouts, m."""
        sensor, scenario = self._sensor, self._scenario
        x = car.x + sensor.mount_ahead * math.cos(car.heading)
        y = car.y + sensor.mount_ahead * math.sin(car.heading)
        fan = (self._first, self._increment, sensor.beams)
        discs, boxes = [], []
        for body, state in zip((scenario.adversary, *scenario.others), (adversary, *others), strict=False):
            radius, half_length, half_width = body.shape
            if radius > 0.0:
                discs.append((state.x, state.y, radius))
            else:
                boxes.append((state.x, state.y, state.heading, half_length, half_width))
        rectangles = np.vstack([self._parked, np.array(boxes).reshape(-1, 5)]) if boxes else self._parked
        return cast_beams((x, y, car.heading), fan, np.array(discs).reshape(-1, 3), rectangles, sensor.maximum_range)

    def scan(self, car: CarState, adversary: AdversaryState, tick: int, period: int = 0) -> Scan:
        """Return the scan of a control period's beginning, from the true states there."""
        sensor = self._sensor
        rng = generator(*self._draw, Role.SCAN, *((tick, period) if period else (tick,)))
        true = self.true_ranges(car, adversary, self._scenario.others_at(tick, period))
        ranges = measure(true, sensor.range_noise, sensor.dropout, sensor.maximum_range, rng)
        return Scan(ranges, self._first, self._increment, float(np.float32(sensor.maximum_range)))


def make_laser(episode: EpisodeSpec) -> PlanarLaser | None:
    """Return the scanner of an episode, seeded from its specification; none where the scenario has no sensor."""
    if episode.scenario.sensor is None:
        return None
    return PlanarLaser(episode.scenario, episode.seed, episode.episode_id)
