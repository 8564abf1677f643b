"""The multi-body car, a BMW 320i: command → brake, engine and steering → wheels → motion, at 1 ms.

The equations are those of Althoff and Würsching, "CommonRoad: Vehicle Models" (2020). Until its first steering command
other than 0 those of section "Multi-Body Model", which follow the vehicle dynamics of the US Department of
Transportation (Allen et al., DOT HS 807 956, 1992): left and right are alike, so all that rolls, yaws or slides is
zero. From then on the "Single-Track Drift Model": it yaws and slides, and the load moves between the axles at once. The
body neither rolls nor pitches. Both are valid from walking pace on; below it slip is not defined.

Parameters: vehicle 2 of CommonRoad, tables 6 and 7, with the values of the package commonroad-vehicle-models 3.0.2
(BSD-3-Clause); symbols are theirs, so that equations and tables can be compared. Tyre forces: the Magic Formula of pure
and of combined slip (Pacejka), as reduced in section 9, without the offsets by which a tyre pushes at zero slip, makes
energy from nothing, and tells left from right. Road friction scales the peak coefficients (Pacejka's λ_μ) and leaves
the slip stiffness alone.

The brake has a dead time and then a pressure that changes at a limited rate, as every friction brake. UN Regulation
13-H allows a passenger car 0.6 s from the pedal to the required deceleration; the equation of its stopping distance,
0.1·v [km/h], stands for a loss of 0.36 s.

Fourth-order Runge-Kutta. The stiffest part is a wheel's spin against its tyre, whose rate grows as 1/speed; below about
4 m/s a step is therefore divided. Below `LOW_SPEED` the car rolls as one body: of a stop from 25/3 m/s that is the last
1/770 of the way.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.dynamics.basic import GRAVITY, PEAK_FRICTION, Noise
from skd_sim.world.state import CarState, FloatArray, Pair, draw_relative, on_grid


class Vehicle(NamedTuple):
    """Masses, geometry, suspension, wheels and limits of the car."""

    m: float = 1093.2952334674046  # mass, kg
    m_s: float = 965.7108098804363  # sprung mass, kg
    m_uf: float = 63.7921826056784  # unsprung mass, front, kg
    m_ur: float = 63.7921826056784  # unsprung mass, rear, kg
    a: float = 1.1561957064  # centre of gravity to front axle, m
    b: float = 1.4227170936  # centre of gravity to rear axle, m
    I_y_s: float = 1565.8178787125541  # moment of inertia of the sprung mass, pitch, kg·m²
    I_z: float = 1791.5995300122856  # moment of inertia, yaw, kg·m²
    K_sf: float = 24453.137879749014  # spring rate, front, N/m
    K_sdf: float = 1786.2441002440723  # damping rate, front, N·s/m
    K_sr: float = 19635.504745231297  # spring rate, rear, N/m
    K_sdr: float = 1649.0833034887382  # damping rate, rear, N·s/m
    K_zt: float = 158294.1398119115  # vertical spring rate of a tyre, N/m
    h_s: float = 0.61373004  # height of the sprung mass's centre of gravity, m
    I_y_w: float = 1.7  # moment of inertia of a wheel, kg·m²
    R_w: float = 0.344  # effective radius of a wheel, m
    T_sb: float = 0.66  # share of the front axle in the brake torque
    T_se: float = 0.0  # share of the front axle in the engine torque
    a_max: float = 11.5  # greatest acceleration, m/s²
    v_switch: float = 7.319  # speed from which power limits the acceleration, m/s
    v_max: float = 0.4  # greatest rate of the steering angle, rad/s


class Tyre(NamedTuple):
    """Coefficients of the Magic Formula (Pacejka), as reduced in the source; dimensionless."""

    p_cx1: float = 1.6411
    p_dx1: float = PEAK_FRICTION
    p_ex1: float = 0.46403
    p_kx1: float = 22.303
    r_bx1: float = 13.276
    r_bx2: float = -13.778
    r_cx1: float = 1.2568
    r_ex1: float = 0.65225
    p_cy1: float = 1.3507
    p_dy1: float = 1.0489
    p_ey1: float = -0.0074722
    p_ky1: float = -21.92
    r_by1: float = 7.1433
    r_by2: float = 9.1916
    r_cy1: float = 1.0719
    r_ey1: float = -0.27572


BMW_320I, TYRE = Vehicle(), Tyre()

# The states. Positions in m, the pitch in rad; z points down and is 0 for the sprung mass at rest on rigid springs.
AHEAD, SPEED, PITCH, PITCH_RATE, HEIGHT, VERTICAL_SPEED = range(6)
FRONT, REAR = 6, 8  # of each axle: height, vertical speed
WHEELS = 10  # angular speeds of the front and of the rear wheels, rad/s
# Of a car that has been steered; place, heading and speed are the world's: AHEAD is x, SPEED that along its course.
LEFT, HEADING, YAW_RATE, DRIFT, ANGLE = range(2, 7)  # y, m; rad; rad/s; course less heading, and of the front wheels
STATES = 12
LOW_SPEED = 0.3  # m/s
_STEP = 0.001  # s
_PATH_STEP = 0.01  # s; at 1 g a uniform motion in between is wrong by a tenth of a millimetre
_STABLE = 2.0  # rate × step of the stiffest mode; Runge-Kutta of fourth order holds up to 2.78
# An anti-lock brake keeps a wheel near the slip at which it brakes best: torque begins to go at the first multiple of
# that slip and is gone at the second. The curve is flat between them: within 4 % of its peak.
_RELEASE, _NEVER = (0.7, 2.0), (2.0, 3.0)
_NOW, _NEXT, _QUEUE = 0, 1, 2  # places in a brake's state: deceleration now, next place to read in the queue, the queue


@kernel
def _curve(slope: float, curvature: float, slip: float) -> float:
    """Return the argument that the sine of the Magic Formula's shape factor multiplies."""
    scaled = slope * slip
    return math.atan(scaled - curvature * (scaled - math.atan(scaled)))


@kernel
def tyre_force(slip: float, load: float, friction: float) -> float:
    """Return the force on a wheel along the road, N.

    Args:
        slip: 1 − R·ω/v; positive under braking.
        load: vertical force, N; a wheel in the air (≤ 0) has no force.
        friction: friction of the road, relative to the road on which the coefficients were measured.
    """
    if load <= 0.0:
        return 0.0
    peak = friction * TYRE.p_dx1
    stiffness = TYRE.p_kx1 / (TYRE.p_cx1 * peak)
    return peak * load * math.sin(TYRE.p_cx1 * _curve(stiffness, TYRE.p_ex1, -slip))


@kernel
def tyre_forces(slip: float, angle: float, load: float, friction: float) -> Pair:
    """Return the forces along and to the left of an axle's wheels, N, which lessen each other.

    Args:
        slip: see `tyre_force`, as the others.
        angle: by which the wheels' course is to the left of where they point, rad.
        load: vertical force, N.
        friction: friction of the road.
    """
    peak = friction * TYRE.p_dy1
    curve = _curve(TYRE.p_ky1 / (TYRE.p_cy1 * peak), TYRE.p_ey1, angle)
    aside = peak * load * math.sin(TYRE.p_cy1 * curve)
    along = tyre_force(slip, load, friction)
    # On a slippery road forces peak at slips as much smaller; each lessens the other at these slips, too (similarity).
    slip, angle = slip / friction, angle / friction
    slope = TYRE.r_by1 * math.cos(math.atan(TYRE.r_by2 * angle))
    aside *= math.cos(TYRE.r_cy1 * _curve(slope, TYRE.r_ey1, slip))
    slope = TYRE.r_bx1 * math.cos(math.atan(TYRE.r_bx2 * slip))
    return along * math.cos(TYRE.r_cx1 * _curve(slope, TYRE.r_ex1, angle)), aside


def peak_slip(friction: float) -> float:
    """Return the slip at which a rolling tyre brakes best, found by bisection on the curve."""
    slope = TYRE.p_kx1 / (TYRE.p_cx1 * friction * TYRE.p_dx1)
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        rising = TYRE.p_cx1 * _curve(slope, TYRE.p_ex1, middle) < 0.5 * math.pi
        low, high = (middle, high) if rising else (low, middle)
    return 0.5 * (low + high)


class WheelTorques(NamedTuple):
    """Torques on the wheels, N·m on each, and how the brake treats a wheel that is about to lock."""

    brakes: Pair  # of the front and of the rear axle, ≥ 0, against their rotation
    drives: Pair
    release: Pair  # slip from which the anti-lock brake releases, and at which it has released altogether
    pull: float = 0.0  # acceleration by which the load moves between the axles of a car that was steered, m/s²
    steered: bool = False


class _Axle(NamedTuple):
    """What of a vehicle belongs to one axle."""

    lever: float  # from the centre of gravity, forward, m
    static: float  # load of the sprung mass on one suspension, N
    spring: float
    damper: float
    mass: float


@kernel
def _spin(speed: float, slip: float, force: float, brake: float, drive: float, command: WheelTorques) -> float:
    """Return the angular acceleration of a wheel of an angular speed (rad/s), rad/s²."""
    begin, end = command.release
    if slip > begin:
        brake *= max(0.0, (end - slip) / (end - begin))
    rate = (drive - brake - BMW_320I.R_w * force) / BMW_320I.I_y_w
    return 0.0 if speed <= 0.0 and rate < 0.0 else rate  # a brake does not turn a wheel backwards


@kernel
def _axle(
    x: FloatArray,
    at: int,
    wheels: int,
    axle: _Axle,
    torques: Pair,
    command: WheelTorques,
    friction: float,
    out: FloatArray,
) -> Pair:
    """Write the derivatives of an axle's own states; return its longitudinal and its suspension force, N."""
    radius, z_u = BMW_320I.R_w, x[at]
    load = max(0.0, z_u * BMW_320I.K_zt)
    slip = 1.0 - radius * x[wheels] / x[SPEED]
    travel = BMW_320I.h_s - radius + z_u - x[HEIGHT] - BMW_320I.h_s + radius + axle.lever * x[PITCH]
    force = tyre_force(slip, load, friction)
    travel_rate = x[at + 1] - x[VERTICAL_SPEED] + axle.lever * x[PITCH_RATE]
    lift = 2.0 * (axle.static - travel * axle.spring - travel_rate * axle.damper)
    out[at] = x[at + 1]
    out[at + 1] = GRAVITY - (2.0 * load - lift) / axle.mass
    out[wheels] = _spin(x[wheels], slip, force, torques[0], torques[1], command)
    return 2.0 * force, lift


@kernel
def _steered_derivative(x: FloatArray, command: WheelTorques, friction: float, out: FloatArray) -> None:
    """Write the time derivative of the states of a car that was steered; see `derivative`."""
    v, speed, rate, drift, angle = BMW_320I, x[SPEED], x[YAW_RATE], x[DRIFT], x[ANGLE]
    ahead, left = speed * math.cos(drift), speed * math.sin(drift)
    fixed, moved, base = v.m * GRAVITY, v.m * command.pull * v.h_s, v.a + v.b
    rolls = max(LOW_SPEED, ahead * math.cos(angle) + (left + v.a * rate) * math.sin(angle))
    slip_f, slip_r = 1.0 - v.R_w * x[WHEELS] / rolls, 1.0 - v.R_w * x[WHEELS + 1] / max(LOW_SPEED, ahead)
    course_f = math.atan((left + v.a * rate) / max(LOW_SPEED, ahead))
    course_r = math.atan((left - v.b * rate) / max(LOW_SPEED, ahead))
    along_f, aside_f = tyre_forces(slip_f, course_f - angle, (fixed * v.b - moved) / base, friction)
    along_r, aside_r = tyre_forces(slip_r, course_r, (fixed * v.a + moved) / base, friction)
    push = along_f * math.cos(angle) - aside_f * math.sin(angle) + along_r
    turn = along_f * math.sin(angle) + aside_f * math.cos(angle)
    out[:] = 0.0
    out[AHEAD], out[LEFT] = speed * math.cos(x[HEADING] + drift), speed * math.sin(x[HEADING] + drift)
    out[SPEED] = (push * math.cos(drift) + (turn + aside_r) * math.sin(drift)) / v.m
    out[HEADING], out[YAW_RATE] = rate, (v.a * turn - v.b * aside_r) / v.I_z
    out[DRIFT] = ((turn + aside_r) * math.cos(drift) - push * math.sin(drift)) / (v.m * speed) - rate
    out[WHEELS] = _spin(x[WHEELS], slip_f, 0.5 * along_f, command.brakes[0], command.drives[0], command)
    out[WHEELS + 1] = _spin(x[WHEELS + 1], slip_r, 0.5 * along_r, command.brakes[1], command.drives[1], command)


@kernel
def derivative(x: FloatArray, command: WheelTorques, friction: float, out: FloatArray) -> None:
    """Write the time derivative of the states.

    Args:
        x: states; the speed has to be above about 0.1 m/s.
        command: torques on the wheels.
        friction: friction of the road, relative to a dry one.
        out: overwritten.
    """
    if command.steered:
        _steered_derivative(x, command, friction, out)
        return
    v = BMW_320I
    share = v.m_s * GRAVITY / (2.0 * (v.a + v.b))
    front = _Axle(v.a, share * v.b, v.K_sf, v.K_sdf, v.m_uf)
    rear = _Axle(-v.b, share * v.a, v.K_sr, v.K_sdr, v.m_ur)
    (brake_f, brake_r), (drive_f, drive_r) = command.brakes, command.drives
    along_f, lift_f = _axle(x, FRONT, WHEELS, front, (brake_f, drive_f), command, friction, out)
    along_r, lift_r = _axle(x, REAR, WHEELS + 1, rear, (brake_r, drive_r), command, friction, out)
    along = along_f + along_r
    out[AHEAD] = x[SPEED]
    out[SPEED] = along / v.m
    out[PITCH] = x[PITCH_RATE]
    out[PITCH_RATE] = (v.a * lift_f - v.b * lift_r + along * (v.h_s - x[HEIGHT])) / v.I_y_s
    out[HEIGHT] = x[VERTICAL_SPEED]
    out[VERTICAL_SPEED] = GRAVITY - (lift_f + lift_r) / v.m_s


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


@kernel
def _runge_kutta(x: FloatArray, command: WheelTorques, friction: float, step: float, work: FloatArray) -> None:
    """Advance the states by one step, in place; `work` is 5 × STATES."""
    k1, k2, k3, k4, at = work[0], work[1], work[2], work[3], work[4]
    derivative(x, command, friction, k1)
    for i in range(STATES):
        at[i] = x[i] + 0.5 * step * k1[i]
    derivative(at, command, friction, k2)
    for i in range(STATES):
        at[i] = x[i] + 0.5 * step * k2[i]
    derivative(at, command, friction, k3)
    for i in range(STATES):
        at[i] = x[i] + step * k3[i]
    derivative(at, command, friction, k4)
    for i in range(STATES):
        x[i] += step / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    for i in (WHEELS, WHEELS + 1, SPEED):
        x[i] = max(0.0, x[i])


@kernel
def _roll(x: FloatArray, rest: FloatArray, acceleration: float, step: float, steered: bool) -> None:
    """Advance the car as one body at walking pace, its springs at rest; only an engine makes wheels turn faster."""
    before, after = x[SPEED], max(0.0, x[SPEED] + acceleration * step)
    distance = 0.5 * step * (before + after)
    x[SPEED] = after
    if steered:
        bend = math.tan(x[ANGLE]) / (BMW_320I.a + BMW_320I.b)
        x[DRIFT] = math.atan(BMW_320I.b * bend)
        bend *= math.cos(x[DRIFT])
        x[AHEAD] += distance * math.cos(x[HEADING] + x[DRIFT])
        x[LEFT] += distance * math.sin(x[HEADING] + x[DRIFT])
        x[HEADING], x[YAW_RATE] = x[HEADING] + bend * distance, bend * after
    else:
        x[AHEAD] += distance
        for i in range(PITCH, WHEELS):
            x[i] = rest[i]
    for i in range(WHEELS, STATES):
        x[i] = after / BMW_320I.R_w if acceleration > 0.0 else min(x[i], after / BMW_320I.R_w)


@kernel
def _advance(
    x: FloatArray,
    brake: FloatArray,
    rest: FloatArray,
    demand: Pair,
    steered: bool,
    brake_rate: float,
    slips: Pair,
    stiffness: float,
    friction: float,
    step: float,
    steps_per_knot: int,
    path: FloatArray,
) -> None:
    """Drive on, and write pose and speed at every knot but the first to `path`; not steered, the way for x alone."""
    work = np.empty((5, STATES))
    # The wheels' spin is braked, too: with its share a command within the grip is what the car does.
    mass_radius = BMW_320I.m * BMW_320I.R_w + 4.0 * BMW_320I.I_y_w / BMW_320I.R_w
    grip = friction * TYRE.p_dx1 * GRAVITY
    acceleration, angle = demand
    turn = BMW_320I.v_max * step
    for knot in range(1, path.shape[0]):
        for _ in range(steps_per_knot):
            slowing = apply_brake(brake, max(0.0, -acceleration), brake_rate, step)
            speed = x[SPEED]
            limit = BMW_320I.a_max * min(1.0, BMW_320I.v_switch / max(speed, BMW_320I.v_switch))
            driving = 0.0 if slowing > 0.0 else min(limit, max(0.0, acceleration))
            pull = driving - min(grip, slowing)
            if steered:
                x[ANGLE] += min(turn, max(-turn, angle - x[ANGLE]))
            if speed < LOW_SPEED:
                _roll(x, rest, pull, step, steered)
                continue
            braked, driven = 0.5 * BMW_320I.T_sb * mass_radius * slowing, 0.5 * BMW_320I.T_se * mass_radius * driving
            brakes = (braked, 0.5 * (1.0 - BMW_320I.T_sb) * mass_radius * slowing)
            drives = (driven, 0.5 * (1.0 - BMW_320I.T_se) * mass_radius * driving)
            command = WheelTorques(brakes, drives, slips, pull, steered)
            parts = math.ceil(step * stiffness / (_STABLE * speed))
            for _ in range(parts):
                _runge_kutta(x, command, friction, step / parts, work)
        path[knot, 0], path[knot, 1], path[knot, 2], path[knot, 3] = x[AHEAD], x[LEFT], on_grid(x[HEADING]), x[SPEED]


def rest_state() -> FloatArray:
    """Return the states of the car at rest on its springs: every derivative but those of the motion is zero."""
    state = np.zeros(STATES)
    share = BMW_320I.m_s / (BMW_320I.a + BMW_320I.b)
    front = (share * BMW_320I.b + BMW_320I.m_uf) * GRAVITY / (2.0 * BMW_320I.K_zt)
    rear = (share * BMW_320I.a + BMW_320I.m_ur) * GRAVITY / (2.0 * BMW_320I.K_zt)
    pitch = (rear - front) / (BMW_320I.a + BMW_320I.b)
    state[FRONT], state[REAR] = front, rear
    state[PITCH], state[HEIGHT] = pitch, front + BMW_320I.a * pitch
    return state


class MultiBodyCar:
    """BMW 320i of CommonRoad, driven by acceleration and steering angle; it goes straight until it is steered.

    A negative command is a demand on the brake, which takes its delay, rate and capacity from the scenario; a positive
    one is engine torque, up to the vehicle's power. Torques are those at which the car, tyres permitting, accelerates
    as commanded. While the brake still holds there is no engine torque. There is no
    rolling and no air resistance: in neutral the car rolls on. The scenario's `acceleration_noise` changes the commands
    of a tick; `speed_noise`, which has no cause in such a car, is not used.

    Attributes:
        state: its states, since it was reset.
        steered: whether it has been steered since.
    """

    def __init__(self, scenario: Scenario, *, step: float = _STEP) -> None:
        """Build the car.

        Args:
            scenario: gives friction, brake and noise.
            step: greatest integration step, s.
        """
        car = scenario.car
        knots = math.ceil(scenario.control_duration / _PATH_STEP - 1e-9)
        self._knot = scenario.control_duration / knots
        self._steps_per_knot = math.ceil(self._knot / step - 1e-9)
        self._step = self._knot / self._steps_per_knot
        self._car, self._friction = car, scenario.road.friction
        peak = peak_slip(self._friction)
        self._slips = (_RELEASE[0] * peak, _RELEASE[1] * peak) if car.antilock else _NEVER
        load = 0.5 * BMW_320I.m * GRAVITY  # at most about half of the car on one wheel
        torque = 0.5 * BMW_320I.T_sb * BMW_320I.m * BMW_320I.R_w * car.brake_limit
        slope = BMW_320I.R_w * TYRE.p_kx1 * load + torque / (self._slips[1] - self._slips[0])
        self._stiffness = BMW_320I.R_w * slope / BMW_320I.I_y_w
        self._rest = rest_state()
        self.state = self._rest.copy()

    def reset(self, car: CarState) -> None:
        """Put the car on the road, rolling freely with its brake released."""
        self._origin, self.steered = car, False
        self.state = self._rest.copy()
        self.state[SPEED] = car.speed
        self.state[WHEELS:] = car.speed / BMW_320I.R_w
        self._brake = new_brake(self._car.brake_delay, self._step)

    def draw(self, rng: np.random.Generator) -> Noise:
        """Draw the command's perturbation; the speed has none."""
        return Noise(0.0, draw_relative(self._car.acceleration_noise, rng))

    def advance(self, command: Pair, duration: float, noise: Noise) -> FloatArray:
        """Drive on; see `CarDynamics`.

        Raises:
            ValueError: the duration is not a whole number of parts of about 10 ms of the scenario's control period.
        """
        acceleration, steering = command
        x, y, heading, _ = self._origin
        if steering != 0.0 and not self.steered:
            self.steered, gone = True, self.state[AHEAD]
            self.state[PITCH:WHEELS] = 0.0
            self.state[[AHEAD, LEFT, HEADING]] = x + math.cos(heading) * gone, y + math.sin(heading) * gone, heading
        knots = round(duration / self._knot)
        if knots < 1 or abs(knots * self._knot - duration) > 1e-9:
            raise ValueError(f"duration {duration:g} s must be a multiple of {self._knot:g} s")
        driven = np.empty((knots + 1, 4))
        driven[0] = self.state[[AHEAD, LEFT, HEADING, SPEED]]
        driven[0, 2] = on_grid(driven[0, 2])
        _advance(
            self.state,
            self._brake,
            self._rest,
            (max(-self._car.brake_limit, acceleration * (1.0 + noise.acceleration)), steering),
            self.steered,
            self._car.brake_rate,
            self._slips,
            self._stiffness,
            self._friction,
            self._step,
            self._steps_per_knot,
            driven,
        )
        if self.steered:
            return driven
        path = np.full((knots + 1, 4), heading)
        path[:, 0] = x + math.cos(heading) * driven[:, 0]
        path[:, 1] = y + math.sin(heading) * driven[:, 0]
        path[:, 3] = driven[:, 3]
        return path
