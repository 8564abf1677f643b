"""The paper's ML controller, the longitudinal law of Conditional Affordance Learning (Sauer et al. 2018), and CARLA's.

Both command throttle and brake of a simulated car; a car of SKD takes an acceleration. The map: brake b in (0, 1]
decelerates by b times the scenario's full deceleration, throttle u in [0, 1] accelerates by u · 3 m/s², less a drag of
0.05/s times the speed (0.4 m/s² at 30 km/h: a car that coasts slows down). A brake of 1 is then what the basic car
does.

*CARLA's agent* is a rule-based car: the longitudinal law of CARLA 0.8's own agent, with its published zones
(`agent/modules/obstacle_avoidance.py` and `controllers.py`, MIT). It knows where the adversary is, as the agent in
CARLA does, and reacts to one on the lane only. Distances and angles are from the car's reference point and its heading.

*CAL*: its states are Cruising and Hazard Stop. The probability of a hazard comes from a network that sees the car's
laser scans; a pedestrian who has just come into view is assumed to run towards the path, until the motion is seen. It
decides 20 times a second, each time on a scan of its own.

What the network learns is a substitute for the label of a hazard stop, which was never published. The car's *stopping
zone* is the ground that it cannot help covering: as wide as the car, from the front bumper to where it stands if it
reacts for one tick and then brakes fully, and 1 m more. An adversary is on a collision course within braking range if
its disc, kept at its present velocity, meets the zone before the car would stand.

From scans to the network's input: neighbouring returns belong together unless a gap parts them (jump distance
segmentation). Each segment is an object: its centre and its width. A scan shows only the near side of a pedestrian: if
it is a disc, the centroid of the returns lies before its centre by π/4 of the radius, in the beams' direction, which
turns as the car drives past. Its velocity is the way from the nearest object of the scan `WINDOW` ago, in the world
frame, so that the car's own motion is out of it; over less, the scanner's noise would outweigh a step.
"""

from __future__ import annotations

import functools
import math
from collections import deque
from importlib import resources
from typing import NamedTuple

import numpy as np

from skd_sim.errors import UsageError
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import road_position
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import to_car_frame
from skd_sim.world.sensors import FloatRanges, Scan
from skd_sim.world.state import AdversaryState, CarState, FloatArray, next_speed, travelled

# --- pedals, and the law of CARLA's agent

MAXIMUM_ACCELERATION = 3.0  # m/s² at full throttle, as the simulator's default bound on following a speed target
DRAG = 0.05  # 1/s
KILOMETRES_PER_HOUR = 3.6  # per m/s
CONTROL_PERIOD = 0.05  # s: 20 decisions a second (Conditional Affordance Learning runs at 20 frames/s)
INTEGRAL_LIMIT = 20.0  # km/h·s; without a bound the integral of CARLA's agent would outweigh its zones for seconds


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
AGENT_THROTTLE = 0.75
BRAKE_GAIN = 0.35
BRAKE_THRESHOLD = 0.5  # of the PID's output, below which the car coasts


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
        throttle = min(AGENT_THROTTLE, max(0.0, -THROTTLE_GAIN * output))
        brake = min(1.0, BRAKE_GAIN * output) if output > BRAKE_THRESHOLD else 0.0
        return pedal_acceleration(throttle, brake, speed, self._deceleration)


# --- CAL

REACTION_TIME = 0.3  # s: one tick
STANDOFF = 1.0  # m ahead of the bumper that stay free


@kernel
def stopping_zone(speed: float, deceleration: float) -> float:
    """Return how far (m) the stopping zone reaches ahead of the bumper.

    Args:
        speed: speed of the car, m/s.
        deceleration: deceleration of the car at full brake, m/s² (> 0).
    """
    return speed * REACTION_TIME + speed * speed / (2.0 * deceleration) + STANDOFF


@kernel
def time_to_stand(speed: float, deceleration: float) -> float:
    """Return the time (s) from now to standstill, the reaction included; arguments as `stopping_zone`."""
    return REACTION_TIME + speed / deceleration


WINDOW = 0.3  # s over which a velocity is taken, as far as scans come more often
GAP = 0.4  # m between returns of different objects
WALKER_RADIUS = 0.25  # m, about half the width of a standing adult
NEAR_SIDE = math.pi / 4.0  # mean of √(1 − u²) over u in (−1, 1)
WIDEST_WALKER = 1.0  # m; a wider object is taken to stand: what is seen of it changes more than it moves
FASTEST_WALKER = 4.0  # m/s
UNKNOWN_WALKER = 8.0 / 3.6  # m/s, of one whose velocity has not been seen: the running adult of Euro NCAP's AEB VRU
MAXIMUM_OBJECTS = 64
FEATURES = 9
"""Inputs of the network, see `network_input`."""
SCALE = 0.25  # per metre or second: brings the inputs to the order of one


@kernel
def segment(ranges: FloatRanges, first: float, increment: float, gap: float) -> FloatArray:
    """Return the objects of a scan, k × 3: centre ahead and left of the sensor, width (m).

    The centre of a wide object is the centroid of its returns, that of a possible pedestrian is a part of a radius
    behind.

    Args:
        ranges: range of each beam, m; infinite where nothing came back.
        first: bearing of the first beam, rad.
        increment: angle between neighbouring beams, rad.
        gap: distance of consecutive returns that belong to different objects, m.
    """
    objects = np.empty((MAXIMUM_OBJECTS, 3))
    count = points = 0
    sum_ahead = sum_left = start_ahead = start_left = last_ahead = last_left = 0.0
    for beam in range(len(ranges) + 1):
        closing = beam == len(ranges)
        ahead = left = 0.0
        if not closing:
            distance = float(ranges[beam])
            if not math.isfinite(distance):
                continue
            bearing = first + beam * increment
            ahead, left = distance * math.cos(bearing), distance * math.sin(bearing)
        if points > 0 and (closing or math.hypot(ahead - last_ahead, left - last_left) > gap):
            objects[count, 0] = sum_ahead / points
            objects[count, 1] = sum_left / points
            objects[count, 2] = math.hypot(last_ahead - start_ahead, last_left - start_left)
            if objects[count, 2] <= WIDEST_WALKER:
                behind = 1.0 + NEAR_SIDE * WALKER_RADIUS / max(1e-6, math.hypot(objects[count, 0], objects[count, 1]))
                objects[count, 0] *= behind
                objects[count, 1] *= behind
            count += 1
            points = 0
            if count == MAXIMUM_OBJECTS:
                break
        if points == 0:
            sum_ahead = sum_left = 0.0
            start_ahead, start_left = ahead, left
        sum_ahead += ahead
        sum_left += left
        points += 1
        last_ahead, last_left = ahead, left
    return objects[:count].copy()


@kernel
def associate(now: FloatArray, before: FloatArray, known: FloatArray, duration: float) -> FloatArray:
    """Return the velocities of each object, k × 4, m/s: over the last step and over the one before it.

    An object that is wide, or has no predecessor near enough, is new: it is taken to stand, and column 2 is nan. One
    whose predecessor was new is taken to have moved before as it does now.

    Args:
        now: k × 3 objects in the world frame: centre x and y, width (m).
        before: j × 3 objects one scan earlier, in the same form.
        known: j × 4 velocities of those; nan in column 2 for one that was new.
        duration: time between the scans, s.
    """
    velocities = np.zeros((len(now), 4))
    for index in range(len(now)):
        nearest, match = FASTEST_WALKER * duration, -1
        if now[index, 2] <= WIDEST_WALKER:
            for other in range(len(before)):
                distance = math.hypot(now[index, 0] - before[other, 0], now[index, 1] - before[other, 1])
                if before[other, 2] <= WIDEST_WALKER and distance < nearest:
                    nearest, match = distance, other
        if match < 0:
            velocities[index, 2] = math.nan
            continue
        for axis in range(2):
            velocities[index, axis] = (now[index, axis] - before[match, axis]) / duration
        new = math.isnan(known[match, 2])
        for axis in range(2):
            velocities[index, 2 + axis] = velocities[index, axis] if new else known[match, axis]
    return velocities


@kernel
def network_input(objects: FloatArray, velocities: FloatArray, speed: float, deceleration: float) -> FloatArray:
    """Return the network's input, k × FEATURES, one row per object, mirrored to the left and scaled.

    The columns: the object ahead of the bumper and to the left; the same when the car would stand if it braked now, by
    the object's velocity over the last step; likewise by that over the step before; width; how far the
    stopping zone reaches; how long the car needs to stand.

    Args:
        objects: k × 3 in the car's frame: centre ahead of the bumper and left, width (m).
        velocities: k × 4 over ground in the axes of that frame, m/s, as `associate` gives them.
        speed: speed of the car now, m/s.
        deceleration: deceleration of the car at full brake, m/s².
    """
    rows = np.empty((len(objects), FEATURES))
    horizon = time_to_stand(speed, deceleration)
    for index in range(len(objects)):
        va, vl, before_va, before_vl = velocities[index]
        if math.isnan(before_va):
            before_va, before_vl = va, vl
        ahead, left = objects[index, 0], objects[index, 1]
        side = 1.0 if left >= 0.0 else -1.0
        rows[index, 0] = ahead
        rows[index, 1] = side * left
        rows[index, 2] = ahead + horizon * va
        rows[index, 3] = side * (left + horizon * vl)
        rows[index, 4] = ahead + horizon * before_va
        rows[index, 5] = side * (left + horizon * before_vl)
        rows[index, 6] = objects[index, 2]
        rows[index, 7] = stopping_zone(speed, deceleration)
        rows[index, 8] = horizon
    return rows * SCALE


class Perception:
    """Objects ahead and their velocities, from one scan each control period."""

    def __init__(self, scenario: Scenario) -> None:
        """Begin an episode of a scenario, which must have a sensor."""
        assert scenario.sensor is not None
        self._bumper = scenario.car.front - scenario.sensor.mount_ahead  # ahead of the sensor, m
        self._mount = scenario.sensor.mount_ahead
        self._deceleration = scenario.car.deceleration
        scans = max(1, round(WINDOW / scenario.control_duration))
        self._window = scans * scenario.control_duration
        nothing = np.empty((0, 3)), np.empty((0, 4))
        # Objects and their velocities of the scans within the window, the oldest first.
        self._past: deque[tuple[FloatArray, FloatArray]] = deque([nothing] * scans, maxlen=scans)

    def update(self, scan: Scan, car: CarState) -> None:
        """Take a scan, and the car's state (odometry) at it."""
        self.objects = segment(scan.ranges, scan.angle_min, scan.angle_increment, GAP)
        cos, sin = math.cos(car.heading), math.sin(car.heading)
        world = self.objects.copy()
        world[:, 0] = car.x + cos * (self._mount + self.objects[:, 0]) - sin * self.objects[:, 1]
        world[:, 1] = car.y + sin * (self._mount + self.objects[:, 0]) + cos * self.objects[:, 1]
        drift = associate(world, *self._past[0], self._window)
        self._past.append((world, drift))
        self.objects[:, 0] -= self._bumper
        self.velocities = np.empty_like(drift)
        for x, y in ((0, 1), (2, 3)):
            self.velocities[:, x] = cos * drift[:, x] + sin * drift[:, y]
            self.velocities[:, y] = cos * drift[:, y] - sin * drift[:, x]

    def features(self, speed: float) -> FloatArray:
        """Return the network's input at the last scan, at a speed (m/s)."""
        return network_input(self.objects, self.velocities, speed, self._deceleration)

    def cautious_features(self, speed: float) -> FloatArray:
        """Return the input for a possible pedestrian that has just come into view, as if it ran towards the path.

        Until the window is over its velocity is not known.
        """
        new = np.isnan(self.velocities[:, 2]) & (self.objects[:, 2] <= WIDEST_WALKER)
        objects = self.objects[new]
        velocities = np.zeros((len(objects), 4))
        velocities[:, 1] = velocities[:, 3] = -np.sign(objects[:, 1]) * UNKNOWN_WALKER
        return network_input(objects, velocities, speed, self._deceleration)


_ROWS_AT_ONCE = 512


class HazardNetwork(NamedTuple):
    """Weights; inputs and outputs by the convention `row @ weights + bias`."""

    w1: FloatArray
    b1: FloatArray
    w2: FloatArray
    b2: FloatArray
    w3: FloatArray
    b3: FloatArray

    def probability(self, features: FloatArray) -> FloatArray:
        """Return the probability of a hazard for each row of features (k × FEATURES).

        Sums instead of matrix products: their order, and with it the bits, do not depend on a BLAS or on k.
        """
        parts = [self._forward(features[at : at + _ROWS_AT_ONCE]) for at in range(0, len(features), _ROWS_AT_ONCE)]
        return np.concatenate(parts) if parts else np.empty(0)

    def _forward(self, features: FloatArray) -> FloatArray:
        hidden = np.maximum(0.0, (features[:, :, None] * self.w1).sum(axis=1) + self.b1)
        hidden = np.maximum(0.0, (hidden[:, :, None] * self.w2).sum(axis=1) + self.b2)
        logit = (hidden[:, :, None] * self.w3).sum(axis=1)[:, 0] + self.b3[0]
        return np.asarray(0.5 + 0.5 * np.tanh(0.5 * logit))  # the logistic function, and no overflow


@functools.cache
def shipped_network() -> HazardNetwork:
    """Return the network that comes with the package; `hazard_network.json` beside it says how it was trained."""
    with (resources.files("skd_sim") / "controllers" / "hazard_network.npz").open("rb") as file:
        arrays = np.load(file)
        return HazardNetwork(*(arrays[name] for name in HazardNetwork._fields))


SPEED_LIMIT = 30.0  # km/h, and from here on all of these are published
HAZARD_PROBABILITY = 0.9
CRUISE_GAINS = (0.06, 0.0258, 0.014)  # per km/h, per km/h·s, per km/h/s
MAXIMUM_THROTTLE = 0.8
OVERSPEED = 10.0  # km/h over the limit, above which the car brakes
OVERSPEED_BRAKE = 0.3


class CalController:
    """Cruises at 30 km/h and brakes fully where the network is more than 90 % sure of a hazard.

    Attributes:
        control_period: time between decisions, s.
        probability: probability of a hazard at the last decision.
    """

    control_period = CONTROL_PERIOD

    def __init__(self, network: HazardNetwork | None = None) -> None:
        """Make the controller with a network; the shipped one by default."""
        self._network = network or shipped_network()
        self._cruise = Pid(*CRUISE_GAINS, integral_limit=INTEGRAL_LIMIT)

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Forget the last episode; the law draws nothing.

        Raises:
            UsageError: the scenario has no sensor, or its road has curves.
        """
        if scenario.sensor is None:
            raise UsageError(f"controller cal needs a laser scan, and scenario {scenario.name} has no sensor")
        if not scenario.road.straight:
            raise UsageError(
                f"controller cal has learned hazards on straight roads, and the one of scenario {scenario.name} has "
                "curves; leave road.parts out, or take another controller"
            )
        self._deceleration = scenario.car.deceleration
        self._duration = scenario.control_duration
        self._perception = Perception(scenario)
        self._scan: Scan | None = None
        self._cruise.reset()
        self.probability = 0.0

    def sense(self, scan: Scan) -> None:
        """Take the scan of the coming control period."""
        self._scan = scan

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Return the acceleration (m/s²); the adversary's true state is not looked at.

        Raises:
            ValueError: no scan came since the last command.
        """
        if self._scan is None:
            raise ValueError("controller cal was given no scan for this moment: call sense before command")
        perception = self._perception
        perception.update(self._scan, car)
        self._scan = None
        features = np.concatenate([perception.features(car.speed), perception.cautious_features(car.speed)])
        self.probability = float(self._network.probability(features).max(initial=0.0))
        return self._decide(car.speed)

    def _decide(self, speed: float) -> float:
        """Return the acceleration (m/s²) of one decision; the first condition that holds wins."""
        kmh = speed * KILOMETRES_PER_HOUR
        throttle = brake = 0.0
        if self.probability > HAZARD_PROBABILITY:
            brake = 1.0
            self._cruise.pause()
        elif kmh > SPEED_LIMIT + OVERSPEED:
            brake = min(1.0, OVERSPEED_BRAKE * kmh / SPEED_LIMIT)
            self._cruise.pause()
        else:
            throttle = min(MAXIMUM_THROTTLE, max(0.0, self._cruise.step(SPEED_LIMIT - kmh, self._duration)))
        return pedal_acceleration(throttle, brake, speed, self._deceleration)
