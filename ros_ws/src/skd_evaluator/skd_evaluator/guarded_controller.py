"""A guard around a user's controller, which may raise anything or answer anything."""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from skd_sim.controllers import Controller, SensingController
from skd_sim.scenario import Scenario
from skd_sim.sensors import Scan
from skd_sim.state import CarState, PedestrianState

from skd_evaluator.errors import AssessmentError

_Result = TypeVar("_Result")


class GuardedController:
    """A user's controller, whose failures name it instead of ending in a traceback of ours."""

    def __init__(self, controller: Controller, name: str) -> None:
        """Guard `controller`, called `name` in messages."""
        self._controller = controller
        self._name = name

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Pass the call on; see `Controller.reset`."""
        self._call("reset", lambda: self._controller.reset(scenario, rng))

    def command(self, car: CarState, pedestrian: PedestrianState) -> float:
        """Pass the call on and check the answer; see `Controller.command`."""
        answer = self._call("command", lambda: self._controller.command(car, pedestrian))
        try:
            acceleration = float(answer)
        except (TypeError, ValueError):
            acceleration = math.nan
        if not math.isfinite(acceleration):
            got = " ".join(repr(answer).split())[:80]
            raise AssessmentError(f"controller {self._name}: command must return a finite number (m/s²), got {got}")
        return acceleration

    def _call(self, method: str, call: Callable[[], _Result]) -> _Result:
        try:
            return call()
        except (Exception, SystemExit) as error:
            frame = traceback.extract_tb(error.__traceback__)[-1]
            said = " ".join(f"{type(error).__name__}: {error}".split())[:200]
            where = f"{Path(frame.filename).name}, line {frame.lineno}"
            raise AssessmentError(f"controller {self._name}: {method} failed with {said} ({where})") from error


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
