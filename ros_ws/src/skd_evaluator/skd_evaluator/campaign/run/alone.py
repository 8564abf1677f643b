"""A controller asked again what it was asked in an episode, alone: in a process that knows nothing of the test.

A controller that is honest answers what it is given: what `reset` gave it, and what it saw since. One that looks for
more in the process that it runs in (the stack, the command line, its generator's seed, what it kept of episodes before)
can tell a kamikaze from a run along φ, and be another car for it. Here it finds nothing of that: a new process gets its
name, the scenario, a generator in the same state, and the states that it saw. Whoever answers otherwise then did not
answer by what a car sees.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.controllers import Controller, SensingController, make_controller, takes_scene
from skd_sim.encounter.scenario import Scenario
from skd_sim.sensors import Scan
from skd_sim.state import AdversaryState, CarState

from skd_evaluator.campaign.run.guarded_controller import GuardedController, guard
from skd_evaluator.keeper import end_now, keep

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
        scenario: given to `reset`.
        generator: state of the bit generator given to `reset`, as numpy has it.
        asked: in the order of the control periods.
    """

    scenario: Scenario | None = None
    generator: dict[str, Any] = field(default_factory=dict)
    asked: list[Question] = field(default_factory=list)


class OverheardController:
    """A controller that is guarded, and all that it is asked and answers."""

    def __init__(self, controller: GuardedController) -> None:
        """Listen to a controller."""
        self._controller = controller
        self.questions, self.answers = Questions(), list[float]()
        self._scan: Scan | None = None

    @property
    def control_period(self) -> float | None:
        """The one that the controller declares, s; none by default."""
        return self._controller.control_period

    @property
    def takes_scene(self) -> bool:
        """Whether the controller wants to see everybody."""
        return takes_scene(self._controller)

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Pass the call on; see `Controller.reset`."""
        self.questions = Questions(scenario, dict(rng.bit_generator.state))
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
    """Return a guarded controller, called `name` in messages, to which one can listen."""
    guarded = guard(controller, name)
    listening = OverheardSensingController if isinstance(guarded, SensingController) else OverheardController
    return listening(guarded)


def answered_alone(car: CarUnderTest, conversations: Sequence[Questions], limit: float) -> list[list[float]] | str:
    """Ask a controller anew, in a process of its own, and return its answers to each conversation.

    Args:
        car: whose controller is asked.
        conversations: what it was asked, in the order in which it is to be asked now.
        limit: s that its answers may take.

    Returns:
        Answers, m/s²; or why there are none, in a few words.
    """
    told = pickle.dumps((sys.path, car.controller, car.multiplier, list(conversations)))
    process = subprocess.Popen(
        [sys.executable, "-m", "skd_evaluator.campaign.run.alone"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        said, _ = process.communicate(told, timeout=_ENOUGH + limit)
    except subprocess.TimeoutExpired:
        return f"it did not answer within {_ENOUGH + limit:.0f} s"
    finally:
        if process.poll() is None:
            end_now(process.pid)  # a keeper, which ends whatever the controller has started
        process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                pipe.close()
    try:
        found = json.loads(said)
        if isinstance(found, str):
            return found[:300]
        answers = [[float(one) for one in answers] for answers in found]
    except (ValueError, TypeError):
        return f"its process ended with code {process.returncode}"
    if [len(one) for one in answers] != [len(one.asked) for one in conversations]:
        return "its process did not answer all questions"
    return answers


def _generator(state: dict[str, Any]) -> np.random.Generator:
    """Return a generator in a state, of whose seed nothing is known."""
    kinds = {kind.__name__: kind for kind in (np.random.PCG64, np.random.PCG64DXSM, np.random.MT19937)}
    bits: Any = kinds[state["bit_generator"]]()
    bits.state = state
    return np.random.Generator(bits)


def _answers(controller: GuardedController, questions: Questions) -> list[float]:
    assert questions.scenario is not None
    controller.reset(questions.scenario, _generator(questions.generator))
    found = []
    for scan, car, adversary in questions.asked:
        if scan is not None and isinstance(controller, SensingController):
            controller.sense(scan)
        found.append(controller.command(car, adversary))
    return found


def main() -> None:
    """Answer what stands on standard input."""
    keep()
    out = os.dup(1)
    os.dup2(2, 1)  # what a controller prints is no answer
    path, name, multiplier, conversations = pickle.load(sys.stdin.buffer)
    sys.path[:] = path
    found: Any
    try:
        controller = guard(make_controller(name, multiplier), name)
        found = [_answers(controller, one) for one in conversations]
    except Exception as error:
        found = str(error)
    with os.fdopen(out, "w", encoding="utf-8") as file:
        json.dump(found, file)


if __name__ == "__main__":
    main()
