"""rclpy.clock: system, steady and ROS time; ROS time follows /clock when a node uses simulated time."""

from __future__ import annotations

import time as system_time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rosless.duration import Duration
from rosless.exceptions import NotInitializedException
from rosless.time import CLOCK_TYPE_ERROR, ClockType, Time

if TYPE_CHECKING:
    from rosless.context import Context

# Between two looks at a simulated clock while a thread sleeps on it.
_SLEEP_STEP_S = 0.002
_LONGEST_SLEEP_S = 0.1


class Clock:
    """A source of time."""

    def __new__(cls, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> Clock:  # noqa: D102
        if not isinstance(clock_type, ClockType):
            raise TypeError(CLOCK_TYPE_ERROR)
        if clock_type is ClockType.ROS_TIME and not issubclass(cls, ROSClock):
            return super().__new__(ROSClock)
        return super().__new__(cls)

    def __init__(self, *, clock_type: ClockType = ClockType.SYSTEM_TIME) -> None:
        self._clock_type = clock_type

    @property
    def clock_type(self) -> ClockType:
        """Which time this clock gives."""
        return self._clock_type

    def __repr__(self) -> str:
        return f"Clock(clock_type={self._clock_type.name})"

    def now(self) -> Time:
        """The current time."""
        return Time(nanoseconds=self.nanoseconds_now(), clock_type=self._clock_type)

    def nanoseconds_now(self) -> int:
        """The current time in nanoseconds, without an object around it."""
        if self._clock_type is ClockType.STEADY_TIME:
            return system_time.monotonic_ns()
        return system_time.time_ns()

    @property
    def follows_wall(self) -> bool:
        """True if this clock goes on by itself, so that a wait for it can be timed."""
        return True

    def create_jump_callback(self, threshold: Any, **callbacks: Callable[..., None]) -> Any:
        """Not supported."""
        raise NotImplementedError("rosless does not support Clock.create_jump_callback")

    def sleep_until(self, until: Time, context: Context | None = None) -> bool:
        """Sleep until a time of this clock; False if the context was shut down before."""
        from rosless.utilities import get_default_context

        context = get_default_context() if context is None else context
        if not context.ok():
            raise NotInitializedException
        if until.clock_type != self._clock_type:
            raise ValueError("until's clock type does not match this clock's type")
        simulated = not self.follows_wall
        while context.ok():
            left = (until.nanoseconds - self.nanoseconds_now()) / 1e9
            if left <= 0:
                return True
            if simulated == self.follows_wall:  # the epoch changed, so the target lost its meaning
                return False
            system_time.sleep(_SLEEP_STEP_S if simulated else min(left, _LONGEST_SLEEP_S))
        return False

    def sleep_for(self, rel_time: Duration, context: Context | None = None) -> bool:
        """Sleep for a duration of this clock; False if the context was shut down before."""
        return self.sleep_until(self.now() + rel_time, context)


class ROSClock(Clock):
    """ROS time: system time, unless a time source overrides it."""

    def __new__(cls, **_: Any) -> ROSClock:  # noqa: D102
        return object.__new__(cls)

    def __init__(self, **_: Any) -> None:
        super().__init__(clock_type=ClockType.ROS_TIME)
        self._active = False
        self._override_ns = 0

    @property
    def ros_time_is_active(self) -> bool:
        """True while a time source overrides system time."""
        return self._active

    def _set_ros_time_is_active(self, enabled: bool) -> None:
        self._active = enabled

    def set_ros_time_override(self, time: Time) -> None:
        """Set the time that this clock shows while it is overridden."""
        if not isinstance(time, Time):
            raise TypeError(f"Time must be specified as rclpy.time.Time. Received type: {type(time)}")
        self._override_ns = time.nanoseconds

    def nanoseconds_now(self) -> int:
        """The current time in nanoseconds."""
        return self._override_ns if self._active else system_time.time_ns()

    @property
    def follows_wall(self) -> bool:
        """True unless the time is simulated."""
        return not self._active


class JumpThreshold:
    """Not supported; here so that it can be imported."""

    def __init__(self, **_: Any) -> None:
        raise NotImplementedError("rosless does not support clock jump callbacks")
