"""rclpy.logging: levels, format and filters of rcutils, to stderr."""

from __future__ import annotations

import os
import sys
import threading
import time
from enum import IntEnum
from typing import Any

_FORMAT_VARIABLE = "RCUTILS_CONSOLE_OUTPUT_FORMAT"
_DEFAULT_FORMAT = "[{severity}] [{time}] [{name}]: {message}"


class LoggingSeverity(IntEnum):
    """Severity levels."""

    UNSET = 0
    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


_COLOURS = {10: "\033[32m", 30: "\033[33m", 40: "\033[31m", 50: "\033[35m"}
_FILTERS = ("throttle_duration_sec", "throttle_time_source_type", "skip_first", "once")

_levels: dict[str, LoggingSeverity] = {}
_default_level = LoggingSeverity.INFO
_write_lock = threading.Lock()


class RcutilsLogger:
    """A named logger; dots in names make a hierarchy from which levels are inherited."""

    def __init__(self, name: str = "") -> None:
        self.name = name
        self._calls: dict[Any, list[float]] = {}

    def get_child(self, name: str) -> RcutilsLogger:
        """The logger below this one."""
        if not name:
            raise ValueError("Child logger name must not be empty.")
        return get_logger(f"{self.name}.{name}" if self.name else name)

    def set_level(self, level: LoggingSeverity | int) -> None:
        """Set the lowest severity that is shown."""
        set_logger_level(self.name, level)

    def get_effective_level(self) -> LoggingSeverity:
        """The level of this logger, or of the nearest one above it that has one."""
        name = self.name
        while name:
            if _levels.get(name):
                return _levels[name]
            name = name.rpartition(".")[0]
        return _levels.get("") or _default_level

    def is_enabled_for(self, severity: LoggingSeverity | int) -> bool:
        """True if a message of this severity would be shown."""
        return self.get_effective_level() <= severity

    def log(self, message: str, severity: LoggingSeverity | int, **kwargs: Any) -> bool:
        """Show a message if level and filters allow it; True if they do."""
        unknown = [name for name in kwargs if name not in _FILTERS and name != "name"]
        if unknown:
            raise TypeError(f'parameter "{unknown[0]}" is not one of the recognized logging options "{_FILTERS}"')
        severity = LoggingSeverity(severity)
        if kwargs and not self._passes(kwargs):
            return False
        if not self.is_enabled_for(severity):
            return False
        _emit(kwargs.get("name", self.name), severity, message)
        return True

    def debug(self, message: str, **kwargs: Any) -> bool:
        """Log with severity DEBUG."""
        return self.log(message, LoggingSeverity.DEBUG, **kwargs)

    def info(self, message: str, **kwargs: Any) -> bool:
        """Log with severity INFO."""
        return self.log(message, LoggingSeverity.INFO, **kwargs)

    def warning(self, message: str, **kwargs: Any) -> bool:
        """Log with severity WARN."""
        return self.log(message, LoggingSeverity.WARN, **kwargs)

    def warn(self, message: str, **kwargs: Any) -> bool:
        """Log with severity WARN."""
        return self.log(message, LoggingSeverity.WARN, **kwargs)

    def error(self, message: str, **kwargs: Any) -> bool:
        """Log with severity ERROR."""
        return self.log(message, LoggingSeverity.ERROR, **kwargs)

    def fatal(self, message: str, **kwargs: Any) -> bool:
        """Log with severity FATAL."""
        return self.log(message, LoggingSeverity.FATAL, **kwargs)

    def _passes(self, options: dict[str, Any]) -> bool:
        """Whether the filters of a call let it through; each place in the code counts for itself."""
        throttle = options.get("throttle_duration_sec")
        if throttle is None and "throttle_time_source_type" in options:
            raise TypeError('required parameter "throttle_duration_sec" not specified but is required')
        frame = sys._getframe(1)
        while frame.f_back is not None and frame.f_code.co_filename == __file__:
            frame = frame.f_back
        place = frame.f_code, frame.f_lasti
        count_and_last = self._calls.setdefault(place, [0, float("-inf")])
        count_and_last[0] += 1
        if options.get("skip_first") and count_and_last[0] == 1:
            return False
        if options.get("once") and count_and_last[0] > (2 if options.get("skip_first") else 1):
            return False
        if throttle is not None:
            now = _throttle_clock(options.get("throttle_time_source_type"))
            if now < count_and_last[1]:  # a simulated clock was set back
                count_and_last[1] = float("-inf")
            if now - count_and_last[1] < float(throttle):
                return False
            count_and_last[1] = now
        return True


def _throttle_clock(source: Any) -> float:
    nanoseconds = getattr(source, "nanoseconds_now", None)
    return nanoseconds() / 1e9 if nanoseconds is not None else time.monotonic()


def _emit(name: str, severity: LoggingSeverity, message: str) -> None:
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    text = os.environ.get(_FORMAT_VARIABLE) or _DEFAULT_FORMAT
    values = {
        "severity": severity.name,
        "time": f"{seconds}.{nanoseconds:09d}",
        "time_as_nanoseconds": f"{seconds * 1_000_000_000 + nanoseconds}",
        "name": name,
        "message": str(message),
    }
    for key, value in values.items():
        if key != "message":
            text = text.replace("{" + key + "}", value)
    text = text.replace("{message}", values["message"])
    stream = sys.stdout if os.environ.get("RCUTILS_LOGGING_USE_STDOUT") == "1" else sys.stderr
    colour = _COLOURS.get(severity, "")
    choice = os.environ.get("RCUTILS_COLORIZED_OUTPUT")
    if colour and (choice == "1" or (choice is None and stream.isatty())):
        text = f"{colour}{text}\033[0m"
    with _write_lock:
        stream.write(text + "\n")
        stream.flush()


_loggers: dict[str, RcutilsLogger] = {}


def get_logger(name: str) -> RcutilsLogger:
    """The logger of this name."""
    if not name:
        raise ValueError("Logger name must not be empty.")
    return _loggers.setdefault(name, RcutilsLogger(name))


def set_logger_level(name: str, level: LoggingSeverity | int, detailed_error: bool = False) -> None:
    """Set the level of a logger; the empty name is the default of all."""
    _levels[name] = LoggingSeverity(level)


def get_logger_level(name: str) -> LoggingSeverity:
    """The level that was set for a logger, or UNSET."""
    return _levels.get(name, LoggingSeverity.UNSET)


def get_logger_effective_level(name: str) -> LoggingSeverity:
    """The level that holds for a logger."""
    return RcutilsLogger(name).get_effective_level()


def get_logging_severity_from_string(log_severity: str) -> LoggingSeverity:
    """The severity of a name, whatever its case."""
    try:
        return LoggingSeverity[log_severity.upper()]
    except KeyError:
        raise RuntimeError(f"invalid severity level {log_severity!r}") from None


def initialize() -> None:
    """Nothing to do; here for rclpy's sake."""


def shutdown() -> None:
    """Nothing to do; here for rclpy's sake."""


def clear_config() -> None:
    """Forget all levels."""
    _levels.clear()
