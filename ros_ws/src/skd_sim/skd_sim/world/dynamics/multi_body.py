"""Right-hand side of the multi-body model: sprung mass, two axles, four wheels; 29 states.

The equations are those of Althoff and Würsching, "CommonRoad: Vehicle Models" (2020), section "Multi-Body Model", which
follow the vehicle dynamics of the US Department of Transportation (Allen et al., DOT HS 807 956, 1992). Both axles obey
the same equations, so here they are written once. Valid from walking pace on; below it slip is not defined.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel
from skd_sim.world.dynamics.tyre import straight_force, tyre_forces
from skd_sim.world.dynamics.vehicle import GRAVITY, Tyre, Vehicle

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
