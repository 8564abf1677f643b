"""Controllers that perceive: who gets scans, which ones, and what is said where there are none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from skd_evaluator import AssessmentError, run_episode
from skd_evaluator.cli.main import main
from skd_sim.controllers.controller import SensingController, user_controller
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.sensors import PlanarLaser, Scan
from skd_sim.world.state import AdversaryState, CarState, Trajectory

CROSSING = load_scenario("crossing")
ACROSS = Trajectory(np.array([(-3.5 + 0.75 * tick, 0.0) for tick in range(8)]), CROSSING.time_step)
EPISODE = EpisodeSpec(CROSSING, Mode.REPLAY, 5, 77, controller="somebody's", safe_trajectory=ACROSS)


class Blind:
    def reset(self, scenario, rng):
        pass

    def command(self, car, adversary):
        return -1.0


class Seeing(Blind):
    """Keeps what it is given."""

    def __init__(self):
        self.calls = []

    def sense(self, scan: Scan) -> None:
        self.calls.append(scan)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        self.calls.append((car, adversary))
        return -1.0


class Stumbling(Blind):
    def sense(self, scan):
        raise RuntimeError("no eyes")


def test_each_command_comes_after_the_scan_of_its_tick():
    controller = Seeing()
    log = run_episode(EPISODE, user_controller(controller, "seeing"))
    scans, states = controller.calls[::2], controller.calls[1::2]
    assert len(scans) == len(states) == len(log.car) - 1
    laser = PlanarLaser(CROSSING, EPISODE.seed, EPISODE.episode_id)
    for tick, (scan, (car, adversary)) in enumerate(zip(scans, states, strict=True)):
        assert scan.ranges.tobytes() == laser.scan(car, adversary, tick).ranges.tobytes()


def test_whether_anybody_looks_changes_nothing_else():
    seen, unseen = run_episode(EPISODE, Seeing()), run_episode(EPISODE, Blind())
    assert seen.car.tobytes() == unseen.car.tobytes()


def test_a_controller_of_two_methods_needs_no_sensor():
    assert not isinstance(user_controller(Blind(), "blind"), SensingController)
    bare = run_episode(replace(EPISODE, scenario=replace(CROSSING, sensor=None)), user_controller(Blind(), "blind"))
    assert bare.car.tobytes() == run_episode(EPISODE, Blind()).car.tobytes()


def test_failures_of_sense_name_the_controller():
    with pytest.raises(AssessmentError, match="controller stumbling: sense failed with RuntimeError: no eyes"):
        run_episode(EPISODE, user_controller(Stumbling(), "stumbling"))


def test_a_sensing_controller_needs_a_sensor():
    with pytest.raises(UsageError, match="needs a laser scan, and scenario crossing has none: add a section sensor"):
        run_episode(replace(EPISODE, scenario=replace(CROSSING, sensor=None)), Seeing())


@pytest.mark.parametrize("command", [["assess"], ["assess", "--graph"], ["episode"]])
def test_the_command_line_says_so_before_any_work(command, tmp_path: Path, capsys):
    data = {key: value for key, value in CROSSING.as_dict().items() if key != "sensor"}
    file = tmp_path / "bare.yaml"
    file.write_text(yaml.safe_dump(data), encoding="utf-8")
    words = ["--adversary-model", "generic", "--controller", "cal", "--scenario", str(file)]
    code = main([*command, *words, "--out", str(tmp_path / "out")])
    assert code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "controller cal needs a laser scan, and scenario crossing has none" in line
    assert not (tmp_path / "out").exists()
