"""Controllers by name."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from skd_sim.controllers.basic import BasicController
from skd_sim.controllers.cal import CalController
from skd_sim.controllers.carla_agent import CarlaAgent
from skd_sim.controllers.protocol import Controller
from skd_sim.errors import UsageError

BUILT_IN = ("basic", "cal", "carla")


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
        controller = factory()
    except Exception as error:  # a user's module may raise anything
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        hint = "; is it on PYTHONPATH?" if isinstance(error, ModuleNotFoundError) else ""
        raise UsageError(f"controller {name!r} cannot be loaded: {reason}{hint}") from error
    if not isinstance(controller, Controller):
        raise UsageError(f"controller {name!r} needs the methods reset(scenario, rng) and command(car, pedestrian)")
    return controller
