"""rclpy.timer: callbacks at a fixed period of a clock."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from rosless.callback_groups import CallbackGroup
from rosless.clock import Clock
from rosless.context import Context
from rosless.exceptions import InvalidHandle, ROSInterruptException
from rosless.utilities import get_default_context


class Timer:
    """Calls back each time a period of its clock has passed."""

    def __init__(
        self,
        callback: Callable[..., Any] | None,
        callback_group: CallbackGroup,
        timer_period_ns: int,
        clock: Clock,
        *,
        context: Context | None = None,
        autostart: bool = True,
    ) -> None:
        if timer_period_ns < 0:
            raise ValueError("timer period must not be negative")
        self._context = get_default_context() if context is None else context
        self._clock = clock
        self._period = int(timer_period_ns)
        self.callback = callback
        self.callback_group = callback_group
        self._canceled = not autostart
        self._destroyed = False
        self._simulated = not clock.follows_wall
        self._last_call = clock.nanoseconds_now()
        self._next_call = self._last_call + self._period

    @property
    def clock(self) -> Clock:
        """The clock that this timer follows."""
        return self._clock

    @property
    def timer_period_ns(self) -> int:
        """The period in nanoseconds."""
        return self._period

    @timer_period_ns.setter
    def timer_period_ns(self, value: int) -> None:
        self._period = int(value)

    def is_ready(self) -> bool:
        """True if the callback is due."""
        return not self._canceled and not self._destroyed and self.time_until_next_call() <= 0

    def is_canceled(self) -> bool:
        """True after :meth:`cancel` and before :meth:`reset`."""
        return self._canceled

    def cancel(self) -> None:
        """Stop until :meth:`reset`."""
        self._canceled = True

    def reset(self) -> None:
        """Start again: the callback is due one period from now."""
        self._last_call = self._clock.nanoseconds_now()
        self._next_call = self._last_call + self._period
        self._canceled = False

    def time_since_last_call(self) -> int:
        """Nanoseconds since the callback was due last."""
        return self._clock.nanoseconds_now() - self._last_call

    def time_until_next_call(self) -> int:
        """Nanoseconds until the callback is due; negative if it is late."""
        now = self._clock.nanoseconds_now()
        if now < self._last_call or self._simulated == self._clock.follows_wall:
            # the clock was set back (another run of a simulation), or began to follow /clock
            self._simulated = not self._clock.follows_wall
            self._last_call = now
            self._next_call = now + self._period
        elif self._simulated and now == 0:
            return self._period  # no /clock message yet
        return self._next_call - now

    def take(self) -> tuple[Callable[..., Any], tuple[()]] | None:
        """Count this call, and say what to run."""
        if self._canceled or self._destroyed:
            return None
        now = self._clock.nanoseconds_now()
        self._last_call = now
        self._next_call += self._period
        if self._next_call < now:
            # periods that were missed are skipped, not made up for
            missed = (now - self._next_call) // self._period + 1 if self._period else 0
            self._next_call = self._next_call + missed * self._period if self._period else now
        return None if self.callback is None else (self.callback, ())

    def destroy(self) -> None:
        """Stop for good."""
        self._destroyed = True


class Rate:
    """Sleeps in step with a timer, in a thread other than the executor's."""

    def __init__(self, timer: Timer, *, context: Context) -> None:
        self._timer = timer
        self._event = threading.Event()
        self._is_shutdown = False
        self._is_destroyed = False
        timer.callback = self._event.set
        context.on_shutdown(self._on_shutdown)

    def _on_shutdown(self) -> None:
        self._is_shutdown = True
        self.destroy()

    def destroy(self) -> None:
        """Wake sleepers for the last time."""
        self._is_destroyed = True
        self._event.set()

    def sleep(self) -> None:
        """Block until the timer fires; in a callback of a single-threaded executor, that is for ever."""
        if self._is_shutdown:
            raise ROSInterruptException
        if self._is_destroyed:
            raise RuntimeError("Rate cannot sleep because it has been destroyed")
        if self._timer._destroyed:
            raise InvalidHandle("Rate cannot sleep because the timer has been destroyed")
        self._event.wait()
        self._event.clear()
        if self._is_shutdown:
            raise ROSInterruptException


class TimerInfo:
    """Not supported in Jazzy; here so that it can be imported."""
