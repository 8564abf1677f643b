"""The multi-body model: sprung mass, two axles, four wheels, tyres; 29 states, and the parameters of a BMW 320i.

The equations are those of Althoff and Würsching, "CommonRoad: Vehicle Models" (2020), section "Multi-Body Model", which
follow the vehicle dynamics of the US Department of Transportation (Allen et al., DOT HS 807 956, 1992). Both axles obey
the same equations, so here they are written once. Valid from walking pace on; below it slip is not defined.

Parameters: vehicle 2 of CommonRoad, tables 6 and 7, with the values of the package commonroad-vehicle-models 3.0.2
(BSD-3-Clause); symbols are theirs, so that equations and tables can be compared. Tyre forces: the Magic Formula for
combined slip (Pacejka), as reduced in section 9. Road friction scales the peak coefficients of both directions
(Pacejka's λ_μ) and leaves the slip stiffness alone.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from skd_sim.arrays import FloatArray
from skd_sim.inputs.yaml_file import read_yaml
from skd_sim.kernels.compilation import kernel

GRAVITY = 9.81  # m/s², as in the source


class Vehicle(NamedTuple):
    """Masses, geometry, suspension, wheels and limits of one car."""

    m: float  # mass, kg
    m_s: float  # sprung mass, kg
    m_uf: float  # unsprung mass, front, kg
    m_ur: float  # unsprung mass, rear, kg
    a: float  # centre of gravity to front axle, m
    b: float  # centre of gravity to rear axle, m
    I_Phi_s: float  # moment of inertia of the sprung mass, roll, kg·m²
    I_y_s: float  # the same, pitch, kg·m²
    I_z: float  # the same, yaw, kg·m²
    I_xz_s: float  # the same, product, kg·m²
    K_sf: float  # spring rate, front, N/m
    K_sdf: float  # damping rate, front, N·s/m
    K_sr: float  # spring rate, rear, N/m
    K_sdr: float  # damping rate, rear, N·s/m
    T_f: float  # track width, front, m
    T_r: float  # track width, rear, m
    K_ras: float  # lateral spring rate of the compliant joint between sprung and unsprung mass, N/m
    K_tsf: float  # auxiliary torsional roll stiffness, front, N·m/rad
    K_tsr: float  # the same, rear, N·m/rad
    K_rad: float  # damping rate of the compliant joint, N·s/m
    K_zt: float  # vertical spring rate of a tyre, N/m
    h_cg: float  # height of the centre of gravity, m
    h_raf: float  # height of the roll axis, front, m
    h_rar: float  # the same, rear, m
    h_s: float  # height of the sprung mass's centre of gravity, m
    I_uf: float  # moment of inertia of the front unsprung mass about x, kg·m²
    I_ur: float  # the same, rear, kg·m²
    I_y_w: float  # moment of inertia of a wheel, kg·m²
    K_lt: float  # lateral compliance of tyre, wheel and suspension, m/N
    R_w: float  # effective radius of a wheel, m
    T_sb: float  # share of the front axle in the brake torque
    T_se: float  # share of the front axle in the engine torque
    D_f: float  # camber by suspension travel, front, rad/m
    D_r: float  # the same, rear, rad/m
    E_f: float  # camber by squared suspension travel, front, rad/m²
    E_r: float  # the same, rear, rad/m²
    a_max: float  # greatest acceleration, m/s²
    v_switch: float  # speed from which power limits the acceleration, m/s


class Tyre(NamedTuple):
    """Coefficients of the Magic Formula (Pacejka), as reduced in the source; dimensionless or per rad."""

    p_cx1: float
    p_dx1: float
    p_dx3: float
    p_ex1: float
    p_kx1: float
    p_hx1: float
    p_vx1: float
    r_bx1: float
    r_bx2: float
    r_cx1: float
    r_ex1: float
    r_hx1: float
    p_cy1: float
    p_dy1: float
    p_dy3: float
    p_ey1: float
    p_ky1: float
    p_hy1: float
    p_hy3: float
    p_vy1: float
    p_vy3: float
    r_by1: float
    r_by2: float
    r_by3: float
    r_cy1: float
    r_ey1: float
    r_hy1: float
    r_vy1: float
    r_vy3: float
    r_vy4: float
    r_vy5: float
    r_vy6: float


_PARAMETERS = read_yaml(Path(__file__).with_name("bmw_320i.yaml"))
BMW_320I = Vehicle(**_PARAMETERS["vehicle"])
SOURCE_TYRE = Tyre(**_PARAMETERS["tyre"])

# Three offsets are left out of the car that drives. With p_hx1 and p_vx1 a tyre pushes at zero slip, that is, makes
# energy from nothing; r_vy1 pulls the same way on both sides of the car, and nobody steers against it here.
TYRE = SOURCE_TYRE._replace(p_hx1=0.0, p_vx1=0.0, r_vy1=0.0)


@kernel
def _curve(slope: float, curvature: float, slip: float) -> float:
    """Return the argument that the sine or cosine of the Magic Formula's shape factor multiplies."""
    scaled = slope * slip
    return math.atan(scaled - curvature * (scaled - math.atan(scaled)))


@kernel
def straight_force(slip: float, camber: float, load: float, tyre: Tyre, friction: float) -> float:
    """Return the force along the wheel's plane (N) at zero slip angle: what `tyre_forces` gives there, sooner."""
    if load <= 0.0:
        return 0.0
    # Pure slip. The source has the vertical shift within the argument of the sine, and so have we.
    mu_x = friction * tyre.p_dx1 * (1.0 - tyre.p_dx3 * camber * camber)
    stiffness_x = tyre.p_kx1 / (tyre.p_cx1 * mu_x)
    angle_x = tyre.p_cx1 * _curve(stiffness_x, tyre.p_ex1, tyre.p_hx1 - slip) + load * tyre.p_vx1
    return mu_x * load * math.sin(angle_x)


@kernel
def tyre_forces(
    slip: float, slip_angle: float, camber: float, load: float, tyre: Tyre, friction: float
) -> tuple[float, float]:
    """Return the forces on a wheel along and across its plane, N.

    Args:
        slip: 1 − R·ω/v; positive under braking.
        slip_angle: angle between the wheel's plane and its motion, rad.
        camber: angle by which the wheel leans, rad.
        load: vertical force, N; a wheel in the air (≤ 0) has no force.
        tyre: coefficients of the tyre.
        friction: friction of the road, relative to the road on which the coefficients were measured.
    """
    if load <= 0.0:
        return 0.0, 0.0
    side = 1.0 if camber > 0.0 else (-1.0 if camber < 0.0 else 0.0)
    along = straight_force(slip, camber, load, tyre, friction)
    # Across, pure slip.
    mu_y = friction * tyre.p_dy1 * (1.0 - tyre.p_dy3 * camber * camber)
    stiffness_y = tyre.p_ky1 / (tyre.p_cy1 * mu_y)
    shift = side * (tyre.p_hy1 + tyre.p_hy3 * abs(camber))
    lift = side * load * (tyre.p_vy1 + tyre.p_vy3 * abs(camber))
    across = mu_y * load * math.sin(tyre.p_cy1 * _curve(stiffness_y, tyre.p_ey1, slip_angle + shift)) + lift
    # Combined slip: each direction loses by the slip of the other.
    slope_x = tyre.r_bx1 * math.cos(math.atan(tyre.r_bx2 * slip))
    weight_x = math.cos(tyre.r_cx1 * _curve(slope_x, tyre.r_ex1, slip_angle + tyre.r_hx1))
    weight_x /= math.cos(tyre.r_cx1 * _curve(slope_x, tyre.r_ex1, tyre.r_hx1))
    slope_y = tyre.r_by1 * math.cos(math.atan(tyre.r_by2 * (slip_angle - tyre.r_by3)))
    weight_y = math.cos(tyre.r_cy1 * _curve(slope_y, tyre.r_ey1, slip + tyre.r_hy1))
    weight_y /= math.cos(tyre.r_cy1 * _curve(slope_y, tyre.r_ey1, tyre.r_hy1))
    pull = mu_y * load * (tyre.r_vy1 + tyre.r_vy3 * camber) * math.cos(math.atan(tyre.r_vy4 * slip_angle))
    pull *= math.sin(tyre.r_vy5 * math.atan(tyre.r_vy6 * slip))
    return along * weight_x, across * weight_y + pull


def peak_slip(tyre: Tyre, friction: float) -> float:
    """Return the slip at which a rolling tyre brakes best, found by bisection on the pure-slip curve."""
    slope = tyre.p_kx1 / (tyre.p_cx1 * friction * tyre.p_dx1)
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if tyre.p_cx1 * _curve(slope, tyre.p_ex1, middle) < 0.5 * math.pi:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


# The states. Positions in m, angles in rad; z points down and is 0 for the sprung mass at rest on rigid springs.
X, Y, STEERING, SPEED, YAW, YAW_RATE = range(6)  # SPEED is along the car's x axis
ROLL, ROLL_RATE, PITCH, PITCH_RATE, LATERAL_SPEED, HEIGHT, VERTICAL_SPEED = range(6, 13)
FRONT = 13  # of the front axle: roll, roll rate, lateral speed, height, vertical speed
REAR = 18  # of the rear axle, likewise
WHEELS = 23  # angular speeds: front left, front right, rear left, rear right, rad/s
JOINTS = 27  # lateral displacement of the compliant joints, front and rear
STATES = 29


class WheelInput(NamedTuple):
    """Torques on the wheels, and how the brake treats a wheel that is about to lock."""

    steering_rate: float  # of the front wheels, rad/s
    brake_front: float  # on each front wheel, N·m, ≥ 0, against its rotation
    brake_rear: float  # on each rear wheel
    drive_front: float  # on each front wheel, N·m
    drive_rear: float  # on each rear wheel
    release_begin: float  # slip from which the anti-lock brake releases
    release_end: float  # slip at which it has released altogether


class _Axle(NamedTuple):
    """What of a vehicle belongs to one axle."""

    lever: float  # from the centre of gravity, forward, m
    track: float
    static: float  # load of the sprung mass on one suspension, N
    spring: float
    damper: float
    torsion: float
    roll_centre: float
    mass: float
    inertia: float
    camber: float
    camber2: float


@kernel
def _wheel(
    spin: float, slip: float, force: float, brake: float, drive: float, command: WheelInput, vehicle: Vehicle
) -> float:
    """Return a wheel's angular acceleration, rad/s²; a brake stops a wheel and does not turn it backwards."""
    if slip > command.release_begin:
        brake *= max(0.0, (command.release_end - slip) / (command.release_end - command.release_begin))
    rate = (drive - brake - vehicle.R_w * force) / vehicle.I_y_w
    return 0.0 if spin <= 0.0 and rate < 0.0 else rate


@kernel
def _axle(
    x: FloatArray,
    at: int,
    wheels: int,
    joint: float,
    steering: float,
    axle: _Axle,
    brake: float,
    drive: float,
    command: WheelInput,
    vehicle: Vehicle,
    tyre: Tyre,
    friction: float,
    out: FloatArray,
) -> tuple[float, float, float, float, float]:
    """Write the derivatives of an axle's own states; return what it does to the sprung mass.

    Returns:
        Longitudinal force (N), yaw moment (N·m), joint force (N), both suspensions' force (N), roll moment (N·m).
    """
    radius, half = vehicle.R_w, 0.5 * axle.track
    roll, yaw_rate, speed = x[ROLL], x[YAW_RATE], x[SPEED]
    roll_u, roll_rate_u, z_u = x[at], x[at + 1], x[at + 3]
    cos_roll, sin_roll = math.cos(roll), math.sin(roll)
    cos_u, sin_u = math.cos(roll_u), math.sin(roll_u)
    cos_steer, sin_steer = math.cos(steering), math.sin(steering)
    # Tyres: load, slip, slip angle, camber.
    load_l = max(0.0, (z_u + radius * (cos_u - 1.0) - half * sin_u) * vehicle.K_zt)
    load_r = max(0.0, (z_u + radius * (cos_u - 1.0) + half * sin_u) * vehicle.K_zt)
    sideways = x[LATERAL_SPEED] + axle.lever * yaw_rate
    ahead_l, ahead_r = speed + half * yaw_rate, speed - half * yaw_rate
    slip_l = 1.0 - radius * x[wheels] / (ahead_l * cos_steer + sideways * sin_steer)
    slip_r = 1.0 - radius * x[wheels + 1] / (ahead_r * cos_steer + sideways * sin_steer)
    contact = sideways - roll_rate_u * (radius - z_u)
    angle_l = math.atan(contact / ahead_l) - steering
    angle_r = math.atan(contact / ahead_r) - steering
    rise = vehicle.h_s - radius + z_u - x[HEIGHT]
    travel = rise / cos_roll - vehicle.h_s + radius + axle.lever * x[PITCH]
    travel_l, travel_r = travel + (roll - roll_u) * half, travel - (roll - roll_u) * half
    camber_l = roll + axle.camber * travel_l + axle.camber2 * travel_l * travel_l
    camber_r = roll - axle.camber * travel_r - axle.camber2 * travel_r * travel_r
    fx_l, fy_l = tyre_forces(slip_l, angle_l, camber_l, load_l, tyre, friction)
    fx_r, fy_r = tyre_forces(slip_r, angle_r, camber_r, load_r, tyre, friction)
    along = (fx_l + fx_r) * cos_steer - (fy_l + fy_r) * sin_steer
    across = (fy_l + fy_r) * cos_steer + (fx_l + fx_r) * sin_steer
    turn = axle.lever * across + half * ((fy_r - fy_l) * sin_steer + (fx_l - fx_r) * cos_steer)
    # The compliant joint between axle and sprung mass.
    drop = axle.roll_centre - radius
    tilt, tilt_rate = roll - roll_u, x[ROLL_RATE] - roll_rate_u
    rise_rate = x[at + 4] - x[VERTICAL_SPEED]
    joint_rate = sideways - x[at + 2]
    gap = rise * sin_roll - joint * cos_roll - drop * math.sin(tilt)
    gap_rate = (rise * cos_roll + joint * sin_roll) * x[ROLL_RATE] + rise_rate * sin_roll
    gap_rate -= joint_rate * cos_roll + drop * math.cos(tilt) * tilt_rate
    pin = gap * vehicle.K_ras + gap_rate * vehicle.K_rad
    # Springs and dampers.
    travel_rate = rise_rate + axle.lever * x[PITCH_RATE]
    twist = tilt * axle.torsion / axle.track
    left = axle.static - travel_l * axle.spring - (travel_rate + half * tilt_rate) * axle.damper + twist
    right = axle.static - travel_r * axle.spring - (travel_rate - half * tilt_rate) * axle.damper - twist
    roll_moment = half * (left - right) - pin / cos_roll * (rise - drop * cos_u)
    # The axle itself.
    moment = half * (right - left) - pin * drop - across * (radius - z_u)
    moment += load_l * (radius * sin_u + half * cos_u - vehicle.K_lt * fy_l)
    moment -= load_r * (-radius * sin_u + half * cos_u + vehicle.K_lt * fy_r)
    out[at] = roll_rate_u
    out[at + 1] = moment / axle.inertia
    out[at + 2] = (across - pin * cos_roll - (left + right) * sin_roll) / axle.mass - yaw_rate * speed
    out[at + 3] = x[at + 4]
    out[at + 4] = GRAVITY - (load_l + load_r + pin * sin_roll - (left + right) * cos_roll) / axle.mass
    out[wheels] = _wheel(x[wheels], slip_l, fx_l, brake, drive, command, vehicle)
    out[wheels + 1] = _wheel(x[wheels + 1], slip_r, fx_r, brake, drive, command, vehicle)
    return along, turn, pin, left + right, roll_moment


@kernel
def _is_straight(x: FloatArray, command: WheelInput, tyre: Tyre) -> bool:
    """Whether left and right are mirror images, and will remain so."""
    for i in (STEERING, YAW_RATE, ROLL, ROLL_RATE, LATERAL_SPEED, JOINTS, JOINTS + 1):
        if x[i] != 0.0:
            return False
    for i in range(3):
        if x[FRONT + i] != 0.0 or x[REAR + i] != 0.0:
            return False
    mirrored = x[WHEELS] == x[WHEELS + 1] and x[WHEELS + 2] == x[WHEELS + 3]
    return mirrored and command.steering_rate == 0.0 and tyre.r_vy1 == 0.0


@kernel
def _straight_axle(
    x: FloatArray,
    at: int,
    wheels: int,
    axle: _Axle,
    brake: float,
    drive: float,
    command: WheelInput,
    vehicle: Vehicle,
    tyre: Tyre,
    friction: float,
    out: FloatArray,
) -> tuple[float, float]:
    """Do what `_axle` does, where lateral forces cancel; return longitudinal and suspension force, N."""
    radius, z_u = vehicle.R_w, x[at + 3]
    load = max(0.0, z_u * vehicle.K_zt)
    slip = 1.0 - radius * x[wheels] / x[SPEED]
    travel = vehicle.h_s - radius + z_u - x[HEIGHT] - vehicle.h_s + radius + axle.lever * x[PITCH]
    camber = axle.camber * travel + axle.camber2 * travel * travel
    force = straight_force(slip, camber, load, tyre, friction)
    travel_rate = x[at + 4] - x[VERTICAL_SPEED] + axle.lever * x[PITCH_RATE]
    lift = 2.0 * (axle.static - travel * axle.spring - travel_rate * axle.damper)
    out[at + 3] = x[at + 4]
    out[at + 4] = GRAVITY - (2.0 * load - lift) / axle.mass
    out[wheels] = out[wheels + 1] = _wheel(x[wheels], slip, force, brake, drive, command, vehicle)
    return 2.0 * force, lift


@kernel
def _axles(v: Vehicle) -> tuple[_Axle, _Axle]:
    """Return the front and the rear axle of a vehicle."""
    share = v.m_s * GRAVITY / (2.0 * (v.a + v.b))
    front = _Axle(
        v.a, v.T_f, share * v.b, v.K_sf, v.K_sdf, v.K_tsf, v.h_raf, v.m_uf, v.I_uf, v.D_f, v.E_f
    )  # fmt: skip
    rear = _Axle(
        -v.b, v.T_r, share * v.a, v.K_sr, v.K_sdr, v.K_tsr, v.h_rar, v.m_ur, v.I_ur, v.D_r, v.E_r
    )  # fmt: skip
    return front, rear


@kernel
def straight_derivative(
    x: FloatArray, command: WheelInput, vehicle: Vehicle, tyre: Tyre, friction: float, out: FloatArray
) -> None:
    """Write the time derivative of a car that goes straight: `full_derivative`, in a tenth of its time."""
    v = vehicle
    front, rear = _axles(v)
    out[:] = 0.0
    along_f, lift_f = _straight_axle(
        x, FRONT, WHEELS, front, command.brake_front, command.drive_front, command, v, tyre, friction, out
    )
    along_r, lift_r = _straight_axle(
        x, REAR, WHEELS + 2, rear, command.brake_rear, command.drive_rear, command, v, tyre, friction, out
    )
    along = along_f + along_r
    out[X], out[Y] = math.cos(x[YAW]) * x[SPEED], math.sin(x[YAW]) * x[SPEED]
    out[SPEED] = along / v.m
    out[PITCH] = x[PITCH_RATE]
    out[PITCH_RATE] = (v.a * lift_f - v.b * lift_r + along * (v.h_s - x[HEIGHT])) / v.I_y_s
    out[HEIGHT] = x[VERTICAL_SPEED]
    out[VERTICAL_SPEED] = GRAVITY - (lift_f + lift_r) / v.m_s


@kernel
def full_derivative(
    x: FloatArray, command: WheelInput, vehicle: Vehicle, tyre: Tyre, friction: float, out: FloatArray
) -> None:
    """Write the time derivative of the 29 states.

    Args:
        x: states; the speed along the car has to be above about 0.1 m/s.
        command: torques on the wheels.
        vehicle: parameters of the vehicle.
        tyre: parameters of the tyres.
        friction: friction of the road, relative to a dry one.
        out: 29 values, overwritten.
    """
    v = vehicle
    front, rear = _axles(v)
    along_f, turn_f, pin_f, lift_f, roll_f = _axle(
        x, FRONT, WHEELS, x[JOINTS], x[STEERING], front, command.brake_front, command.drive_front, command, v, tyre,
        friction, out,
    )  # fmt: skip
    along_r, turn_r, pin_r, lift_r, roll_r = _axle(
        x, REAR, WHEELS + 2, x[JOINTS + 1], 0.0, rear, command.brake_rear, command.drive_rear, command, v, tyre,
        friction, out,
    )  # fmt: skip
    along, turn, roll_moment = along_f + along_r, turn_f + turn_r, roll_f + roll_r
    pin, lift = pin_f + pin_r, lift_f + lift_r
    speed, sideways, yaw_rate = x[SPEED], x[LATERAL_SPEED], x[YAW_RATE]
    cos_roll, sin_roll = math.cos(x[ROLL]), math.sin(x[ROLL])
    course = x[YAW] + math.atan(sideways / speed)
    total = math.sqrt(speed * speed + sideways * sideways)
    out[X] = math.cos(course) * total
    out[Y] = math.sin(course) * total
    out[STEERING] = command.steering_rate
    out[SPEED] = along / v.m + yaw_rate * sideways
    out[YAW] = yaw_rate
    out[YAW_RATE] = (turn + v.I_xz_s / v.I_Phi_s * roll_moment) / (v.I_z - v.I_xz_s * v.I_xz_s / v.I_Phi_s)
    out[ROLL] = x[ROLL_RATE]
    out[ROLL_RATE] = (v.I_xz_s / v.I_z * turn + roll_moment) / (v.I_Phi_s - v.I_xz_s * v.I_xz_s / v.I_z)
    out[PITCH] = x[PITCH_RATE]
    out[PITCH_RATE] = (v.a * lift_f - v.b * lift_r + along * (v.h_s - x[HEIGHT])) / v.I_y_s
    out[LATERAL_SPEED] = (pin * cos_roll + lift * sin_roll) / v.m_s - yaw_rate * speed
    out[HEIGHT] = x[VERTICAL_SPEED]
    out[VERTICAL_SPEED] = GRAVITY - (lift * cos_roll - pin * sin_roll) / v.m_s
    out[JOINTS] = sideways + v.a * yaw_rate - x[FRONT + 2]
    out[JOINTS + 1] = sideways - v.b * yaw_rate - x[REAR + 2]


@kernel
def derivative(
    x: FloatArray, command: WheelInput, vehicle: Vehicle, tyre: Tyre, friction: float, out: FloatArray
) -> None:
    """Write the time derivative of the 29 states, by the shorter way where the car goes straight."""
    if _is_straight(x, command, tyre):
        straight_derivative(x, command, vehicle, tyre, friction, out)
    else:
        full_derivative(x, command, vehicle, tyre, friction, out)
