"""What SKD asks of a car under test."""

from __future__ import annotations

import functools
import inspect
import types
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol, TypeGuard, runtime_checkable

import numpy as np

from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import CONTROL_PERIODS, Scenario, check_control_period
from skd_sim.world.dynamics.basic import Command
from skd_sim.world.sensors import Scan
from skd_sim.world.state import AdversaryState, CarState, Scene


@runtime_checkable
class Controller(Protocol):
    """What SKD asks of a controller under test; a class with these two methods is enough.

    A controller that decides more often says so by an attribute `control_period` (s); otherwise the scenario decides.
    One that steers by the curvature of its path has an attribute `steers_by = "curvature"`.
    """

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Forget the last episode; draw randomness, if any, from `rng` only."""

    def command(self, car: CarState, adversary: AdversaryState) -> Command:
        """Return the acceleration (m/s²) for the coming control period, or that and a steering angle.

        The angle is of the front wheels, rad, positive to the left; the curvature is of the rear axle's path, 1/m.

        A controller whose second parameter is called `scene` gets a `skd_sim.world.state.Scene` instead: everybody.
        """


@runtime_checkable
class SensingController(Controller, Protocol):
    """A controller that perceives for itself: with this third method it gets the scan of each tick first."""

    def sense(self, scan: Scan) -> None:
        """Take the scan of the tick for which `command` is called next."""


def is_sensing(controller: object) -> TypeGuard[SensingController]:
    """Tell whether a controller is a `SensingController`; `isinstance` looks through the protocol anew each time."""
    return all(getattr(controller, method, None) is not None for method in ("reset", "command", "sense"))


@runtime_checkable
class BatchController(Controller, Protocol):
    """A controller that also answers many episodes at once: it keeps nothing from one command to the next."""

    def commands(self, cars: CarState, scenes: Any) -> Any:
        """Return the commands of n episodes, an array of n or n × 2; each is what `command` would return there.

        Args:
            cars: a `CarState` each field of which is an array of n numbers.
            scenes: what `command` gets as its second argument, with arrays of n numbers for numbers.
        """


def takes_batches(controller: object) -> bool:
    """Tell whether a controller answers many episodes at once; it, or who wraps it, says so.

    One that takes scans does not: it gets them one by one.
    """
    said = getattr(controller, "takes_batches", None)
    if isinstance(said, bool):
        return said
    return isinstance(controller, BatchController) and not is_sensing(controller)


def takes_scene(controller: object) -> bool:
    """Tell whether a controller wants to see all road users and not only the adversary, as it or its wrapper says."""
    said = getattr(controller, "takes_scene", None)
    if isinstance(said, bool):
        return said
    command = getattr(controller, "command", None)
    if isinstance(command, types.MethodType) and isinstance(command.__func__, types.FunctionType):
        return _names_of_method(command.__func__)[2:3] == ("scene",)  # behind self
    return _names_of(command)[1:2] == ("scene",)


def _names_of(command: Any) -> tuple[str, ...]:
    """Return the names of what a function takes; none where it is not known."""
    try:
        return tuple(inspect.signature(command).parameters)
    except (AttributeError, TypeError, ValueError):  # a user's class may be anything
        return ()


_names_of_method = functools.lru_cache(maxsize=256)(_names_of)
"""The same, remembered: each episode has a new controller, and to look at its method takes longer than a tick."""


def sight_of(controller: object, scenario: Scenario) -> Callable[[CarState, AdversaryState, int, int], Any]:
    """Return what gives the second argument of `command` from car, adversary, tick and control period."""
    if not takes_scene(controller):
        return lambda car, adversary, tick, period: adversary
    return lambda car, adversary, tick, period: Scene(car, adversary, scenario.others_at(tick, period))


def require_sensor(controller: Controller, name: str, scenario: Scenario) -> None:
    """Refuse a scenario that cannot give a controller, called `name`, the scans that it needs.

    Raises:
        UsageError: the controller senses, and the scenario has no sensor.
    """
    if is_sensing(controller) and scenario.sensor is None:
        raise UsageError(
            f"controller {name} needs a laser scan, and scenario {scenario.name} has none: add a section sensor "
            "as in the shipped scenario crossing"
        )


def control_period_of(controller: object, name: str) -> float | None:
    """Return the control period (s) that a controller, called `name`, declares; None if it declares none.

    Raises:
        UsageError: what it declares is no time that there may be between two decisions.
    """
    period = getattr(controller, "control_period", None)
    if period is None:
        return None
    number = isinstance(period, (int, float)) and not isinstance(period, bool)
    least, most = CONTROL_PERIODS
    if not number or not least <= period <= most:  # compared first: whole numbers may be too large for a float
        got = f"{min(max(period, -1e300), 1e300):g}" if number else f"something of {type(period).__name__}"
        raise UsageError(
            f"controller {name}: control_period must be a number from {least:g} to {most:g} (s), got {got}"
        )
    return float(period)


def steers_by_curvature(controller: object, name: str) -> bool:
    """Tell whether the second number of a controller, called `name`, is a curvature and not a steering angle.

    Raises:
        UsageError: it declares something else.
    """
    said = getattr(controller, "steers_by", "angle")
    if said not in ("angle", "curvature"):
        raise UsageError(f"controller {name}: steers_by must be angle or curvature, got {said!r:.60}")
    return bool(said == "curvature")


def with_control_period(scenario: Scenario, period: float | None, name: str) -> Scenario:
    """Return a scenario in which the car decides as often as a controller, called `name`, declares.

    Raises:
        UsageError: the period does not divide the scenario's time step.
    """
    if period is None or period == scenario.control_period:
        return scenario
    changed = replace(scenario, control_period=period)
    check_control_period(changed, f"controller {name} in scenario {scenario.name}")
    return changed


def require_control_period(controller: object, name: str, scenario: Scenario) -> None:
    """Refuse a scenario in which a controller, called `name`, would decide at other times than it declares.

    Raises:
        UsageError: it is so.
    """
    period = control_period_of(controller, name)
    if period is not None and abs(period - scenario.control_duration) > 1e-9:
        raise UsageError(
            f"controller {name} decides every {period:g} s, but in scenario {scenario.name} a car does so every "
            f"{scenario.control_duration:g} s: set control_period to {period:g}"
        )
