"""Sections of a scenario that are plain data: the car, what counts as a collision, the sensor, parked rectangles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.choices.car_dynamics import BASIC, DYNAMICS
from skd_sim.encounter.unchanging import Unchanging
from skd_sim.geometry.motion import braking_distance
from skd_sim.inputs.keys import ON_LANE, Choice, Range


@dataclass(frozen=True)
class Car(Unchanging):
    """Footprint, dynamics and start of the car under test.

    `start_gap` is from the front bumper to the crossing line; an episode adds a draw from [0, start_gap_range).
    With `meet_safe_trajectory` the gap is instead the distance that the unbraked car drives until φ enters its path.
    `dynamics` and the brake's keys say how the car moves (skd_sim/dynamics); the basic car has no use for the latter.
    `mass` is for simulators whose car has one (MetaDrive); by default it has its own.
    """

    front: Annotated[float, Range(0.1, 10.0, "m ahead of the reference point")]
    rear: Annotated[float, Range(0.1, 20.0, "m behind the reference point")]
    width: Annotated[float, Range(0.2, 5.0, "m")]
    start_speed: Annotated[float, Range(0.0, 60.0, "m/s")]
    start_gap: Annotated[float, Range(0.0, 500.0, "m")]
    start_gap_range: Annotated[float, Range(0.0, 50.0, "m")]
    meet_safe_trajectory: bool
    deceleration: Annotated[float, Range(0.1, 15.0, "m/s²")]
    speed_noise: Annotated[float, Range(0.0, 0.5, "relative")]
    acceleration_noise: Annotated[float, Range(0.0, 0.9, "relative")]
    dynamics: Annotated[str, Choice(tuple(DYNAMICS))] = BASIC
    brake_delay: Annotated[float, Range(0.0, 1.0, "s")] = 0.1
    brake_rate: Annotated[float, Range(1.0, 1000.0, "m/s³")] = 50.0
    brake_limit: Annotated[float, Range(0.1, 30.0, "m/s²")] = 15.0
    antilock: bool = True
    mass: Annotated[float, Range(50.0, 50000.0, "kg")] | None = None

    @property
    def half_width(self) -> float:
        """Half of the car's width, m."""
        return 0.5 * self.width

    @property
    def safe_distance(self) -> float:
        """κ: distance to stop from the start speed at full deceleration, m (paper, "The Cars")."""
        return braking_distance(self.start_speed, self.deceleration)


@dataclass(frozen=True)
class Collision(Unchanging):
    """What counts as a collision, and which collisions count as a hit by the moving car.

    A touch at `minimum_impact_speed` or more of the car's own speed is a collision and ends the episode. It is a *hit*
    at `hit_speed` or more, by default 2 km/h, Euro NCAP's tolerance of impact speeds (Crash Avoidance Frontal v1.1):
    margin, risk and the deformation that ranks count hits, the paper's SKD any collision.
    """

    minimum_impact_speed: Annotated[float, Range(0.0, 60.0, "m/s")]
    hit_speed: Annotated[float, Range(0.0, 60.0, "m/s")] = 0.556

    def is_hit(self, impact_speed: float) -> bool:
        """Tell whether a collision at this speed of the car (m/s) is a hit."""
        return impact_speed >= self.hit_speed


@dataclass(frozen=True)
class Sensor(Unchanging):
    """Planar laser scanner on the car's axis, looking ahead; beams are spread evenly over the field of view."""

    mount_ahead: Annotated[float, Range(-20.0, 20.0, "m ahead of the reference point")]
    beams: Annotated[int, Range(2, 4096, "beams")]
    field_of_view: Annotated[float, Range(0.01, 2 * math.pi, "rad")]
    maximum_range: Annotated[float, Range(1.0, 300.0, "m")]
    range_noise: Annotated[float, Range(0.0, 1.0, "m, standard deviation")]
    dropout: Annotated[float, Range(0.0, 0.9, "probability per beam")]


@dataclass(frozen=True)
class Obstacle(Unchanging):
    """A parked rectangle: it hides what is behind it, and nobody walks through it.

    It stands clear of the strip that the car sweeps, so the car never meets it. With `hides: false` it is as low as a
    guard rail: nobody walks through it, and the car's laser sees over it.
    """

    also: ClassVar = ON_LANE

    x: Annotated[float, Range(-100.0, 100.0, "m, centre")]
    y: Annotated[float, Range(-500.0, 500.0, "m, centre")]
    heading: Annotated[float, Range(-math.pi, math.pi, "rad, of its length")]
    length: Annotated[float, Range(0.1, 30.0, "m")]
    width: Annotated[float, Range(0.1, 30.0, "m")]
    hides: bool | None = None

    @property
    def corners(self) -> FloatArray:
        """Corners of the rectangle, 4 × 2, m."""
        ahead = 0.5 * self.length * np.array([math.cos(self.heading), math.sin(self.heading)])
        left = 0.5 * self.width * np.array([-math.sin(self.heading), math.cos(self.heading)])
        corners = [ahead + left, left - ahead, -ahead - left, ahead - left]
        return np.asarray(np.array([self.x, self.y]) + np.array(corners))
