"""From pedals to accelerations, and the PID that moves them.

The published controllers command throttle and brake of a simulated car; a car of SKD takes an acceleration. The map:
brake b in (0, 1] decelerates by b times the scenario's full deceleration, throttle u in [0, 1] accelerates by
u · 3 m/s², less a drag of 0.05/s times the speed (0.4 m/s² at 30 km/h: a car that coasts slows down). A brake of 1 is
then what the basic car does.
"""

from __future__ import annotations

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
