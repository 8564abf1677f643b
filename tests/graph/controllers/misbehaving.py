"""Controllers under test that do, once per campaign, what a controller should not."""

import math
import os
import signal
import time
from pathlib import Path

import numpy as np
from skd_sim import AdversaryState, CarState, Scenario
from skd_sim.controllers.basic import BasicController

TICK = 3
"""At which it happens."""


class _Once(BasicController):
    """The basic controller, until a certain tick of the first episode."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        super().reset(scenario, rng)
        self._tick = 0

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        self._tick += 1
        marker = Path(os.environ["SKD_TEST_MARKER"])
        if self._tick == TICK + 1 and not marker.exists():
            marker.write_text(str(os.getpid()))
            return self.misbehave()
        return super().command(car, adversary)

    def misbehave(self) -> float:
        raise NotImplementedError


class Killed(_Once):
    def misbehave(self) -> float:
        os.kill(os.getpid(), signal.SIGKILL)
        return 0.0


class Raises(_Once):
    def misbehave(self) -> float:
        raise RuntimeError("sensor fusion has diverged")


class Silent(_Once):
    """Takes its time."""

    def misbehave(self) -> float:
        time.sleep(4.0)
        return 0.0


class Slow(BasicController):
    """Slow enough for things to happen in the middle of an episode."""

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        time.sleep(0.1)
        return super().command(car, adversary)


class NeverWell(BasicController):
    """Divides zero by zero in every episode."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        super().reset(scenario, rng)
        self._tick = 0

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        self._tick += 1
        return math.nan if self._tick == TICK + 1 else super().command(car, adversary)


class Counting(BasicController):
    """Brakes in every other episode, whichever that is: it keeps something from one to the next."""

    episodes = 0

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        super().reset(scenario, rng)
        Counting.episodes += 1

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        return super().command(car, adversary) if Counting.episodes % 2 else 0.0
