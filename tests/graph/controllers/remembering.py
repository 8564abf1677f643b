"""A controller that keeps something from one episode to the next, and the same without."""

from __future__ import annotations

import numpy as np
from skd_sim.controllers.basic import BasicController
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, CarState


class Honest(BasicController):
    """The basic controller, under another name."""


class Counting(BasicController):
    """Brakes in every other episode, whichever that is."""

    episodes = 0

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        super().reset(scenario, rng)
        Counting.episodes += 1

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        return super().command(car, adversary) if Counting.episodes % 2 else 0.0
