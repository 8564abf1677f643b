"""The files into which the processes of a graph print, and which of them explains what went wrong."""

from __future__ import annotations

from pathlib import Path

CONTROLLER, ADVERSARY, SIMULATOR = "car_controller", "adversary", "vehicle_simulator"
_CALLED = {
    CONTROLLER: ("the car controller", CONTROLLER),
    ADVERSARY: ("the adversary", ADVERSARY),
    SIMULATOR: ("the vehicle simulator", SIMULATOR),
}


def concerned(reason: str) -> list[str]:
    """Return which processes the reason of an abort speaks of."""
    return [name for name, words in _CALLED.items() if any(word in reason for word in words)]


def log_of(folder: Path, reason: str) -> Path:
    """Return the log of the process that a reason speaks of first, where it has one, else the simulator's."""
    logs = [folder / f"{name}.log" for name in (*concerned(reason), SIMULATOR)]
    return next((log for log in logs if log.exists()), folder)
