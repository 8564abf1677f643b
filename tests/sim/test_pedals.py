from __future__ import annotations

import pytest
from skd_sim.controllers.carla_agent import DRAG, MAXIMUM_ACCELERATION, Pid, pedal_acceleration, sub_steps


def test_pedals():
    assert pedal_acceleration(0.0, 1.0, 8.0, 3.5) == -3.5
    assert pedal_acceleration(0.8, 0.5, 8.0, 3.5) == -1.75  # any brake overrides the throttle
    assert pedal_acceleration(0.5, 0.0, 0.0, 3.5) == 0.5 * MAXIMUM_ACCELERATION
    assert pedal_acceleration(0.0, 0.0, 10.0, 3.5) == -10.0 * DRAG


@pytest.mark.parametrize(("time_step", "count"), [(0.3, 6), (0.05, 1), (0.02, 1), (0.1, 2), (0.32, 6)])
def test_decisions_of_a_tick(time_step, count):
    steps, duration = sub_steps(time_step)
    assert steps == count
    assert steps * duration == pytest.approx(time_step)


def test_pid_of_a_ramp():
    """For error e = k·t sampled at the end of each step: P·k·t + I·Σ k·t·Δt + D·k, by hand."""
    pid = Pid(2.0, 3.0, 5.0, integral_limit=1e9)
    step, slope = 0.05, 4.0
    outputs = [pid.step(slope * step * n, step) for n in range(1, 11)]
    integral = slope * step * step * 55  # 1 + 2 + … + 10
    assert outputs[-1] == pytest.approx(2.0 * slope * step * 10 + 3.0 * integral + 5.0 * slope)
    assert outputs[0] == pytest.approx(2.0 * slope * step + 3.0 * slope * step * step)  # no derivative yet


def test_pid_integral_is_clamped_and_survives_a_pause():
    pid = Pid(0.0, 1.0, 1.0, integral_limit=20.0)
    for _ in range(1000):
        output = pid.step(1.0, 0.05)
    assert output == 20.0
    pid.pause()
    assert pid.step(-1.0, 1.0) == 19.0  # no jump of the derivative
    pid.reset()
    assert pid.step(-1.0, 1.0) == -1.0
