"""The multi-body car on the road: command → brake and engine → wheels → motion, at 1 ms.

The brake has a dead time and then a pressure that changes at a limited rate, as every friction brake. UN Regulation
13-H allows a passenger car 0.6 s from the pedal to the required deceleration; the equation of its stopping distance,
0.1·v [km/h], stands for a loss of 0.36 s.

Fourth-order Runge-Kutta. The stiffest part is a wheel's spin against its tyre, whose rate grows as 1/speed; below about
4 m/s a step is therefore divided. Below `LOW_SPEED` slip is not defined any more and the car rolls as one body: of a
stop from 25/3 m/s that is the last 1/770 of the way.
"""

from __future__ import annotations

import math

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.dynamics.basic import Noise
from skd_sim.world.dynamics.multi_body import (
    BMW_320I,
    FRONT,
    GRAVITY,
    HEIGHT,
    PITCH,
    REAR,
    SPEED,
    STATES,
    TYRE,
    WHEELS,
    YAW,
    Tyre,
    Vehicle,
    WheelInput,
    X,
    Y,
    derivative,
    peak_slip,
)
from skd_sim.world.state import CarState, draw_relative

_NOW, _NEXT, _QUEUE = 0, 1, 2  # places in the state: brake now (m/s²), next place of the queue to read, the queue


def new_brake(delay: float, step: float) -> FloatArray:
    """Return the state of a released brake.

    Args:
        delay: dead time, s; rounded to whole steps.
        step: duration of a step, s.
    """
    return np.zeros(_QUEUE + round(delay / step))


@kernel
def apply_brake(brake: FloatArray, demand: float, rate: float, step: float) -> float:
    """Advance the brake by one step and return the deceleration (m/s², ≥ 0) that its mean torque in it stands for.

    Args:
        brake: state, changed in place.
        demand: deceleration commanded now, m/s², ≥ 0.
        rate: limit on build-up and on release, m/s³.
        step: duration of a step, s.
    """
    length = brake.size - _QUEUE
    delayed = demand
    if length > 0:
        place = _QUEUE + int(brake[_NEXT])
        delayed = brake[place]
        brake[place] = demand
        brake[_NEXT] = (brake[_NEXT] + 1.0) % length
    change = rate * step
    before = brake[_NOW]
    brake[_NOW] = before + min(change, max(-change, delayed - before))
    return float(0.5 * (before + brake[_NOW]))


LOW_SPEED = 0.3  # m/s
_STEP = 0.001  # s
_PATH_STEP = 0.01  # s; at 1 g a uniform motion in between is wrong by a tenth of a millimetre
_STABLE = 2.0  # rate × step of the stiffest mode; Runge-Kutta of fourth order holds up to 2.78
# An anti-lock brake keeps a wheel near the slip at which it brakes best: torque begins to go at the first multiple of
# that slip and is gone at the second. The curve is flat between them: within 4 % of its peak.
_RELEASE = (0.7, 2.0)


@kernel
def _runge_kutta(
    x: FloatArray, command: WheelInput, vehicle: Vehicle, tyre: Tyre, friction: float, step: float, work: FloatArray
) -> None:
    """Advance the states by one step, in place; `work` is 5 × 29."""
    k1, k2, k3, k4, at = work[0], work[1], work[2], work[3], work[4]
    derivative(x, command, vehicle, tyre, friction, k1)
    for i in range(STATES):
        at[i] = x[i] + 0.5 * step * k1[i]
    derivative(at, command, vehicle, tyre, friction, k2)
    for i in range(STATES):
        at[i] = x[i] + 0.5 * step * k2[i]
    derivative(at, command, vehicle, tyre, friction, k3)
    for i in range(STATES):
        at[i] = x[i] + step * k3[i]
    derivative(at, command, vehicle, tyre, friction, k4)
    for i in range(STATES):
        x[i] += step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    for i in range(WHEELS, WHEELS + 4):
        x[i] = max(0.0, x[i])
    x[SPEED] = max(0.0, x[SPEED])


@kernel
def _roll(x: FloatArray, rest: FloatArray, acceleration: float, step: float, radius: float) -> None:
    """Advance the car as one body at walking pace, its springs at rest; only an engine makes wheels turn faster."""
    before, after = x[SPEED], max(0.0, x[SPEED] + acceleration * step)
    distance = 0.5 * step * (before + after)
    x[X] += distance * math.cos(x[YAW])
    x[Y] += distance * math.sin(x[YAW])
    x[SPEED] = after
    for i in range(YAW + 1, WHEELS):
        x[i] = rest[i]
    for i in range(WHEELS, WHEELS + 4):
        x[i] = after / radius if acceleration > 0.0 else min(x[i], after / radius)


@kernel
def _advance(
    x: FloatArray,
    brake: FloatArray,
    rest: FloatArray,
    acceleration: float,
    brake_rate: float,
    slips: tuple[float, float],
    stiffness: float,
    vehicle: Vehicle,
    tyre: Tyre,
    friction: float,
    step: float,
    steps_per_knot: int,
    path: FloatArray,
) -> None:
    """Drive on, and write x, y, yaw and speed of every knot but the first to `path`."""
    work = np.empty((5, STATES))
    # The wheels' spin is braked, too: with its share a command within the grip is what the car does.
    mass_radius = vehicle.m * vehicle.R_w + 4.0 * vehicle.I_y_w / vehicle.R_w
    grip = friction * tyre.p_dx1 * GRAVITY
    for knot in range(1, path.shape[0]):
        for _ in range(steps_per_knot):
            slowing = apply_brake(brake, max(0.0, -acceleration), brake_rate, step)
            speed = x[SPEED]
            limit = vehicle.a_max * min(1.0, vehicle.v_switch / max(speed, vehicle.v_switch))
            driving = 0.0 if slowing > 0.0 else min(limit, max(0.0, acceleration))
            if speed < LOW_SPEED:
                _roll(x, rest, driving - min(grip, slowing), step, vehicle.R_w)
                continue
            command = WheelInput(
                0.0,
                0.5 * vehicle.T_sb * mass_radius * slowing,
                0.5 * (1.0 - vehicle.T_sb) * mass_radius * slowing,
                0.5 * vehicle.T_se * mass_radius * driving,
                0.5 * (1.0 - vehicle.T_se) * mass_radius * driving,
                slips[0],
                slips[1],
            )
            parts = math.ceil(step * stiffness / (_STABLE * speed))
            for _ in range(parts):
                _runge_kutta(x, command, vehicle, tyre, friction, step / parts, work)
        path[knot, 0], path[knot, 1], path[knot, 2], path[knot, 3] = x[X], x[Y], x[YAW], x[SPEED]


def rest_state(vehicle: Vehicle) -> FloatArray:
    """Return the 29 states of the car at rest on its springs: every derivative but those of the motion is zero."""
    state = np.zeros(STATES)
    share = vehicle.m_s / (vehicle.a + vehicle.b)
    front = (share * vehicle.b + vehicle.m_uf) * GRAVITY / (2.0 * vehicle.K_zt)
    rear = (share * vehicle.a + vehicle.m_ur) * GRAVITY / (2.0 * vehicle.K_zt)
    pitch = (rear - front) / (vehicle.a + vehicle.b)
    state[FRONT + 3], state[REAR + 3] = front, rear
    state[PITCH], state[HEIGHT] = pitch, front + vehicle.a * pitch
    return state


class MultiBodyCar:
    """BMW 320i of CommonRoad, driven by an acceleration command; it goes straight.

    A negative command is a demand on the brake, which takes its delay, rate and capacity from the scenario; a positive
    one is engine torque, up to the vehicle's power. Torques are those at which the car, tyres permitting, accelerates
    as commanded. While the brake still holds there is no engine torque. There is no
    rolling and no air resistance: in neutral the car rolls on. The scenario's `acceleration_noise` changes the commands
    of a tick; `speed_noise`, which has no cause in such a car, is not used.

    Attributes:
        state: the 29 states, in a frame that begins where the car was reset, x ahead.
    """

    def __init__(
        self, scenario: Scenario, *, step: float = _STEP, vehicle: Vehicle = BMW_320I, tyre: Tyre = TYRE
    ) -> None:
        """Build the car.

        Args:
            scenario: gives friction, brake and noise.
            step: greatest integration step, s.
            vehicle: parameters of the vehicle.
            tyre: parameters of the tyres.
        """
        car = scenario.car
        knots = math.ceil(scenario.control_duration / _PATH_STEP - 1e-9)
        self._knot = scenario.control_duration / knots
        self._steps_per_knot = math.ceil(self._knot / step - 1e-9)
        self._step = self._knot / self._steps_per_knot
        self._car, self._vehicle, self._tyre, self._friction = car, vehicle, tyre, scenario.road.friction
        peak = peak_slip(tyre, self._friction)
        never = (2.0, 3.0)
        self._slips = (_RELEASE[0] * peak, _RELEASE[1] * peak) if car.antilock else never
        load = 0.5 * vehicle.m * GRAVITY  # at most about half of the car on one wheel
        torque = 0.5 * vehicle.T_sb * vehicle.m * vehicle.R_w * car.brake_limit
        slope = vehicle.R_w * tyre.p_kx1 * load + torque / (self._slips[1] - self._slips[0])
        self._stiffness = vehicle.R_w * slope / vehicle.I_y_w
        self._rest = rest_state(vehicle)
        self.state = self._rest.copy()

    def reset(self, car: CarState) -> None:
        """Put the car on the road, rolling freely with its brake released."""
        self._origin = car
        self.state = self._rest.copy()
        self.state[SPEED] = car.speed
        self.state[WHEELS : WHEELS + 4] = car.speed / self._vehicle.R_w
        self._brake = new_brake(self._car.brake_delay, self._step)

    def draw(self, rng: np.random.Generator) -> Noise:
        """Draw the command's perturbation; the speed has none."""
        return Noise(0.0, draw_relative(self._car.acceleration_noise, rng))

    def advance(self, acceleration: float, duration: float, noise: Noise) -> FloatArray:
        """Drive on; see `CarDynamics`.

        Raises:
            ValueError: the duration is not a whole number of parts of about 10 ms of the scenario's control period.
        """
        knots = round(duration / self._knot)
        if knots < 1 or abs(knots * self._knot - duration) > 1e-9:
            raise ValueError(f"duration {duration:g} s must be a multiple of {self._knot:g} s")
        applied = acceleration * (1.0 + noise.acceleration)
        path = np.empty((knots + 1, 4))
        path[0] = self.state[[X, Y, YAW, SPEED]]
        _advance(
            self.state,
            self._brake,
            self._rest,
            max(-self._car.brake_limit, applied),
            self._car.brake_rate,
            self._slips,
            self._stiffness,
            self._vehicle,
            self._tyre,
            self._friction,
            self._step,
            self._steps_per_knot,
            path,
        )
        origin = self._origin
        cos, sin = math.cos(origin.heading), math.sin(origin.heading)
        ahead, left = path[:, 0].copy(), path[:, 1].copy()
        path[:, 0] = origin.x + cos * ahead - sin * left
        path[:, 1] = origin.y + sin * ahead + cos * left
        path[:, 2] += origin.heading
        return path
