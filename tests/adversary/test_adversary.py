"""The adversary sees the car through its sensor's noise, as much of it as the scenario says, and no more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from skd_adversary.adversary import PlanningAdversary, make_adversary
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import CarState, Trajectory

CROSSING = load_scenario("crossing")
ACROSS = Trajectory(np.column_stack([np.arange(-3.5, 3.0, 0.75), np.zeros(9)]), CROSSING.time_step)
DRAWS = 4000


def noisy(position: float, distance: float) -> Scenario:
    adversary = replace(CROSSING.adversary, position_noise=position, distance_noise=distance)
    return replace(CROSSING, adversary=adversary)


def adversary(scenario: Scenario, controller: str) -> PlanningAdversary:
    episode = EpisodeSpec(scenario, Mode.KAMIKAZE, 3, 1, controller=controller, safe_trajectory=ACROSS, simulations=1)
    made = make_adversary(episode)
    assert isinstance(made, PlanningAdversary)
    return made


@pytest.mark.parametrize(
    ("controller", "truth"), [("basic", -12.0), ("carla", float(np.hypot(3.5, 12.0)))], ids=["position", "distance"]
)
@pytest.mark.parametrize("noise", [0.25, 1.0])
def test_what_is_seen_is_the_truth_and_the_noise_that_the_scenario_says(controller, truth, noise):
    """Of n normal draws mean and deviation are within 4.5 standard errors: σ/√n and σ/√2n."""
    mine = (noise, 7.0) if controller == "basic" else (7.0, noise)  # the other sensor's must not be taken
    sees = adversary(noisy(*mine), controller)
    seen = np.array([sees._sense(CarState(0.0, -12.0, np.pi / 2, 8.0))[0] for _ in range(DRAWS)])
    assert seen.mean() == pytest.approx(truth, abs=4.5 * noise / np.sqrt(DRAWS))
    assert seen.std() == pytest.approx(noise, rel=4.5 / np.sqrt(2 * DRAWS))
    assert abs(np.corrcoef(seen[1:], seen[:-1])[0, 1]) < 4.5 / np.sqrt(DRAWS)
