"""An episode in process at the pace of the wall clock, seen while it runs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from skd_adversary.adversary import Adversary
from skd_sim.controllers import make_controller
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.simulators.named_simulator import NamedSimulator
from skd_sim.world.episode import Episode, EpisodeLog
from skd_sim.world.simulator import Frame

from skd_evaluator.assessment.run.runner import run_episode
from skd_evaluator.driving.hand import Wish
from skd_evaluator.driving.situation import Onlooker, Situation

_NAP = 0.05  # s between two looks at what is wanted

Drive = Callable[[Episode], EpisodeLog]
"""Runs an episode to its end, or raises a `LeftError`."""
Show = Callable[[Situation], None]
HandFor = Callable[[Episode], Adversary | None]
"""Gives who moves the adversary of an episode that begins; None: what the episode says."""


class LeftError(Exception):
    """Somebody at the keys does not want to see the end of the episode."""


class PacedSimulator(NamedSimulator):
    """The simulator of an episode, which comes to the end of a control period when the wall clock does."""

    def __init__(self, rate: float, show: Show, look: Callable[[], Wish]) -> None:
        """Wait for an episode.

        Args:
            rate: simulated seconds in a second of the wall clock.
            show: called with each situation.
            look: says what is wanted.
        """
        super().__init__()
        self._rate, self._show, self._look = rate, show, look

    def reset(self, episode: Episode) -> Frame:
        """Begin an episode; see `Simulator`."""
        self._onlooker = Onlooker(episode)
        frame = super().reset(episode)
        self._period = episode.scenario.control_duration / self._rate
        self._see(frame, math.nan, math.nan)
        self._due = self._shown + self._period
        return frame

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        """Wait for the end of the control period, and advance by it; see `Simulator`.

        Raises:
            LeftError: nobody wants to see more of it.
        """
        age = time.monotonic() - self._shown
        while (left := self._due - time.monotonic()) > 0.0 and self._look() is Wish.NONE:
            time.sleep(min(left, _NAP))
        if self._look() is not Wish.NONE:
            raise LeftError
        self._due = max(self._due + self._period, time.monotonic())  # what was missed is not made up for
        frame = super().step(acceleration, velocity)
        self._see(frame, acceleration, age)
        return frame

    def _see(self, frame: Frame, command: float, age: float) -> None:
        self._show(self._onlooker.see(frame.tick, frame.period, frame.car, frame.adversary, command, age))
        self._shown = time.monotonic()


@contextmanager
def driving_in_process(
    car: CarUnderTest, rate: float, hand_for: HandFor, show: Show, look: Callable[[], Wish]
) -> Iterator[Drive]:
    """Yield what runs an episode at the pace of the wall clock.

    Args:
        car: the car under test.
        rate: simulated seconds in a second of the wall clock.
        hand_for: gives who moves the adversary.
        show: called with each situation.
        look: says what is wanted.
    """
    controller = make_controller(car.controller, car.multiplier)

    def drive(episode: Episode) -> EpisodeLog:
        return run_episode(episode, controller, hand_for(episode), PacedSimulator(rate, show, look))

    yield drive
