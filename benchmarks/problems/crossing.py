"""The crossing: the kamikaze POMDP of this project, for a straight φ and the basic car with C = 1 (`skd_adversary`)."""

from __future__ import annotations

import numpy as np
from skd_adversary.model.car.basic import known_basic_car
from skd_adversary.model.composer import compose
from skd_adversary.model.objective.paper import OBJECTIVE
from skd_adversary.planning.pomdp import Pomdp
from skd_sim.encounter.scenario import load_scenario


def crossing() -> Pomdp:
    """Return the kamikaze POMDP: φ goes straight from x = −3.5 m to the destination, the car is 13 m away."""
    scenario = load_scenario("crossing")
    x = np.arange(-3.5, scenario.adversary.destination_x, scenario.adversary.speed * scenario.time_step)
    path = np.column_stack([x, np.zeros_like(x)])
    return compose(scenario, OBJECTIVE, known_basic_car(1.0), start=(-3.5, 0.0), gap=13.0, path=path)
