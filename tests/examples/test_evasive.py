"""Cars that evade, on a free and an occupied oncoming lane, in a curve, and as a node with Ackermann commands."""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from common import run_skd
from skd_evaluator.assessment.episode_figures import ROAD_EDGE, collision_partner, lane_left
from skd_evaluator.assessment.plausibility import examine
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.bags.read import read_episodes
from skd_sim.options.adversary import AdversaryModel
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "evasive"


def met(scenario: str, car: str) -> EpisodeLog:
    """Run a car beside somebody who walks across at 2 m/s."""
    phi = Trajectory(np.column_stack([np.minimum(-7.0 + 0.6 * np.arange(22), 5.0), np.zeros(22)]), 0.3)
    clocked = replace(load_scenario(scenario), control_period=0.05)
    generic = AdversaryModel.GENERIC
    car = f"{FOLDER}/evasive.py:{car}"
    return run_episode(EpisodeSpec(clocked, Mode.REPLAY, 0, 0, phi, controller=car, adversary_model=generic))


@pytest.mark.parametrize(
    ("scenario", "car", "partner"),
    [
        ("oncoming_lane", "Brakes", None),
        ("oncoming_lane", "BrakesToOtherLane", None),
        ("oncoming_traffic", "Brakes", None),
        ("oncoming_traffic", "BrakesToOtherLane", 0),  # the car that comes
        ("curve", "OtherLane", ROAD_EDGE),  # it takes every road for a straight one
        ("parked_car", "Brakes", 0),
    ],
)
def test_what_becomes_of_a_car_that_evades(scenario: str, car: str, partner: int | None) -> None:
    log = met(scenario, car)
    assert collision_partner(log) == partner
    assert (lane_left(log) > 0.5) == ("Lane" in car)
    assert examine(log).ours


def test_the_node_steers_by_ackermann_commands(tmp_path: Path) -> None:
    node = shlex.join([sys.executable, str(FOLDER / "evasive_node.py")])
    code = run_skd(
        "episode", "--mode", "replay", "--scenario", "oncoming_lane", "-p", "control_period:=0.1", "--controller",
        "external", "-p", "command_type:=ackermann", "-p", "command_topic:=/drive", "--controller-command", node,
        "--out", tmp_path / "out",
    )  # fmt: skip
    assert code == 0
    (found,) = read_episodes([tmp_path / "out"])
    assert found.log.outcome != Outcome.ABORTED
    assert found.log.car[:, 0].min() < -2.5  # it was in the other lane
    assert examine(found.log).ours
