"""Tyre forces: the Magic Formula for combined slip (Pacejka), as reduced by Althoff and Würsching (2020), section 9.

Road friction scales the peak coefficients of both directions (Pacejka's λ_μ) and leaves the slip stiffness alone.
"""

from __future__ import annotations

import math

from skd_sim.kernels.compilation import kernel
from skd_sim.world.dynamics.vehicle import Tyre


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
