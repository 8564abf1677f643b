"""The evaluator as a process of its own, as launch files and containers start it: parameters in, exit code out."""

import dataclasses
import json
import signal
import sys
from pathlib import Path

from common import new_domain
from graph_nodes import running, start_node, wait_for_end
from graph_support import Program, assert_same_results, skd_here
from packaging_support import NODES
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.bags.read import read_bags
from skd_sim.options.car_and_adversary import AdversaryModel

MODULES = {name: module for name, (_, module) in NODES.items()}


def node(name: str, domain: int, *words: str, **parameters: object) -> Program:
    """Start one node with further words of its command line, and parameters."""
    arguments = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
    command = [sys.executable, "-m", MODULES[name], "--ros-args", *words, *arguments]
    return Program(command, {"ROS_DOMAIN_ID": str(domain)})


def test_assessment_is_that_of_the_command_line(context, tmp_path, capsys):
    counts = {"safe_count": 1, "kamikaze_count": 3, "collision_runs": 4, "simulations": 300, "seed": 11}
    others, domain, said = {**MODULES}, new_domain(), tmp_path / "said"
    evaluator = others.pop("evaluator")
    with running(*(start_node(context, module, tmp_path / name, domain) for name, module in others.items())):
        node = start_node(context, evaluator, said, domain, **counts, multiplier=0.875, out=tmp_path / "node")
        assert wait_for_end(node) == 0, said.read_text()
    assert "afety margin " in said.read_text().splitlines()[-1]
    options = [word for key, value in counts.items() for word in (f"--{key.replace('_', '-')}", value)]
    assert skd_here(capsys, "assess", *options, "--multiplier", 0.875, "--out", tmp_path / "line").code == 0
    assert_same_results(tmp_path / "node", tmp_path / "line")
    assert len(list((tmp_path / "node" / "bags").iterdir())) == 3 + 3 + 4
    assert not (tmp_path / "node" / "logs").exists()


def test_an_episode_by_hand_is_one_bag_that_replays(tmp_path: Path) -> None:
    """Of a car of which nothing is known: no lesson comes before it; and in a namespace, with topics remapped."""
    names = ("-r", "__ns:=/lab", "-r", "ego/odometry:=/robot/odom", "-r", "ego/acceleration_command:=/robot/brake")
    domain = new_domain()
    car = {"car_controller": {"controller": "basic", "multiplier": 1.0}}
    programs = [node(name, domain, *names, **car.get(name, {})) for name in MODULES if name != "evaluator"]
    wanted = {"task": "episode", "controller": "external", "simulations": 50, "out": tmp_path / "out"}
    try:
        finished = node("evaluator", domain, *names, **wanted).finish()
        assert finished.code == 0, finished.err
    finally:
        for program in programs:
            program.popen.send_signal(signal.SIGINT)
    assert [program.finish().code for program in programs] == [0, 0, 0]
    (bag,) = (tmp_path / "out" / "bags").iterdir()
    (read,) = read_bags([bag]).episodes
    assert read.log.episode.adversary_model == AdversaryModel.GENERIC
    episode = json.loads((tmp_path / "out" / "episode.json").read_text())
    assert (read.log.outcome.name.lower(), len(read.log.car) - 1) == (episode["outcome"], episode["ticks"])
    replayed = run_episode(dataclasses.replace(read.log.episode, controller="basic", multiplier=1.0))
    assert replayed.car.tobytes() == read.log.car.tobytes()
    assert replayed.adversary.tobytes() == read.log.adversary.tobytes()
