"""Short episodes that make every planner compile, or load from its cache, before it is timed or forked."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from skd_sim.options.adversary import Objective
from skd_sim.options.car_under_test import BASIC, DEFAULT, DYNAMICS
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import Trajectory

from skd_adversary.car_models.car_model_file import OPTIONAL, PARAMETERS, FittedCar, car_model_text
from skd_adversary.car_models.forest import TICK, gridded, pack
from skd_adversary.car_models.identifiability import Identification


def any_car_models() -> list[str]:
    """Return a model of each kind that a car can have, as an episode carries it, which says nothing of any car."""
    names = [name for name in PARAMETERS if name not in OPTIONAL]
    parameters = Identification(logs=0, start_speed=0.0).unknown("there are no logs", *names)
    step = load_scenario(DYNAMICS[BASIC].scenario).time_step
    law = FittedCar(measure="distance", gate="none", spread="sharp", lapse=0.0, parameters=parameters, time_step=step)
    one_leaf = pack(
        np.array([-1], dtype=np.int8),
        np.zeros(0, dtype=np.int16),
        np.ones(1, dtype=np.uint32),
        gridded(np.zeros((1, len(TICK)))),
        np.ones(1, dtype=np.uint16),
    )
    return [car_model_text(law), car_model_text(replace(law, forest=one_leaf))]


def warm_up_episodes(
    controller: str = DEFAULT, *, objective: Objective = Objective.PAPER, car_model: str = "", dynamics: str = BASIC
) -> list[EpisodeSpec]:
    """Return a safe and a kamikaze episode with a tiny budget.

    Args:
        controller: name of the car under test: what is known of it decides which planner is needed.
        objective: objective of the kamikaze, which decides as well.
        car_model: model of the car, as in `EpisodeSpec`, which decides as well.
        dynamics: dynamics of the car under test, which are compiled, too.
    """
    scenario = load_scenario(DYNAMICS[dynamics].scenario)
    across = Trajectory(np.array([(-2.0, 0.0), (2.0, 0.0)]), scenario.time_step)
    safe = EpisodeSpec(scenario, Mode.SAFE, 0, 0, simulations=10)
    chosen: dict[str, Any] = {"controller": controller, "objective": objective, "safe_trajectory": across}
    kamikaze = EpisodeSpec(scenario, Mode.KAMIKAZE, 0, 0, simulations=10, **chosen)
    if not car_model:
        return [safe, kamikaze]
    learned: dict[str, Any] = {"controller": controller, "car_model": car_model, "adversary_model": None}
    return [safe, replace(safe, **learned), replace(kamikaze, **learned)]
