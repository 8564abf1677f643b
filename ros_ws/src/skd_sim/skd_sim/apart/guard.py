"""A guard around a user's controller, which may raise anything or answer anything."""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.controllers import Controller, SensingController
from skd_sim.controllers.wrapped import WrappedController
from skd_sim.encounter.scenario import Scenario
from skd_sim.errors import AssessmentError, NoNumberError
from skd_sim.program.interruption import Interrupted
from skd_sim.sensors import Scan
from skd_sim.state import AdversaryState, CarState, Scene

_Result = TypeVar("_Result")


def shown(value: object, as_text: Callable[[object], str], length: int) -> str:
    """Return how a user's object shows itself, in one line of at most `length` characters; it may fail at that, too."""
    try:
        return " ".join(as_text(value).split())[:length]
    except BaseException as error:
        return f"something of {type(value).__name__} that cannot be shown ({type(error).__name__})"


def failed(whose: str, method: str, error: BaseException) -> AssessmentError:
    """Return in one line what a user's code raised, and where; called while it is handled."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    said = f"{type(error).__name__}: {shown(error, str, 200)}"
    where = f"{Path(frame.filename).name}, line {frame.lineno}"
    return AssessmentError(f"{whose}: {method} failed with {said} ({where})")


def _is_number(answer: Any) -> bool:
    """Return whether an answer may be taken for a number: `float` takes texts, too, and drops what is imaginary.

    A yes or no is no acceleration, though Python counts it as one; nor is an array of one.
    """
    if isinstance(answer, (np.ndarray, np.generic)):
        return answer.dtype.kind in "fiu" and not np.ma.is_masked(answer)
    no_number = isinstance(answer, (str, bytes, bytearray, bool))
    return not no_number and not str(getattr(answer, "dtype", "")).endswith("bool")  # as of PyTorch


class GuardedController(WrappedController):
    """A user's controller, whose failures name it instead of ending in a traceback of ours."""

    def __init__(self, controller: Controller, name: str) -> None:
        """Guard `controller`, called `name` in messages."""
        super().__init__(controller, name)
        self._controller = controller

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Pass the call on; see `Controller.reset`."""
        self._call("reset", lambda: self._controller.reset(scenario, rng))

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Pass the call on and check the answer; see `Controller.command`."""
        answer = self._call("command", lambda: self._controller.command(car, adversary))
        try:
            acceleration = float(answer) if isinstance(answer, float) or _is_number(answer) else math.nan
        except BaseException:  # a number of a user's own kind, too
            acceleration = math.nan
        if not math.isfinite(acceleration):
            got = shown(answer, repr, 80)
            raise NoNumberError(f"controller {self._name}: command must return a finite number (m/s²), got {got}")
        return acceleration

    def commands(self, cars: CarState, adversaries: AdversaryState) -> FloatArray:
        """Pass the call on and check the answer; see `BatchController.commands`."""
        inner: Any = self._controller
        scenes = Scene(cars, adversaries) if self.takes_scene else adversaries
        answer = self._call("commands", lambda: inner.commands(cars, scenes))
        count = np.size(cars.x)
        try:
            found = np.asarray(answer)
            numbers = found.dtype.kind in "fiu" and found.shape == (count,)  # a yes or no is no acceleration
            numbers = numbers and not np.ma.is_masked(answer)
            accelerations = found.astype(np.float64)
        except BaseException:  # an array of a user's own kind, too
            numbers = False
        if not numbers or not np.isfinite(accelerations).all():
            got = shown(answer, repr, 80)
            raise NoNumberError(
                f"controller {self._name}: commands must return an array of {count} finite numbers (m/s²), got {got}"
            )
        return accelerations

    def own_copy(self) -> GuardedController | None:
        """Return a guard around a copy that the controller's own method `copy` makes; None if it has none.

        Raises:
            AssessmentError: it fails, or gives no controller of the same class, or itself.
        """
        inner: Any = self._controller
        if not callable(getattr(inner, "copy", None)):
            return None
        made = self._call("copy", lambda: inner.copy())
        if made is inner or type(made) is not type(inner):
            raise AssessmentError(
                f"controller {self._name}: copy must return another {type(inner).__name__}, got "
                f"{'itself' if made is inner else shown(made, repr, 80)}"
            )
        return guard(made, self._name)

    def _call(self, method: str, call: Callable[[], _Result]) -> _Result:
        try:
            return call()
        except Interrupted:  # this process is to end
            raise
        except BaseException as error:  # a user's code may raise anything
            raise failed(f"controller {self._name}", method, error) from None


class GuardedSensingController(GuardedController):
    """The same for a controller that takes scans."""

    def __init__(self, controller: SensingController, name: str) -> None:
        """Guard `controller`, called `name` in messages."""
        super().__init__(controller, name)
        self._sensing = controller

    def sense(self, scan: Scan) -> None:
        """Pass the call on; see `SensingController.sense`."""
        self._call("sense", lambda: self._sensing.sense(scan))


def guard(controller: Controller, name: str) -> GuardedController:
    """Return a guard around `controller`, called `name` in messages; it senses where the controller does."""
    if isinstance(controller, SensingController):
        return GuardedSensingController(controller, name)
    return GuardedController(controller, name)
