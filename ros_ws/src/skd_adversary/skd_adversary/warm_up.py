"""Short episodes that make every planner compile, or load from its cache, before it is timed or forked."""

from __future__ import annotations

import numpy as np
from skd_sim.episode import Episode, Mode
from skd_sim.objective import Objective
from skd_sim.scenario import load_scenario
from skd_sim.trajectory import Trajectory


def warm_up_episodes(controller: str = "basic", objective: Objective = Objective.PAPER) -> list[Episode]:
    """Return a safe and a kamikaze episode with a tiny budget.

    Args:
        controller: of the car under test: what is known of it decides which planner is needed.
        objective: likewise.
    """
    scenario = load_scenario("crossing")
    across = Trajectory(np.array([(-2.0, 0.0), (2.0, 0.0)]), scenario.time_step)
    return [
        Episode(scenario, Mode.SAFE, 0, 0, simulations=10),
        Episode(
            scenario,
            Mode.KAMIKAZE,
            0,
            0,
            controller=controller,
            safe_trajectory=across,
            simulations=10,
            objective=objective,
        ),
    ]
