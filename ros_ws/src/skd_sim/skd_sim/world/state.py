"""States of the car and of road users, their headings, trajectories, and motion over one time step.

World frame `map` (ENU: x East, y North), metres, m/s, rad.

A message carries sin and cos of half a heading, from which it comes back with the error of four roundings. Headings of
a grid of π/2⁴⁰ (3·10⁻¹² rad), far coarser than that, are found again to the last bit; North, π/2, is one of them. So
are velocities of a grid, which a message carries along the axes of a box.

Paper, section "The Cars": ν' = ν + U[−0.05ν, 0.05ν] + Δt·a with a itself perturbed by ±10 %. A car does not
reverse, so the speed is clamped at zero, and the distance travelled is the trapezoid Δt·(ν + ν')/2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from skd_sim.kernels.compilation import kernel

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
Pair = tuple[float, float]
Triple = tuple[float, float, float]
"""Arrays, and numbers of a point or a shape, under the names that all packages use."""


class CarState(NamedTuple):
    """Car: position of its reference point (m), heading (rad, counter-clockwise from East), speed (m/s)."""

    x: float
    y: float
    heading: float
    speed: float


class RoadUserState(NamedTuple):
    """Anybody but the car: position of the centre (m), velocity over the last time step (m/s), heading of a box (rad).

    A disc points nowhere: its heading is 0. A box's velocity is one of the grid of `velocity_on_grid`.
    """

    x: float
    y: float
    vx: float
    vy: float
    heading: float = 0.0

    def moved(self, after: RoadUserState, passed: float) -> RoadUserState:
        """Return the state after a time (s) of the time step that ends in another state."""
        return RoadUserState(self.x + passed * after.vx, self.y + passed * after.vy, *after[2:])


AdversaryState = RoadUserState
"""What a road user's state is called where it is the adversary's."""


class Scene(NamedTuple):
    """Everybody at a moment: the car under test, the adversary, and the others of the scenario in its order."""

    ego: CarState
    adversary: RoadUserState
    others: tuple[RoadUserState, ...] = ()


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Positions in the world frame at times 0, time_step, 2·time_step, ….

    Attributes:
        positions: n × d array, m; n ≥ 1, finite.
        time_step: time between two positions, s, > 0.
        name: says where it comes from, for reports.
    """

    positions: FloatArray
    time_step: float
    name: str = ""

    def __post_init__(self) -> None:
        points = np.array(self.positions, dtype=np.float64)
        if points.ndim != 2 or points.shape[0] < 1 or points.shape[1] < 1:
            raise ValueError(f"a trajectory needs n × d positions with n ≥ 1, got shape {points.shape}")
        if not np.isfinite(points).all():
            raise ValueError(f"trajectory {self.name!r} has a position that is not finite")
        if not self.time_step > 0.0:
            raise ValueError(f"time step must be positive, got {self.time_step}")
        points.setflags(write=False)
        object.__setattr__(self, "positions", points)

    def __len__(self) -> int:
        return int(self.positions.shape[0])

    @property
    def duration(self) -> float:
        """Time from the first to the last position, s."""
        return (len(self) - 1) * self.time_step

    def prefix(self, count: int) -> Trajectory:
        """Return the first `count` positions (all, where there are fewer)."""
        return Trajectory(self.positions[: max(1, count)], self.time_step, self.name)


_GRAIN = math.pi / 2**40
_HALF_TURN = 2.0**40  # grains


@kernel
def on_grid(heading: float) -> float:
    """Return the heading of the grid that is nearest (rad), in (−π, π]; nan of one that is not finite."""
    grains = np.floor(heading / _GRAIN + 0.5)  # not math.floor, which makes a whole number of what is none
    turns = np.ceil((grains - _HALF_TURN) / (2.0 * _HALF_TURN))
    return (grains - 2.0 * _HALF_TURN * turns) * _GRAIN  # type: ignore[no-any-return]


_SLOWEST = 2.0**40  # grid points of a velocity to 1 m/s


def to_body(vx: float, vy: float, heading: float) -> tuple[float, float]:
    """Return a velocity in `map` (m/s) along and to the left of a heading (rad)."""
    if heading == 0.0:
        return vx, vy
    cos, sin = math.cos(heading), math.sin(heading)
    return cos * vx + sin * vy, cos * vy - sin * vx


def to_map(ahead: float, left: float, heading: float) -> tuple[float, float]:
    """Return in `map` a velocity (m/s) along and to the left of a heading (rad).

    One of a grid of 2⁻⁴⁰ m/s, as a box's velocity is, comes back from `to_body` to the last bit.
    """
    if heading == 0.0:
        return ahead, left
    cos, sin = math.cos(heading), math.sin(heading)
    return velocity_on_grid(cos * ahead - sin * left, sin * ahead + cos * left)


def velocity_on_grid(vx: float, vy: float) -> tuple[float, float]:
    """Return the velocity of the grid that is nearest, m/s."""
    return float(np.rint(vx * _SLOWEST)) / _SLOWEST, float(np.rint(vy * _SLOWEST)) / _SLOWEST


def heading_of(z: float, w: float) -> float:
    """Return the heading (rad) of a rotation about the vertical, given by the quaternion (0, 0, z, w)."""
    return float(on_grid(2.0 * math.atan2(z, w)))


@kernel
def next_speed(speed: float, acceleration: float, speed_noise: float, time_step: float) -> float:
    """Return the speed (m/s) after one step.

    Args:
        speed: speed before the step, m/s.
        acceleration: acceleration really applied, m/s².
        speed_noise: relative speed perturbation of this step, in the car's noise range.
        time_step: duration of the step, s.
    """
    return max(0.0, speed + speed_noise * speed + time_step * acceleration)


@kernel
def travelled(speed: float, speed_after: float, time_step: float) -> float:
    """Return the distance (m) covered in one step between two speeds (m/s)."""
    return 0.5 * time_step * (speed + speed_after)


@kernel
def draw_relative(half_width: float, rng: np.random.Generator) -> float:
    """Draw a relative perturbation from U[−half_width, half_width]."""
    return half_width * (2.0 * rng.random() - 1.0)


def braking_distance(speed: float, deceleration: float) -> float:
    """Return κ, the distance (m) to stop from `speed` (m/s) at constant `deceleration` (m/s², > 0).

    Paper, section "The Cars": the safe distance threshold κ = ν_M² / (2 · 3.5 m/s²).
    """
    return speed * speed / (2.0 * deceleration)
