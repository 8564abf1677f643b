"""Whether copies of a controller do what the controller itself would do: otherwise a plan is worth nothing.

Two things are looked at. Before anything is planned, a copy is led through an encounter, another one through another
encounter, and a third through the first again: if they answer differently, copies share something that one of them
changed, as an attribute of their class. And beside the car itself one copy goes through all that the car goes through:
if it ever answers otherwise, it is no copy.
"""

from __future__ import annotations

import random
from typing import Any, Final, cast

import numpy as np
from skd_sim.choices.registry import reason_of
from skd_sim.controllers import Controller, SensingController, takes_scene
from skd_sim.controllers.copying import Copier
from skd_sim.controllers.wrapped import WrappedController
from skd_sim.encounter.scenario import Scenario
from skd_sim.errors import UsageError
from skd_sim.program.interruption import Interrupted
from skd_sim.sensors.scan import Scan
from skd_sim.state import AdversaryState, CarState

from skd_adversary.itself.future import Course, Draws, Node

TICKS: Final = 12
"""Of the encounters that copies are led through."""
_ADVICE: Final = "knowledge itself plans with copies; use knowledge learned, or keep all state in the object itself"


class Watched(WrappedController):
    """The car under test with, beside it, a copy that does all that it does."""

    def __init__(self, controller: Controller, name: str) -> None:
        """Watch `controller`, called `name` in messages."""
        super().__init__(controller, name)
        self.controller = controller
        self.name = name
        self._shadow: Controller | None = None

    def follow(self, copier: Copier) -> None:
        """Make a copy of the controller as it is now, which then goes on beside it."""
        self._shadow = copied(self.controller, self.name, copier)

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        """Pass the call on; see `Controller.reset`."""
        self._shadow = None
        self.controller.reset(scenario, rng)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        """Pass the call on, and ask the copy, too.

        Raises:
            UsageError: the copy answers otherwise.
        """
        answer = self.controller.command(car, adversary)
        if self._shadow is not None and float(self._shadow.command(car, adversary)) != float(answer):
            raise UsageError(f"controller {self.name}: a copy answers otherwise than the original: {_ADVICE}")
        return answer


class WatchedSensing(Watched):
    """The same for a controller that takes scans."""

    def sense(self, scan: Scan) -> None:
        """Pass the call on, to the copy, too."""
        cast(SensingController, self.controller).sense(scan)
        if self._shadow is not None:
            cast(SensingController, self._shadow).sense(scan)


def watch(controller: Controller, name: str) -> Watched:
    """Return a controller, called `name` in messages, with a copy beside it; it senses where the controller does."""
    return (WatchedSensing if isinstance(controller, SensingController) else Watched)(controller, name)


def copied(controller: Controller, name: str, copier: Copier) -> Controller:
    """Return a copy of a controller, called `name` in messages.

    Raises:
        UsageError: it cannot be copied.
    """
    try:
        return cast(Controller, copier.copy(controller))
    except (Interrupted, UsageError):
        raise
    except BaseException as error:  # a user's class may raise anything
        raise UsageError(f"controller {name} cannot be copied: {reason_of(error)}; {_ADVICE}") from None


class _Recorder:
    """A controller whose commands are kept."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.takes_scene = takes_scene(controller)
        self.commands: list[float] = []

    def sense(self, scan: Scan) -> None:
        cast(SensingController, self._controller).sense(scan)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        command = float(self._controller.command(car, adversary))
        self.commands.append(command)
        return command


def check_copies(root: Node, course: Course, copier: Copier, name: str, draws: Draws) -> None:
    """Refuse a controller whose copies have something in common that they change.

    Args:
        root: the present; its controller is copied.
        course: leads nodes of the episode on.
        copier: copies controllers.
        name: name of the controller, for the error line.
        draws: random draws of one future.

    Raises:
        UsageError: it is so, or it cannot be copied, or draws from a generator that everybody has.
    """
    copies = [copied(root.controller, name, copier) for _ in range(3)]
    before = _global_draws(root.controller)
    along, _, again = (
        _answers(root, course, draws, one, away=away) for one, away in zip(copies, (False, True, False), strict=True)
    )
    if _global_draws(root.controller) != before:
        raise UsageError(
            f"controller {name} draws from a global random generator: draw from the one that reset is given, or use "
            "knowledge learned"
        )
    if along != again:
        raise UsageError(f"controller {name}: what one copy does changes what another does: {_ADVICE}")


def _answers(root: Node, course: Course, draws: Draws, controller: Controller, *, away: bool) -> list[float]:
    """Return the commands in an encounter: towards the car, or as φ."""
    recorder: Any = _Recorder(controller)
    node = root
    for ahead in range(TICKS):
        if not node.velocities or node.contact is not None:
            break
        action = course.towards(node) if away else len(node.velocities) - 1
        node = course.tick(node, node.velocities[action], draws.noise(ahead), recorder, draws.laser)
    return recorder.commands if not away else []


def _global_draws(controller: Controller) -> object:
    """Return the state of the generators that everybody has, in the process in which a controller runs."""
    state = np.random.get_state(legacy=False)  # noqa: NPY002 - a user's controller may use it, we look whether it does
    return random.getstate(), str(state)
