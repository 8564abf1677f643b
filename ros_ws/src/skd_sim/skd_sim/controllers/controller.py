"""What SKD asks of a car under test; controllers by name, and a guard around a user's, which may do anything.

Whatever goes wrong in a user's is an AssessmentError whose one line names the controller and the line of its code.
"""

from __future__ import annotations

import functools
import inspect
import math
import pickle
import re
import types
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeGuard, TypeVar, cast, runtime_checkable

import numpy as np

from skd_sim.controllers.isolated import LOADING, begin_call, end_call
from skd_sim.errors import AssessmentError, NoNumberError, UsageError
from skd_sim.inputs.files import from_here, near_or_all
from skd_sim.inputs.yaml_file import short
from skd_sim.interruption import Interrupted
from skd_sim.options.car_and_adversary import CONTROLLERS, EXTERNAL, CarUnderTest
from skd_sim.options.registry import load, place_of, reason_of
from skd_sim.scenario.scenario import CONTROL_PERIODS, Scenario, check_control_period
from skd_sim.world.dynamics.basic import Command, steering_angle, wheels
from skd_sim.world.sensors import Scan
from skd_sim.world.state import AdversaryState, CarState, FloatArray, Pair, Scene

_Result = TypeVar("_Result")


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
        got = f"{min(max(period, -1e300), 1e300):g}" if number else f"{period!r:.60}"
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
        parts = [part for part in ("car", "adversary") if hasattr(getattr(error.obj, part, None), str(error.name))]
        names = [f"{part}.{error.name}" for part in parts] or names
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
    return f" ({from_here(code.co_filename)}, line {code.co_firstlineno})" if code else ""


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


def _pair(answer: Any) -> Pair | None:
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

    def __init__(self, controller: Controller, name: str) -> None:
        """Stand around `controller`, called `name` in messages."""
        self._controller, self._name = controller, name
        self._scenarios: dict[int, tuple[Scenario, Scenario]] = {}  # by id: each, and the controller's own copy
        self.control_period = control_period_of(controller, name)
        self.takes_scene, self.takes_batches = takes_scene(controller), takes_batches(controller)
        self._by_curvature, self._wheelbase = steers_by_curvature(controller, name), 0.0

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
                f"controller {self._name}: command must return a finite number (m/s²), or two with a steering angle "
                f"(rad); got {short(answer)}{_place_of_method(self._controller.command)}"
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
                f"controller {self._name}: commands must return an array of {count} finite numbers (m/s²), or "
                f"{count} × 2 with steering angles (rad); got {short(answer)}"
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


def user_controller(controller: Controller, name: str) -> UserController:
    """Return what stands around `controller`, called `name` in messages; it senses where the controller does."""
    if isinstance(controller, SensingController):
        return UserSensingController(controller, name)
    return UserController(controller, name)


def _class_named(name: str) -> str:
    """Return `; did you mean …?` for a class without its file, or written as `module.Class`; else an empty string."""
    file, colon, of_file = name.rpartition(":")
    if colon and Path(f"{file}.py").is_file():
        return f"; did you mean {file}.py:{of_file}?"
    module, dot, class_ = name.rpartition(".")
    if dot and re.fullmatch(r"[\w.]+", name):
        return f"; did you mean {module}:{class_}?"
    defined = re.compile(rf"^class {re.escape(name)}\b", re.MULTILINE)
    files = (one for one in sorted(Path().glob("*.py")) if defined.search(one.read_text(errors="replace")))
    return next((f"; did you mean {file}:{name}?" for file in files), "")


def make_controller(name: str, multiplier: float = 1.0) -> Controller:
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
        if name.strip(":") and file.is_dir():
            raise UsageError(f"{file}: is a folder; give a controller in it, as {file / 'FILE.py'}:CLASS")
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
        return cast(Controller, factory(multiplier) if car.has_multiplier else factory())
    begin_call(LOADING)
    try:
        found = load(target, what)
        is_law = inspect.isfunction(found) and inspect.signature(found).parameters
        if is_law or not callable(found):
            kind = "a function" if is_law else f"an object of {type(found).__name__}"
            raise UsageError(f"{what} is {kind}; give a class with the methods reset and command")
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
