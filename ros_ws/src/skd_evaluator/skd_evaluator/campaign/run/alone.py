"""A controller asked again what it was asked before, alone: in a new process, and nothing between two questions.

A controller that is honest answers what it is given: what `reset` gave it, and what it saw since. One that goes by more
(what it kept of episodes before, how long an adversary takes to decide, whether it is a copy that a search has made)
can be another car for some episodes, or for the search. Here it finds nothing of that: a new process gets its name, the
scenario, the same generator, and the states that it saw. Whoever answers otherwise then did not answer by what a car
sees.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Sequence
from concurrent.futures import TimeoutError as TooLongError
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.controllers import Controller, SensingController, make_controller
from skd_sim.controllers.wrapped import WrappedController
from skd_sim.encounter.scenario import Scenario
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.sensors import Scan
from skd_sim.state import AdversaryState, CarState

from skd_evaluator.campaign.run.worker_pool import LostWorkerError, WorkerPool

_ENOUGH = 60.0  # s for all answers beside those of the controller's own time


class Question(NamedTuple):
    """What a controller was asked: the scan that it was given first, if any, and both states."""

    scan: Scan | None
    car: CarState
    adversary: AdversaryState


@dataclass
class Questions:
    """All that a controller was given in an episode.

    Attributes:
        scenario: scenario that `reset` was given.
        rng: generator that `reset` was given.
        asked: questions in the order of the control periods.
    """

    scenario: Scenario | None = None
    rng: np.random.Generator | None = None
    asked: list[Question] = field(default_factory=list)


class OverheardController(WrappedController):
    """A controller of which all questions and answers are kept."""

    def __init__(self, controller: Controller, name: str) -> None:
        """Listen to a controller, called `name` in messages."""
        super().__init__(controller, name)
        self._controller = controller
        self.questions, self.answers = Questions(), list[float]()
        self._scan: Scan | None = None

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Pass the call on; see `Controller.reset`."""
        self.questions = Questions(scenario, copy.deepcopy(rng))
        self.answers = []
        self._controller.reset(scenario, rng)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Pass the call on; see `Controller.command`."""
        self.questions.asked.append(Question(self._scan, car, adversary))
        self.answers.append(self._controller.command(car, adversary))
        return self.answers[-1]


class OverheardSensingController(OverheardController):
    """The same of a controller that takes scans."""

    def sense(self, scan: Scan) -> None:
        """Pass the call on; see `SensingController.sense`."""
        self._scan = scan
        assert isinstance(self._controller, SensingController)
        self._controller.sense(scan)


def overhear(controller: Controller, name: str) -> OverheardController:
    """Return a controller, called `name` in messages, to which one can listen."""
    listening = OverheardSensingController if isinstance(controller, SensingController) else OverheardController
    return listening(controller, name)


class Alone:
    """A new process for a car's controller, which begins to load it at once and is asked later; a context manager."""

    def __init__(self, car: CarUnderTest) -> None:
        """Begin; do it before this process has other threads, for it is forked."""
        self._car = car
        self._pool = WorkerPool(1, answer_limit=math.inf)  # how long it may take is known when it is asked
        self._begun = self._pool.submit(_begin, car)

    def __enter__(self) -> Alone:
        return self

    def __exit__(self, *_: object) -> None:
        """End it."""
        self._pool.shutdown(wait=False)

    def answers(self, conversations: Sequence[Questions], limit: float) -> list[list[float]] | str:
        """Ask the controller anew, and return its answers to each conversation.

        Args:
            conversations: what it was asked, in the order in which it is to be asked now.
            limit: time that its answers may take, s.

        Returns:
            Answers, m/s²; or why there are none, in a few words.
        """
        latest = time.monotonic() + _ENOUGH + limit
        try:
            self._begun.result(_ENOUGH + limit)
            return self._pool.submit(_answers, self._car, list(conversations)).result(
                max(0.0, latest - time.monotonic())
            )
        except TooLongError:
            return f"it did not answer within {_ENOUGH + limit:.0f} s"
        except (LostWorkerError, AssessmentError, UsageError) as error:
            return str(error.reason if isinstance(error, LostWorkerError) else error)[:300]


def _begin(car: CarUnderTest) -> None:
    """Load a controller: in a worker."""
    make_controller(car.controller, car.multiplier)


def _answers(car: CarUnderTest, conversations: Sequence[Questions]) -> list[list[float]]:
    """Return the answers of the controller: in a worker, which has loaded it, or took the place of one that had."""
    found = []
    for one in conversations:
        assert one.scenario is not None
        assert one.rng is not None
        controller = make_controller(
            car.controller, car.multiplier
        )  # anew, as for an episode: what one keeps of the last is no cheat
        controller.reset(one.scenario, one.rng)
        answers = []
        for scan, state, adversary in one.asked:
            if scan is not None and isinstance(controller, SensingController):
                controller.sense(scan)
            answers.append(controller.command(state, adversary))
        found.append(answers)
    return found
