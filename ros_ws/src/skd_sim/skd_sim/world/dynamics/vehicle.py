"""Parameters of the multi-body car: vehicle 2 of CommonRoad, a BMW 320i, and its tyres.

Source: Althoff and Würsching, "CommonRoad: Vehicle Models", 2020, tables 6 and 7, with the values of the package
commonroad-vehicle-models 3.0.2 (BSD-3-Clause); symbols are theirs, so that equations and tables can be compared.
"""

from __future__ import annotations

from typing import NamedTuple

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


BMW_320I = Vehicle(
    m=1093.2952334674046,
    m_s=965.7108098804363,
    m_uf=63.7921826056784,
    m_ur=63.7921826056784,
    a=1.1561957064,
    b=1.4227170936,
    I_Phi_s=207.26524557936952,
    I_y_s=1565.8178787125541,
    I_z=1791.5995300122856,
    I_xz_s=0.0,
    K_sf=24453.137879749014,
    K_sdf=1786.2441002440723,
    K_sr=19635.504745231297,
    K_sdr=1649.0833034887382,
    T_f=1.38684,
    T_r=1.36398,
    K_ras=175186.65943700788,
    K_tsf=-6914.881688272133,
    K_tsr=-2643.6009520155308,
    K_rad=10215.732056044453,
    K_zt=158294.1398119115,
    h_cg=0.5748689544000001,
    h_raf=0.0,
    h_rar=0.0,
    h_s=0.61373004,
    I_uf=30.673279563178017,
    I_ur=29.670408143156248,
    I_y_w=1.7,
    K_lt=1.6430724599974725e-05,
    R_w=0.344,
    T_sb=0.66,
    T_se=0.0,
    D_f=-0.39370078740157477,
    D_r=-0.905511811023622,
    E_f=0.0,
    E_r=0.0,
    a_max=11.5,
    v_switch=7.319,
)

SOURCE_TYRE = Tyre(
    p_cx1=1.6411,
    p_dx1=1.1739,
    p_dx3=0.0,
    p_ex1=0.46403,
    p_kx1=22.303,
    p_hx1=0.0012297,
    p_vx1=-8.8098e-06,
    r_bx1=13.276,
    r_bx2=-13.778,
    r_cx1=1.2568,
    r_ex1=0.65225,
    r_hx1=0.0050722,
    p_cy1=1.3507,
    p_dy1=1.0489,
    p_dy3=-2.8821,
    p_ey1=-0.0074722,
    p_ky1=-21.92,
    p_hy1=0.0026747,
    p_hy3=0.031415,
    p_vy1=0.037318,
    p_vy3=-0.32931,
    r_by1=7.1433,
    r_by2=9.1916,
    r_by3=-0.027856,
    r_cy1=1.0719,
    r_ey1=-0.27572,
    r_hy1=5.7448e-06,
    r_vy1=-0.027825,
    r_vy3=-0.27568,
    r_vy4=12.12,
    r_vy5=1.9,
    r_vy6=-10.704,
)

# Three offsets are left out of the car that drives. With p_hx1 and p_vx1 a tyre pushes at zero slip, that is, makes
# energy from nothing; r_vy1 pulls the same way on both sides of the car, and nobody steers against it here.
TYRE = SOURCE_TYRE._replace(p_hx1=0.0, p_vx1=0.0, r_vy1=0.0)
