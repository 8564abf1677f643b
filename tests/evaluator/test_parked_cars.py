"""Nobody walks through what is parked: not kamikazes, whatever they know, nor the margin trajectories, nor φ."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from cli_support import one_line, skd
from search_support import search_margin
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, episode_id
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.margin.basic_margins import unknown_for
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.metrics.deviation import Hit
from skd_sim.options.adversary import Objective
from skd_sim.scenario.scenario import Scenario, load_scenario, scenario_from_dict
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import Trajectory

CROSSING = load_scenario("crossing")
NORTH = float(np.pi / 2)


def parked(name: str = "crossing", edge: float = -1.0) -> Scenario:
    """A gap between two parked cars, 2.4 m long, and a wall beyond φ, which kamikazes would like to go through."""
    cars = [{"x": edge - 0.9, "y": y, "heading": NORTH, "length": 4.3, "width": 1.8} for y in (-3.35, 3.35)]
    return scenario_from_dict({**load_scenario(name).as_dict(), "obstacles": cars})


def assert_free(scenario: Scenario, points: np.ndarray, radius: float) -> None:
    """Against the corners of the rectangles, which are parallel to the axes here, at forty places of every step."""
    for obstacle in scenario.obstacles:
        low, high = obstacle.corners.min(axis=0), obstacle.corners.max(axis=0)
        for begin, end in pairwise(points):
            steps = begin + np.linspace(0.0, 1.0, 40)[:, None] * (end - begin)
            away = np.maximum(0.0, np.maximum(low - steps, steps - high))
            assert np.hypot(*away.T).min() >= radius - 1e-9, (begin, end)


def episodes(scenario: Scenario, count: int, **further: object) -> list[EpisodeSpec]:
    phi = Trajectory(np.array([(-3.5 + 0.75 * k, 0.0) for k in range(9)]), scenario.time_step, "straight")
    return [
        replace(
            EpisodeSpec(scenario, Mode.KAMIKAZE, 3, episode_id(EpisodeGroup.KAMIKAZE, 0, number), safe_trajectory=phi),
            **further,
        )
        for number in range(count)
    ]


@pytest.mark.parametrize("objective", list(Objective))
def test_kamikazes_go_around_and_hit(objective: Objective) -> None:
    scenario = parked()
    logs = [run_episode(one) for one in episodes(scenario, 12, objective=objective, simulations=300)]
    for log in logs:
        hit = np.isfinite(log.impact_time)
        assert_free(scenario, log.adversary if not hit else log.trajectory.positions, CROSSING.adversary.core)
    assert sum(log.hit for log in logs) >= 9


def test_the_margin_goes_around_and_is_no_less_than_without() -> None:
    scenario = parked(edge=-1.25)
    for blocked, free in zip(episodes(scenario, 6), episodes(CROSSING, 6), strict=True):
        found, least = search_margin(blocked, 256), exact_margin(free)
        assert isinstance(found, Hit)
        assert_free(scenario, found.trajectory.positions, CROSSING.adversary.core)
        assert found.distance >= least.distance - 1e-9
    with pytest.raises(ValueError, match="obstacles"):
        exact_margin(episodes(scenario, 1)[0])
    assert unknown_for(Plan(scenario)) == "beside obstacles"
    assert not unknown_for(Plan(CROSSING))


def test_safe_trajectories_lead_between_the_cars() -> None:
    scenario = parked()
    for phi in safe_trajectories(Plan(scenario, seed=1, safe_count=4), InProcessRunner(1)):
        assert_free(scenario, phi.positions, CROSSING.adversary.core)


def test_cyclists_brake_or_have_missed() -> None:
    cyclist = load_scenario("cyclist")
    cars = [{"x": -4.0, "y": y, "heading": NORTH, "length": 4.0, "width": 1.8} for y in (-3.0, 3.0)]
    scenario = scenario_from_dict({**cyclist.as_dict(), "obstacles": cars})
    phi = Trajectory(np.array([(-9.0 + 0.9 * k, 0.0) for k in range(18)]), scenario.time_step, "straight")
    for number in range(6):
        log = run_episode(EpisodeSpec(scenario, Mode.KAMIKAZE, 3, number, safe_trajectory=phi, simulations=300))
        walked = log.trajectory.positions if np.isfinite(log.impact_time) else log.adversary[:-1]
        assert_free(scenario, walked, scenario.adversary.core)


def test_a_safe_trajectory_through_an_obstacle_is_refused(tmp_path: Path) -> None:
    (tmp_path / "parked.yaml").write_text(yaml.safe_dump(parked().as_dict()))
    through = ["t,x,y", *(f"{0.3 * k:.1f},{-4.0 + 0.5 * k:.2f},-2.5" for k in range(17))]
    (tmp_path / "phi.csv").write_text("\n".join(through) + "\n")
    arguments = ("assess", "--scenario", "parked.yaml", "--safe-count", "1", "--quiet")
    one_line(skd(*arguments, "--safe", "phi.csv", cwd=tmp_path), 2, "phi.csv", "runs into obstacles[0]", "at 0.6 s")
