"""Controllers by name, and a guard around a user's, which may raise anything or answer anything.

Whatever goes wrong in one is an AssessmentError whose one line names the controller and the line of its code.
"""

from __future__ import annotations

import inspect
import math
import os
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from skd_sim.controllers import protocol
from skd_sim.controllers.isolated import LOADING, begin_call, end_call
from skd_sim.errors import AssessmentError, NoNumberError, UsageError
from skd_sim.inputs.files import near_or_all
from skd_sim.inputs.yaml_file import short
from skd_sim.interruption import Interrupted
from skd_sim.options.car_under_test import CONTROLLERS, EXTERNAL, CarUnderTest
from skd_sim.options.registry import load, place_of, reason_of
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.dynamics.basic import Command, steering_angle, wheels
from skd_sim.world.sensors import Scan
from skd_sim.world.state import AdversaryState, CarState, FloatArray, Scene

_Result = TypeVar("_Result")


def failed(whose: str, method: str, error: BaseException, code: object = None) -> AssessmentError:
    """Return in one line what a user's code raised, and where in it.

    Args:
        whose: the user's code, as messages name it.
        method: which method of it was called.
        error: what it raised.
        code: the object whose method it is, if there is one.
    """
    folder = "" if code is None else str(Path(_file_of(type(code))).parent)
    has = ""
    if isinstance(error, AttributeError) and type(error.obj).__module__.startswith("skd_sim."):
        names = getattr(error.obj, "_fields", [one for one in dir(error.obj) if not one.startswith("_")])
        has = near_or_all(str(error.name), names, "it has")
    return AssessmentError(f"{whose}: {method} failed with {reason_of(error)}{has}{place_of(error, folder)}")


def _file_of(code: Any) -> str:
    try:
        return inspect.getfile(code)
    except (OSError, TypeError):
        return ""


def _check_methods(made: object, what: str) -> None:
    """Refuse an object that has not the methods of a controller, or whose methods take something else.

    Raises:
        UsageError: it is so; says where the method is.
    """
    needed = {"reset": ("scenario", "rng"), "command": ("car", "adversary")}
    missing = [
        f"{name}({', '.join(takes)})" for name, takes in needed.items() if not callable(getattr(made, name, None))
    ]
    if missing:
        raise UsageError(f"{what} needs the method{'s' * (len(missing) > 1)} {' and '.join(missing)}")
    for name, takes in needed.items():
        method = getattr(made, name)
        try:
            signature = inspect.signature(method)
        except (TypeError, ValueError):  # of what is written in C
            continue
        try:
            signature.bind(*takes)
        except TypeError:
            takes_not = f"{name} must take ({', '.join(takes)}), and takes {signature}{_place_of_method(method)}"
            raise UsageError(f"{what}: {takes_not}") from None


def _place_of_method(method: Callable[..., Any]) -> str:
    """Return where a method begins, in brackets; empty where that is not known."""
    code = getattr(inspect.unwrap(method), "__code__", None)
    return f" ({os.path.relpath(code.co_filename)}, line {code.co_firstlineno})" if code else ""


def _number(answer: Any) -> float:
    """Return an answer as a number; nan where it is none: a text, a yes or no, or an array is no acceleration."""
    if isinstance(answer, float):
        return float(answer)
    if isinstance(answer, (str, bytes, bool, np.bool_)) or np.ndim(answer):
        return math.nan
    try:
        return float(answer)
    except (TypeError, ValueError, OverflowError):
        return math.nan


_SCENARIOS = 64  # copies of scenarios that a controller keeps


def _pair(answer: Any) -> tuple[float, float] | None:
    """Return the two numbers of an answer; None where it is no pair."""
    if isinstance(answer, (tuple, list, np.ndarray)) and np.shape(answer) == (2,):
        return _number(answer[0]), _number(answer[1])
    return None


class UserController:
    """A user's controller, whose failures name it instead of ending in a traceback of ours.

    Attributes:
        control_period: that it declares, s; none by default.
        takes_scene: whether it wants to see everybody.
        takes_batches: whether it answers many episodes at once.
    """

    def __init__(self, controller: protocol.Controller, name: str) -> None:
        """Stand around `controller`, called `name` in messages."""
        self._controller, self._name = controller, name
        self._scenarios: dict[int, tuple[Scenario, Scenario]] = {}  # by id: each, and the controller's own copy
        self.control_period = protocol.control_period_of(controller, name)
        self.takes_scene, self.takes_batches = protocol.takes_scene(controller), protocol.takes_batches(controller)
        self._by_curvature, self._wheelbase = protocol.steers_by_curvature(controller, name), 0.0

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Pass the call on, with a scenario of the controller's own, so that it cannot change the world's."""
        if id(scenario) not in self._scenarios:
            if len(self._scenarios) == _SCENARIOS:
                self._scenarios.clear()
            own: Scenario = pickle.loads(pickle.dumps(scenario))
            own.road.line.setflags(write=False)
            self._scenarios[id(scenario)] = scenario, own
        self._wheelbase = wheels(scenario.car)[0]
        self._call("reset", self._controller.reset, self._scenarios[id(scenario)][1], rng)

    def command(self, car: CarState, adversary: AdversaryState) -> Command:
        """Pass the call on and check the answer; see `Controller.command`."""
        answer = self._call("command", self._controller.command, car, adversary)
        if type(answer) is float and math.isfinite(answer):
            return answer
        pair = _pair(answer)
        acceleration, steering = pair or (_number(answer), 0.0)
        if not (math.isfinite(acceleration) and math.isfinite(steering)):
            raise NoNumberError(
                f"controller {self._name}: command must return a finite number (m/s²), got {short(answer)}; or two, "
                "with a steering angle (rad)"
                f"{_place_of_method(self._controller.command)}"
            )
        if pair is None:
            return acceleration
        return acceleration, steering_angle(steering, self._wheelbase) if self._by_curvature else steering

    def commands(self, states: FloatArray) -> FloatArray:
        """Return the commands in many episodes at once; see `BatchController.commands`.

        Args:
            states: 9 × n: x, y, heading and speed of each car, x, y, vx, vy and heading of each adversary.

        Returns:
            n × 2: accelerations (m/s²) and steering angles (rad).

        Raises:
            AssessmentError: the controller fails, or answers anything but n finite numbers or pairs.
        """
        inner: Any = self._controller
        copied = states.copy()
        cars, adversaries = CarState(*copied[:4]), AdversaryState(*copied[4:])
        scenes = Scene(cars, adversaries) if self.takes_scene else adversaries
        answer = self._call("commands", inner.commands, cars, scenes)
        count = states.shape[1]
        found = np.asarray(answer)
        is_array = found.dtype.kind in "fiu" and found.shape in ((count,), (count, 2)) and not np.ma.is_masked(answer)
        if not is_array or not np.isfinite(found).all():
            raise NoNumberError(
                f"controller {self._name}: commands must return an array of {count} finite numbers (m/s²), got "
                f"{short(answer)}; or {count} × 2, with steering angles (rad)"
            )
        pairs = np.zeros((count, 2))
        pairs.T[: found.ndim] = found.T
        if self._by_curvature:
            pairs[:, 1] = np.arctan(self._wheelbase * pairs[:, 1])
        return pairs

    def _call(self, method: str, call: Callable[..., _Result], *arguments: Any) -> _Result:
        begin_call()
        try:
            return call(*arguments)
        except Interrupted:  # this process is to end
            raise
        except BaseException as error:  # a user's code may raise anything
            raise failed(f"controller {self._name}", method, error, self._controller) from None
        finally:
            end_call()


class UserSensingController(UserController):
    """The same for a controller that takes scans."""

    def sense(self, scan: Scan) -> None:
        """Pass the call on; see `SensingController.sense`."""
        inner: Any = self._controller
        self._call("sense", inner.sense, scan)


def user_controller(controller: protocol.Controller, name: str) -> UserController:
    """Return what stands around `controller`, called `name` in messages; it senses where the controller does."""
    if isinstance(controller, protocol.SensingController):
        return UserSensingController(controller, name)
    return UserController(controller, name)


def _class_named(name: str) -> str:
    """Return `; did you mean …?` for a class whose module is missing or stands before a dot; empty for other names."""
    module, dot, class_ = name.rpartition(".")
    if dot and re.fullmatch(r"[\w.]+", name):
        return f"; did you mean {module}:{class_}?"
    defined = re.compile(rf"^class {re.escape(name)}\b", re.MULTILINE)
    files = (one for one in sorted(Path().glob("*.py")) if defined.search(one.read_text(errors="replace")))
    return next((f"; did you mean {file}:{name}?" for file in files), "")


def make_controller(name: str, multiplier: float = 1.0) -> protocol.Controller:
    """Make a controller by name.

    Args:
        name: name of a controller, one of `CONTROLLERS`, or `package.module:Class` or `file.py:Class` of a user's
            controller, which is made without arguments.
        multiplier: C of a controller that has one; the others have none.

    Raises:
        UsageError: unknown name, a module or class that cannot be loaded, or a class that is no `Controller`.
    """
    car = CarUnderTest(name, multiplier)
    if car.is_external or not car.exists:
        file = Path(name.rstrip(":"))
        if file.suffix == ".py" and not file.is_file():
            raise UsageError(f"{file}: there is no such file")
        if file.suffix == ".py":
            classes = re.findall(r"^class (\w+)", file.read_text(encoding="utf-8", errors="replace"), re.MULTILINE)
            has = ", ".join(classes) or "none"
            raise UsageError(f"controller {file.name}: name a class, as {file.name}:Class; it has {has}")
        words = "yours is file.py:Class or package.module:Class; known are"
        near = _class_named(name) or near_or_all(name, (*CONTROLLERS, EXTERNAL), words)
        raise UsageError(f"unknown controller {name!r}{near}")
    what = f"controller {car.short_controller}"
    target = CONTROLLERS.target(name) if name in CONTROLLERS else car.controller
    if car.is_own:
        factory: Callable[..., object] = load(target, what)
        return cast(protocol.Controller, factory(multiplier) if car.has_multiplier else factory())
    begin_call(LOADING)
    try:
        found = load(target, what)
        if inspect.isfunction(found) and inspect.signature(found).parameters:
            raise UsageError(f"{what} is a function; give a class with the methods reset and command")
        made: Any = found()
        _check_methods(made, what)
        return user_controller(made, car.short_controller)
    except (Interrupted, UsageError):  # this process is to end, or what is wrong is said already
        raise
    except BaseException as error:  # a user's class may raise anything, and end the program with a clean exit code
        where = place_of(error) or f"; it is made without arguments{_place_of_method(found.__init__)}"
        raise UsageError(f"{what} cannot be loaded: {reason_of(error)}{where}") from None
    finally:
        end_call()
