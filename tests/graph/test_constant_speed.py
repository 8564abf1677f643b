"""The planner of the examples with stacks of others, alone with the car."""

from __future__ import annotations

import shlex
from importlib import resources
from pathlib import Path

import numpy as np
import yaml
from graph_support import skd
from skd_evaluator.bags.read import read_episodes
from skd_sim.world.episode import Outcome

SCRIPT = Path(__file__).resolve().parents[2] / "examples" / "constant_speed" / "constant_speed.py"


def test_it_asks_for_one_speed_and_answers_every_moment(tmp_path):
    scenario = yaml.safe_load((resources.files("skd_sim") / "scenarios" / "crossing.yaml").read_text(encoding="utf-8"))
    scenario["car"] |= {"speed_noise": 0.0, "acceleration_noise": 0.0}
    (tmp_path / "still.yaml").write_text(yaml.safe_dump(scenario), encoding="utf-8")
    topic = ("-p", "command_type:=ackermann", "-p", "command_topic:=/asked")
    command = f"python3 {shlex.quote(str(SCRIPT))} --ros-args -r command:=/asked -p speed:=6.5 -p ackermann:=true"
    car = ("--knowledge", "nothing", "--controller", "external", "--controller-command", command, *topic)
    done = skd("episode", "--mode", "safe", "--scenario", tmp_path / "still.yaml", *car, "--out", tmp_path / "out")
    assert done.code == 0, done.err
    log = read_episodes([tmp_path / "out" / "bags"])[0].log
    assert log.outcome == Outcome.ARRIVED
    np.testing.assert_allclose(log.car[0, 2], scenario["car"]["start_speed"])
    np.testing.assert_allclose(log.car[1:, 2], 6.5, rtol=1e-12)  # one tick of braking is enough, at less than 8 m/s²
