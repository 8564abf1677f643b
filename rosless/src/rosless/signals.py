"""rclpy.signals: SIGINT and SIGTERM shut the contexts down.

As with rclpy, SIGINT then goes on to the handler from before, so that a spin ends in KeyboardInterrupt;
after SIGTERM it ends in ExternalShutdownException.
"""

from __future__ import annotations

import signal
import threading
from enum import IntFlag
from types import FrameType
from typing import Any

from rosless.context import live_contexts


class SignalHandlerOptions(IntFlag):
    """Which handlers to install."""

    NO = 0
    SIGINT = 1
    SIGTERM = 2
    ALL = 3


_previous: dict[int, Any] = {}
_installed = SignalHandlerOptions.NO


def _handle(number: int, frame: FrameType | None) -> None:
    for context in live_contexts():
        context.try_shutdown()
    previous = _previous.get(number)
    if callable(previous):
        previous(number, frame)


def install_signal_handlers(options: SignalHandlerOptions = SignalHandlerOptions.ALL) -> None:
    """Install handlers; outside the main thread, where Python allows none, this does nothing."""
    global _installed
    if threading.current_thread() is not threading.main_thread():
        return
    for option, number in (
        (SignalHandlerOptions.SIGINT, signal.SIGINT),
        (SignalHandlerOptions.SIGTERM, signal.SIGTERM),
    ):
        if option in options and number not in _previous:
            _previous[number] = signal.signal(number, _handle)
            _installed |= option


def uninstall_signal_handlers() -> None:
    """Put the handlers from before back."""
    global _installed
    if threading.current_thread() is not threading.main_thread():
        return
    for number, previous in list(_previous.items()):
        if signal.getsignal(number) is _handle:
            signal.signal(number, previous if previous is not None else signal.SIG_DFL)
        del _previous[number]
    _installed = SignalHandlerOptions.NO


def get_current_signal_handlers_options() -> SignalHandlerOptions:
    """Which handlers are installed."""
    return _installed
