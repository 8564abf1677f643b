"""A rule-based car: the longitudinal law of CARLA 0.8's own agent, with its pedals and its published zones.

It knows where the adversary is, as the agent in CARLA does, and reacts to one on the lane only. Distances and angles
are from the car's reference point and its heading. Source: `agent/modules/obstacle_avoidance.py` and `controllers.py`
of CARLA 0.8 (MIT).

The published controllers command throttle and brake of a simulated car; a car of SKD takes an acceleration. The map:
brake b in (0, 1] decelerates by b times the scenario's full deceleration, throttle u in [0, 1] accelerates by
u · 3 m/s², less a drag of 0.05/s times the speed (0.4 m/s² at 30 km/h: a car that coasts slows down). A brake of 1 is
then what the basic car does.
"""

from __future__ import annotations

import math

import numpy as np

from skd_sim.scenario.road import road_position
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame
from skd_sim.world.state import AdversaryState, CarState, next_speed, travelled

MAXIMUM_ACCELERATION = 3.0  # m/s² at full throttle, as the simulator's default bound on following a speed target
DRAG = 0.05  # 1/s
KILOMETRES_PER_HOUR = 3.6  # per m/s
CONTROL_PERIOD = 0.05  # s: 20 decisions a second (Conditional Affordance Learning runs at 20 frames/s)


def pedal_acceleration(throttle: float, brake: float, speed: float, deceleration: float) -> float:
    """Return the acceleration (m/s²) of a car with these pedals; any brake overrides the throttle.

    Args:
        throttle: position of the throttle, in [0, 1].
        brake: position of the brake, in [0, 1].
        speed: speed of the car, m/s.
        deceleration: deceleration at full brake, m/s² (> 0).
    """
    if brake > 0.0:
        return -brake * deceleration
    return throttle * MAXIMUM_ACCELERATION - DRAG * speed


def sub_steps(duration: float) -> tuple[int, float]:
    """Return into how many decisions a control period (s) is divided, and the duration of each, s."""
    count = max(1, round(duration / CONTROL_PERIOD))
    return count, duration / count


class Pid:
    """A PID controller on simulation time, its integral clamped.

    The published code integrates wall-clock time, by which a run would depend on the machine.
    """

    def __init__(self, p: float, i: float, d: float, integral_limit: float) -> None:
        """Make one with these gains; `integral_limit` bounds |∫ error dt|."""
        self._gains = (p, i, d)
        self._limit = integral_limit
        self.reset()

    def reset(self) -> None:
        """Forget everything."""
        self._integral = 0.0
        self.pause()

    def pause(self) -> None:
        """Forget the last error but not the integral: the next step has no derivative."""
        self._last: float | None = None

    def step(self, error: float, duration: float) -> float:
        """Return the output for an error that holds for `duration` (s)."""
        p, i, d = self._gains
        self._integral = min(self._limit, max(-self._limit, self._integral + error * duration))
        slope = 0.0 if self._last is None else (error - self._last) / duration
        self._last = error
        return p * error + i * self._integral + d * slope


TARGET_SPEED = 36.0  # km/h
SLOW_DISTANCE = 35.0  # m
SLOW_ANGLE = 0.15  # rad
COASTING = 2.0  # the target speed falls as distance / (COASTING · SLOW_DISTANCE)
STOP_DISTANCE = 12.0  # m
STOP_ANGLE = 0.5  # rad
GAINS = (0.25, 0.20, 0.0)  # per km/h, per km/h·s, per km/h/s
THROTTLE_GAIN = 1.3
MAXIMUM_THROTTLE = 0.75
BRAKE_GAIN = 0.35
BRAKE_THRESHOLD = 0.5  # of the PID's output, below which the car coasts
INTEGRAL_LIMIT = 20.0  # km/h·s; ours, as in CAL: without a bound the integral would outweigh the zones for seconds


def speed_factor(distance: float, angle: float) -> float:
    """Return by what the target speed is multiplied for an adversary at a distance (m) and angle (rad) ahead."""
    if distance < STOP_DISTANCE and abs(angle) < STOP_ANGLE:
        return 0.0
    if distance < SLOW_DISTANCE and abs(angle) < SLOW_ANGLE:
        return distance / (COASTING * SLOW_DISTANCE)
    return 1.0


class CarlaAgent:
    """Slows down for an adversary ahead on the lane and stops for a near one."""

    def __init__(self) -> None:
        """Make the controller."""
        self._pid = Pid(*GAINS, integral_limit=INTEGRAL_LIMIT)

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Forget the last episode; the law draws nothing."""
        self._deceleration = scenario.car.deceleration
        self._half_lane = 0.5 * scenario.road.lane_width
        self._line = scenario.road.line
        self._count, self._duration = sub_steps(scenario.control_duration)
        self._pid.reset()

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the mean acceleration (m/s²) over the control period, the adversary taken to stand in it."""
        ahead, left = to_car_frame(adversary.x, adversary.y, car.x, car.y, car.heading)
        speed, total = car.speed, 0.0
        on_lane = abs(road_position(self._line, adversary.x, adversary.y)[1]) <= self._half_lane
        for _ in range(self._count):
            factor = speed_factor(math.hypot(ahead, left), math.atan2(left, ahead)) if on_lane else 1.0
            acceleration = self._decide(speed, factor)
            after = float(next_speed(speed, acceleration, 0.0, self._duration))
            ahead -= float(travelled(speed, after, self._duration))
            speed = after
            total += acceleration
        return total / self._count

    def _decide(self, speed: float, factor: float) -> float:
        excess = speed * KILOMETRES_PER_HOUR - TARGET_SPEED * factor
        output = self._pid.step(excess, self._duration)
        throttle = min(MAXIMUM_THROTTLE, max(0.0, -THROTTLE_GAIN * output))
        brake = min(1.0, BRAKE_GAIN * output) if output > BRAKE_THRESHOLD else 0.0
        return pedal_acceleration(throttle, brake, speed, self._deceleration)
