"""The interface of a car's dynamics, the limits of its commands, and the paper's basic car.

The speed of the basic car follows the command at once, up to noise (section "The Cars"). Until its first steering
command other than 0 it keeps to its lane; then it is a kinematic bicycle (Kong et al., "Kinematic and dynamic vehicle
models for autonomous driving control design", IV 2015) within a friction circle, in which braking comes first.

Brakes of the basic car hold `car.brake_limit` or what the tyres do, whichever is less, but at least `car.deceleration`,
which is what the scenario says that this car can do. The multi-body car has tyres of its own; only its brake is limited
here. Nobody speeds up faster than the tyres hold.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol, cast

import numpy as np

from skd_sim.kernels.compilation import kernel
from skd_sim.kernels.stream import stream_of
from skd_sim.options.car_and_adversary import DYNAMICS
from skd_sim.options.registry import load
from skd_sim.scenario.road import HEADING_NORTH, advanced, is_straight_north, road_curvature, road_pose, road_position
from skd_sim.scenario.scenario import Car, Scenario
from skd_sim.world.state import CarState, FloatArray, Pair, draw_relative, next_speed, on_grid, travelled


class Noise(NamedTuple):
    """Relative perturbations of a car's motion, drawn once a tick.

    Attributes:
        speed: relative noise of the speed.
        acceleration: relative noise of the acceleration.
    """

    speed: float
    acceleration: float


Command = float | Pair
"""An acceleration (m/s²), or one and a steering angle of the front wheels (rad, to the left); a float steers by 0."""


class CarDynamics(Protocol):
    """A car that can be driven.

    Same start, same commands, same noise: same path, to the last bit.

    Attributes:
        steered: whether a command has steered it since it was reset.
    """

    steered: bool

    def reset(self, car: CarState) -> None:
        """Put the car on the road at this state, rolling freely, and forget everything before."""

    def draw(self, rng: np.random.Generator) -> Noise:
        """Draw the noise of a tick; the same number of draws whatever the car does."""

    def advance(self, command: Pair, duration: float, noise: Noise) -> FloatArray:
        """Drive on under one command.

        Args:
            command: acceleration, m/s², and steering angle, rad, which the car may follow or not.
            duration: time to drive, s: a control period of the scenario, or a part of it.
            noise: relative noise of the acceleration, and of the speed over this duration.

        Returns:
            n × 4 with n ≥ 2: x, y (m), heading (rad) and speed (m/s) at n uniform times from now to the end of the
            duration. Between two of them the car may be taken to move uniformly.
        """


def make_dynamics(scenario: Scenario) -> CarDynamics:
    """Return the dynamics that the scenario names in `car.dynamics`."""
    # Loaded here: who drives the basic car need not wait for the multi-body model.
    name = scenario.car.dynamics
    return cast(CarDynamics, load(DYNAMICS[name].target, f"car.dynamics {name}")(scenario))


GRAVITY = 9.81
"""m/s², as in the source of the multi-body car."""
PEAK_FRICTION = 1.1739
"""Of the multi-body car's tyres on a dry road."""
GRIP = PEAK_FRICTION * GRAVITY
"""m/s² that tyres hold on a dry road."""


WHEELBASE = 2.6 / 4.5
"""Of the car's length: 2.6 m of a compact car of 4.5 m, its axles as far from either end."""
STEERING_LIMIT, STEERING_RATE = 0.61, 0.6
"""rad and rad/s at the front wheels: 35°, and 515 °/s at the steering wheel (ratio 15), as in an evasive manoeuvre.
CommonRoad's BMW 320i has 1.066 rad and 0.4 rad/s."""
SIDE_GRIP = 0.8 * GRAVITY
"""m/s², radius of the friction circle: what passenger cars hold on a dry skid pad."""
_PIECE = 0.01  # s of a bend between two points of a path


def wheels(car: Car) -> Pair:
    """Return a car's wheelbase, and how far its rear axle is behind the reference point, m."""
    wheelbase = WHEELBASE * (car.front + car.rear)
    return wheelbase, 0.5 * (wheelbase - car.front + car.rear)


def steering_angle(curvature: float, wheelbase: float) -> float:
    """Return the steering angle (rad) with which the rear axle follows a curvature (1/m, to the left)."""
    return math.atan(wheelbase * curvature)


class CommandLimits(NamedTuple):
    """Least and greatest acceleration that a command can mean, m/s²."""

    least: float
    greatest: float

    def clip(self, acceleration: float) -> float:
        """Return a command within the limits; one that is there already stays as it is, to the bit.

        Raises:
            ValueError: it is not finite.
        """
        if not math.isfinite(acceleration):
            raise ValueError(f"a command must be a finite number (m/s²), got {acceleration}")
        return min(self.greatest, max(self.least, acceleration))

    def possible(self, command: Pair) -> Pair:
        """Return acceleration and steering angle of a command within the limits; see `clip`."""
        return self.clip(command[0]), min(STEERING_LIMIT, max(-STEERING_LIMIT, command[1]))


def as_pair(command: Command) -> Pair:
    """Return the acceleration and the steering angle of a command."""
    return (float(command[0]), float(command[1])) if isinstance(command, tuple) else (float(command), 0.0)


def command_limits(scenario: Scenario) -> CommandLimits:
    """Return the limits of a scenario's car."""
    car, grip = scenario.car, scenario.road.friction * GRIP
    brake = car.brake_limit if DYNAMICS[car.dynamics].tyres else min(car.brake_limit, grip)
    return CommandLimits(-max(car.deceleration, brake), grip)


def clipped_line(counts: Sequence[int], low: float, high: float) -> str:
    """Return what is said of commands beyond what a car can do.

    Args:
        counts: of such commands, one for each episode that has any.
        low: least acceleration of the car, m/s².
        high: greatest.
    """
    return (
        f"{sum(counts)} commands in {len(counts)} episodes were beyond what this car can do; they were clipped to "
        f"{low:.3g} … {high:.3g} m/s²"
    )


_SAGITTA = 1e-4  # m


@kernel
def _draw(speed_noise: float, acceleration_noise: float, rng: np.random.Generator) -> Pair:
    return draw_relative(speed_noise, rng), draw_relative(acceleration_noise, rng)


@kernel
def drive(
    car: tuple[float, float, float, float], angle: float, command: Pair, noise: Pair, duration: float, axles: Pair
) -> tuple[FloatArray, float]:
    """Return a car's path under one command, and its steering angle (rad) at the end; see `CarDynamics.advance`.

    Args:
        car: x, y of the reference point (m), heading (rad), speed (m/s).
        angle: of the front wheels, rad.
        command: acceleration (m/s²) and steering angle (rad).
        noise: relative, of the speed and of the acceleration.
        duration: time to drive, s.
        axles: wheelbase, and how far the rear axle is behind the reference point, m.
    """
    x, y, heading, speed = car
    acceleration, steering = command
    applied = acceleration + noise[1] * acceleration
    after = next_speed(speed, applied, noise[0], duration)
    bends = angle != 0.0 or steering != 0.0 or heading != HEADING_NORTH
    pieces = max(1, math.ceil(duration / _PIECE)) if bends else 1
    path = np.empty((pieces + 1, 4))
    path[0, 0], path[0, 1], path[0, 2], path[0, 3] = x, y, heading, speed
    if not bends:
        distance = travelled(speed, after, duration)
        path[1, 0] = x + distance * math.cos(heading)
        path[1, 1] = y + distance * math.sin(heading)
        path[1, 2], path[1, 3] = heading, after
        return path, 0.0
    wheelbase, behind = axles
    side = math.sqrt(max(0.0, SIDE_GRIP * SIDE_GRIP - applied * applied))
    turn, before = STEERING_RATE * duration / pieces, speed
    for piece in range(1, pieces + 1):
        then = after if piece == pieces else speed + piece / pieces * (after - speed)
        held = _within_grip(angle, before, side, wheelbase)
        angle = _within_grip(held + min(turn, max(-turn, steering - held)), then, side, wheelbase)
        moved = min(turn, max(-turn, _within_grip(steering, 0.5 * (before + then), side, wheelbase) - held))
        tangent = math.tan(held + moved * (1.0 - 0.5 * abs(moved) / turn))  # it may be there before the piece ends
        slip = math.atan(behind / wheelbase * tangent)
        curvature, distance = math.cos(slip) * tangent / wheelbase, travelled(before, then, duration / pieces)
        x, y, course = advanced(x, y, heading + slip, curvature, distance)
        heading, before = on_grid(course - slip), then
        path[piece, 0], path[piece, 1], path[piece, 2], path[piece, 3] = x, y, heading, then
    return path, angle


@kernel
def _within_grip(angle: float, speed: float, side: float, wheelbase: float) -> float:
    """Return a steering angle (rad), limited to what tyres with a lateral grip of `side` (m/s²) hold at a speed."""
    most = math.atan(wheelbase * side / (speed * speed)) if speed > 0.0 else STEERING_LIMIT
    return min(most, max(-most, angle))


@kernel
def along_road(line: FloatArray, s: float, distance: float, speed: float, after: float) -> FloatArray:
    """Return the way of a car along a road's centre line over a step; see `CarDynamics.advance`.

    Uniform in time, as on a straight road, and in as many pieces as keep each within 0.1 mm of its arc.

    Args:
        line: centre line (skd_sim/scenario/road.py).
        s: path coordinate before, m.
        distance: distance driven in the step, m.
        speed: speed before the step, m/s.
        after: speed after, m/s.
    """
    sharpest = 0.0
    for part in range(line.shape[0]):
        if line[part, 0] < s + distance and s < line[part, 0] + line[part, 5]:
            sharpest = max(sharpest, abs(line[part, 4]))
    pieces = max(1, math.ceil(distance * math.sqrt(sharpest / (8.0 * _SAGITTA))))
    path = np.empty((pieces + 1, 4))
    for piece in range(pieces + 1):
        share = piece / pieces
        x, y, heading = road_pose(line, s + share * distance)
        path[piece, 0], path[piece, 1], path[piece, 2] = x, y, on_grid(heading)
        path[piece, 3] = after if piece == pieces else speed + share * (after - speed)
    return path


class BasicCar:
    """A point with a speed that keeps to its lane until it is steered, and a kinematic bicycle from then on."""

    def __init__(self, scenario: Scenario) -> None:
        """Take noise, road and axles from the scenario."""
        self._noise = (scenario.car.speed_noise, scenario.car.acceleration_noise)
        self._line = scenario.road.line
        self._curved = not is_straight_north(self._line)
        self._axles = wheels(scenario.car)

    def reset(self, car: CarState) -> None:
        """Put the car at this state; on a road with curves, at the nearest point of the centre line."""
        self._car, self._angle, self.steered = car, 0.0, False
        self._s = float(road_position(self._line, car.x, car.y)[0])

    def draw(self, rng: np.random.Generator) -> Noise:
        """Draw both, so that a car that brakes and one that does not use up the same numbers."""
        return Noise(*_draw(*self._noise, stream_of(rng)))

    def advance(self, command: Pair, duration: float, noise: Noise) -> FloatArray:
        """Return the two ends of a straight way, or points along a bend; see `CarDynamics`."""
        if command[1] != 0.0 and not self.steered:
            self.steered = True
            self._angle = steering_angle(road_curvature(self._line, self._s), self._axles[0])
        path, self._angle = drive((*self._car,), self._angle, command, (*noise,), duration, self._axles)
        if self._curved and not self.steered:
            speed, after = float(path[0, 3]), float(path[-1, 3])
            distance = float(travelled(speed, after, duration))
            path = along_road(self._line, self._s, distance, speed, after)
            self._s += distance
        self._car = CarState(*path[-1].tolist())
        return path
