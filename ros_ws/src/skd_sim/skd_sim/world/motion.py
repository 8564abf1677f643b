"""Motion of the car and of the adversary over one time step.

Paper, section "The Cars": ν' = ν + U[−0.05ν, 0.05ν] + Δt·a with a itself perturbed by ±10 %. A car does not
reverse, so the speed is clamped at zero, and the distance travelled is the trapezoid Δt·(ν + ν')/2.
"""

from __future__ import annotations

import numpy as np

from skd_sim.kernels.compilation import kernel


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
