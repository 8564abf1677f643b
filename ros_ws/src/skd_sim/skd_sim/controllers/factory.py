"""Controllers by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from skd_sim.controllers.isolated import LOADING, begin_call, end_call
from skd_sim.controllers.protocol import Controller
from skd_sim.controllers.user_controller import user_controller
from skd_sim.errors import UsageError
from skd_sim.inputs.suggestion import did_you_mean
from skd_sim.interruption import Interrupted
from skd_sim.options.car_under_test import CONTROLLERS, EXTERNAL, CarUnderTest
from skd_sim.options.registry import load, reason_of


def make_controller(name: str, multiplier: float = 1.0) -> Controller:
    """Make a controller by name.

    Args:
        name: name of a controller, one of `CONTROLLERS`, or `package.module:Class` of a user's controller, which is
            made without arguments.
        multiplier: C of a controller that has one; the others have none.

    Raises:
        UsageError: unknown name, a module or class that cannot be loaded, or a class that is no `Controller`.
    """
    car = CarUnderTest(name, multiplier)
    if car.is_external or not car.exists:
        known = CONTROLLERS.names()
        raise UsageError(
            f"unknown controller {name!r}; give {', '.join(known)}, or package.module:Class for your own"
            f"{did_you_mean(name, (*known, EXTERNAL))}"
        )
    what = f"controller {name!r}"
    target = CONTROLLERS.target(name) if name in CONTROLLERS else name
    if car.is_own:
        factory: Callable[..., object] = load(target, what)
        return cast(Controller, factory(multiplier) if car.has_multiplier else factory())
    begin_call(LOADING)
    try:
        made: Any = load(target, what)()
        if isinstance(made, Controller):
            return user_controller(made, name)
    except (Interrupted, UsageError):  # this process is to end, or what is wrong is said already
        raise
    except BaseException as error:  # a user's class may raise anything, and end the program with a clean exit code
        raise UsageError(f"{what} cannot be loaded: {reason_of(error)}") from None
    finally:
        end_call()
    raise UsageError(f"{what} needs the methods reset(scenario, rng) and command(car, adversary)")
