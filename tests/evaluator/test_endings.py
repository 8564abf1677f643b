"""How an assessment counts episodes that end otherwise: endings, other road users, seldom settings."""

import copy
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from cli_support import one_line, skd
from common import run_skd
from search_support import search_margin
from skd_adversary.safe_trajectories.sources import read_csv_trajectory
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, episode_id
from skd_evaluator.assessment.plausibility import ROUNDING, recompute
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.margin.basic_margins import unknown_for
from skd_evaluator.margin.exact.exact import exact_margin
from skd_evaluator.metrics.aborted import not_credible
from skd_sim import EpisodeSpec, Mode, Outcome, Scenario, Trajectory, UsageError, load_scenario
from skd_sim.options.car_and_adversary import Objective
from skd_sim.scenario.scenario import scenario_from_dict

CROSSING = load_scenario("crossing")
MIRROR = np.array([-1.0, 1.0])


def changed(**sections: Any) -> Scenario:
    data = copy.deepcopy(CROSSING.as_dict())
    for name, keys in sections.items():
        data[name] = {key: value for key, value in {**data.get(name, {}), **keys}.items() if value is not None}
    return scenario_from_dict(data)


MIRRORED = changed(adversary={"start_x": 3.5, "destination_x": -2.0})
"""The same crossing from the East."""


@pytest.mark.parametrize("number", range(4))
def test_a_safe_crossing_from_the_east_is_the_mirror_image(number: int) -> None:
    """Safe mode sees the distance alone, which has no side; mirrored sums round alike."""
    one, other = (run_episode(EpisodeSpec(scene, Mode.SAFE, 3, number)) for scene in (CROSSING, MIRRORED))
    assert one.outcome == other.outcome
    np.testing.assert_array_equal(one.adversary * MIRROR, other.adversary)
    np.testing.assert_allclose(one.car[:, 1:], other.car[:, 1:], atol=1e-12)


@pytest.mark.parametrize("objective", list(Objective))
def test_kamikazes_from_the_east_hit_and_are_believed(objective: Objective) -> None:
    path = Trajectory(np.column_stack([3.5 - 0.75 * np.arange(8), np.zeros(8)]), 0.3)
    hits = 0
    for number in range(8):
        log = run_episode(
            EpisodeSpec(
                MIRRORED, Mode.KAMIKAZE, 0, number, multiplier=0.75, safe_trajectory=path, simulations=200,
                objective=objective,
            )
        )  # fmt: skip
        hits += log.outcome == Outcome.COLLISION
        assert recompute(log).deviation <= ROUNDING
        beyond = log.adversary[:, 0] < -MIRRORED.path_edge
        assert not beyond[:-1].any()
    assert hits >= 6


@pytest.mark.parametrize("number", range(3))
def test_the_margin_found_from_the_east_is_the_exact_one_from_the_west(number: int) -> None:
    """The search comes to what is exact, whichever side they come from."""
    path = np.column_stack([-3.5 + 0.7 * np.arange(9), 0.05 * np.arange(9)])
    west, east = (
        EpisodeSpec(
            scene, Mode.KAMIKAZE, 0, number, safe_trajectory=Trajectory(way, 0.3), objective=Objective.DEVIATION
        )
        for scene, way in ((CROSSING, path), (MIRRORED, path * MIRROR))
    )
    exact = exact_margin(west)
    found = search_margin(east, 512)
    assert 1.0 - 1e-9 <= found.distance / exact.distance <= 1.02


def test_a_region_ends_the_episode() -> None:
    """Somebody who walks along the lane, and has arrived 6 m further."""
    ending = {"arrived": {"ahead_of": 6.0}, "missed": {}}
    along = changed(adversary={"start_x": 1.6, "destination_x": None}, ending=ending)
    end = along.end
    assert not end.arrived(0.0, 6.0)
    assert end.arrived(0.0, 6.01)
    assert not any(end.missed(x, 0.0) for x in (-50.0, 0.0, 50.0))
    box = changed(adversary={"destination_x": None}, ending={"arrived": {"right_of": -1.0, "left_of": 1.0}})
    assert box.end.arrived(0.0, 99.0)
    assert not box.end.arrived(1.0, 0.0)
    assert box.end.crossing == 1.0
    assert box.end.missed(1.2, 0.0)  # as where nothing is said: beyond the car's path
    assert scenario_from_dict(along.as_dict()) == along


def test_a_file_that_walks_the_other_way_is_refused(tmp_path: Any) -> None:
    file = tmp_path / "phi.csv"
    file.write_text("t,x,y\n" + "".join(f"{0.3 * k},{-3.5 + 0.75 * k},0\n" for k in range(9)))
    assert read_csv_trajectory(file, CROSSING).positions[0, 0] == -3.5
    with pytest.raises(UsageError, match=r"walks East, .* crosses towards the West"):
        read_csv_trajectory(file, MIRRORED)
    assert Plan(MIRRORED).scenario.end.crossing == -1.0


BEHIND = f"""
name: behind
description: The adversary crosses behind a car ahead, which stops and stands.
extends: crossing
adversary: {{start_x: -6.0}}
others:
  - kind: car
    length: 4.0
    width: 1.7
    start_heading: {np.pi / 2}
    way: [{{time: 0.0, x: 0.0, y: 0.0}}, {{time: 2.4, x: 0.0, y: 12.0}}]
"""
COUNTS = ("--safe-count", "2", "--kamikaze-count", "3", "--collision-runs", "10", "--simulations", "60")


def test_a_car_that_brakes_for_the_adversary_alone_runs_into_the_car_ahead(tmp_path: Path) -> None:
    (tmp_path / "behind.yaml").write_text(BEHIND)
    done = skd("assess", "--multiplier", "0", "--scenario", "behind.yaml", *COUNTS, "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "episodes the car ran into others[0], a car, and not into the adversary" in done.stderr
    result = json.loads((tmp_path / "out" / "assessment.json").read_text(encoding="utf-8"))
    assert result["contact_rate"] == 1.0
    assert result["margin"] < 0.01
    verified = skd("verify", "out", cwd=tmp_path)
    assert verified.returncode == 0, verified.stderr


SMALL = (
    *("--adversary-model", "generic", "--safe-count", 2, "--kamikaze-count", 2, "--collision-runs", 2),
    *("--simulations", 20, "--workers", 1, "--behaviour", "none", "--no-pictures", "--quiet", "--seed", 1),
)


def test_a_kamikaze_that_is_hit_beyond_eta_max_has_no_margin(tmp_path, capsys):
    """The search looks no further; it was said that the car answers it otherwise than an episode."""
    (tmp_path / "near.yaml").write_text("extends: crossing_multi_body\nname: near\neta_max: 0.3\n")
    searched = ("--multiplier", 1.5, "--objective", "paper", "--margin-limit", 8)
    scenario = ("--scenario", tmp_path / "near.yaml")
    assert run_skd("assess", *searched, *scenario, *SMALL, "--out", tmp_path / "near") == 0
    figures = json.loads((tmp_path / "near" / "assessment.json").read_text())
    assert figures["deviation_of_successes"] > figures["eta_max"] == figures["margin"] == 0.3
    assert figures["margin_beyond"] == figures["margin_trials"] == 4
    assert not_credible(figures["warnings"]) == []
    assert "give a greater eta_max" in capsys.readouterr().err
    assert run_skd("verify", tmp_path / "near") == 0, capsys.readouterr().out


# --- Nobody walks through what is parked: not kamikazes, whatever they know, nor the margin trajectories, nor φ.


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
    numbers = [episode_id(EpisodeGroup.KAMIKAZE, 0, trial) for trial in range(count)]
    return [replace(EpisodeSpec(scenario, Mode.KAMIKAZE, 3, number, phi), **further) for number in numbers]


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
    for blocked, free in zip(episodes(scenario, 3), episodes(CROSSING, 3), strict=True):
        found, least = search_margin(blocked, 256), exact_margin(free)
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
