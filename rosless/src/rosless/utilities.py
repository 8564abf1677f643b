"""rclpy.utilities."""

from __future__ import annotations

import threading

from rosless.arguments import remove_ros_args
from rosless.constants import S_TO_NS
from rosless.context import Context

__all__ = [
    "get_available_rmw_implementations",
    "get_default_context",
    "get_rmw_implementation_identifier",
    "ok",
    "remove_ros_args",
    "shutdown",
    "timeout_sec_to_nsec",
    "try_shutdown",
]

_default_context: Context | None = None
_lock = threading.RLock()


def get_default_context(*, shutting_down: bool = False) -> Context:
    """The context that is used where none is given."""
    global _default_context
    with _lock:
        context = _default_context
        if context is None:
            context = _default_context = Context()
        if shutting_down:
            _default_context = None
        return context


def ok(*, context: Context | None = None) -> bool:
    """True if a context is initialised and not shut down."""
    return (get_default_context() if context is None else context).ok()


def shutdown(*, context: Context | None = None) -> None:
    """Shut a context down."""
    (get_default_context(shutting_down=True) if context is None else context).shutdown()


def try_shutdown(*, context: Context | None = None) -> None:
    """Shut a context down if that has not been done; init() can be called again then."""
    global _default_context
    if context is not None:
        context.try_shutdown()
        return
    with _lock:
        default = get_default_context()
        default.try_shutdown()
        if not default.ok():
            _default_context = None


def get_rmw_implementation_identifier() -> str:
    """What carries the messages."""
    return "rosless_cyclonedds"


def get_available_rmw_implementations() -> set[str]:
    """What could carry the messages."""
    return {get_rmw_implementation_identifier()}


def timeout_sec_to_nsec(timeout_sec: float | None) -> int:
    """Nanoseconds of a timeout; -1 for one that is None or negative, as that means for ever."""
    return -1 if timeout_sec is None or timeout_sec < 0 else int(float(timeout_sec) * S_TO_NS)
