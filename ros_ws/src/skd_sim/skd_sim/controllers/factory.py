"""Controllers by name."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, cast

from skd_sim.controllers.basic import BasicController
from skd_sim.controllers.cal import CalController
from skd_sim.controllers.carla_agent import CarlaAgent
from skd_sim.controllers.protocol import Controller
from skd_sim.errors import UsageError
from skd_sim.interruption import Interrupted

BUILT_IN = ("basic", "cal", "carla")


def declared_control_period(name: str) -> float | None:
    """Return the control period (s) that a controller that comes with SKD declares; none of others and of a user's."""
    return CalController.control_period if name == "cal" else None


def make_controller(name: str, multiplier: float = 1.0) -> Controller:
    """Make a controller by name.

    Args:
        name: `basic`, `cal`, `carla`, or `package.module:Class` of a user's controller (made without arguments).
        multiplier: C of the basic controller; the others have none.

    Raises:
        UsageError: unknown name, a module or class that cannot be loaded, or a class that is no `Controller`.
    """
    if name == "basic":
        return BasicController(multiplier)
    if name == "cal":
        return CalController()
    if name == "carla":
        return CarlaAgent()
    module_name, separator, class_name = name.partition(":")
    if not (separator and module_name and class_name):
        raise UsageError(f"unknown controller {name!r}; give basic, cal, carla, or package.module:Class for your own")
    try:
        factory: Callable[[], object] = getattr(importlib.import_module(module_name), class_name)
        controller: Any = factory()
        fits = isinstance(controller, Controller)
    except Interrupted:  # this process is to end
        raise
    except BaseException as error:  # a user's module may raise anything, and end the program with a clean exit code
        try:
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        except BaseException:
            reason = type(error).__name__
        hint = "; is it on PYTHONPATH?" if isinstance(error, ModuleNotFoundError) else ""
        raise UsageError(f"controller {name!r} cannot be loaded: {reason}{hint}") from None
    if not fits:
        raise UsageError(f"controller {name!r} needs the methods reset(scenario, rng) and command(car, pedestrian)")
    return cast(Controller, controller)
