"""Single nodes: pacing, kinds of commands, parameters, and nodes and commands that are wrong."""

import dataclasses
import gc
import math
import shlex
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rclpy
from common import PATIENCE, new_domain
from graph_nodes import ADVERSARY, CONTROLLER, EVALUATOR, SIMULATOR, evaluator, running, start_node, wait_for_end
from graph_support import HERE, assert_same_log, whole_graph
from rclpy.signals import SignalHandlerOptions
from rosbags.highlevel import AnyReader
from skd_adversary.ros.adversary_node import AdversaryNode
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.bags.read import read_bags
from skd_evaluator.ros import evaluator as evaluator_module
from skd_evaluator.ros.evaluator_node import EvaluatorProcess
from skd_sim.ros.controller_node import CarController
from skd_sim.ros.simulator_node import VehicleSimulator
from skd_sim.world.episode import AbortKind, EpisodeLog, EpisodeSpec, Outcome, kind_of


def test_real_time_takes_the_time_that_it_simulates(tmp_path: Path, replay: EpisodeSpec) -> None:
    rate = 8.0
    options = GraphOptions(pacing="real_time", rate_factor=rate, slip_limit=PATIENCE)
    with whole_graph(tmp_path, options, record_to=tmp_path / "bags") as (node, _):
        node.run_episode(replay)  # includes the nodes' start
        begin = time.perf_counter()
        log = node.run_episode(dataclasses.replace(replay, episode_id=replay.episode_id + 1))
        seconds = time.perf_counter() - begin
    assert log.outcome in (Outcome.COLLISION, Outcome.ARRIVED)
    lasted = (len(log.adversary) - 1) * replay.scenario.time_step / rate
    assert lasted <= seconds < 0.9 * rate * lasted  # the latter: as if there were no rate
    # the adversary walks along φ, with at most a few ticks of delay
    assert np.abs(log.adversary[:, 1]).max() == 0.0
    assert np.all(np.diff(log.adversary[:, 0]) >= 0.0)
    recorded = read_bags([tmp_path / "bags"]).episodes
    assert_same_log(recorded[-1].log, log)


@pytest.mark.parametrize("stamped", [True, False])
def test_a_controller_that_publishes_a_speed(tmp_path: Path, replay: EpisodeSpec, stamped: bool) -> None:
    target = 5.0
    command = [sys.executable, str(HERE / "fake_nodes.py"), "speed", "--ros-args"]
    command += ["-p", f"stamped:={str(stamped).lower()}", "-p", f"target:={target}"]
    how = {"controller_command": shlex.join(command), "command_timeout": PATIENCE}
    options = GraphOptions(command_type="twist_stamped" if stamped else "twist", **how)
    external = dataclasses.replace(replay, controller="external", adversary_model="generic")
    bags = tmp_path / "bags"
    with whole_graph(tmp_path, options, record_to=bags) as (node, _):
        logs: list[EpisodeLog] = []
        deadline = time.monotonic() + PATIENCE
        while True:  # the recorder and somebody else's node may find each other late: the first bags may lack commands
            number = replay.episode_id + len(logs)
            logs.append(node.run_episode(dataclasses.replace(external, episode_id=number)))
            (bag,) = bags.glob(f"*_{number:016x}")
            with AnyReader([bag]) as reader:
                found = {c.topic: (c.msgtype, c.msgcount) for c in reader.connections}
            kind, count = found.get("/ego/acceleration_command", ("", 0))
            if (len(logs) > 1 and count >= len(logs[-1].car) - 1) or time.monotonic() > deadline:
                break
    for log in logs:
        assert log.outcome in (Outcome.COLLISION, Outcome.ARRIVED), log.reason
        speed = log.car[:, 3]
        assert speed[1] < speed[0] - 0.3 * 8.0 * 0.9 + 0.05 * speed[0]  # as hard as the simulator's bound allows
        assert np.all(np.abs(speed[3:] - target) <= 0.2 * target)  # the car's noise, and one tick of delay, remain
    assert kind == f"geometry_msgs/msg/{'TwistStamped' if stamped else 'Twist'}"
    assert count >= len(logs[-1].car) - 1
    assert len(read_bags([bags]).episodes) == len(logs)


LEARNED = {"task": "episode", "controller": "external", "adversary_model": "learned"}


@pytest.mark.parametrize(
    ("module", "parameters", "said"),
    [
        (SIMULATOR, {"command_type": "joy"}, "accel_stamped"),
        (SIMULATOR, {"rate_factor": 1e6}, "rate_factor"),
        (EVALUATOR, {"scenario": "no_such"}, "no_such"),
        (EVALUATOR, {"out": "/proc"}, "give a new folder"),
        (EVALUATOR, LEARNED, "name a model with car_model"),
    ],
)
def test_a_wrong_parameter_is_one_line_and_exit_code_2(context, tmp_path, module, parameters, said):
    log = tmp_path / "log"
    assert wait_for_end(start_node(context, module, log, new_domain(), **parameters)) == 2, log.read_text()
    lines = log.read_text().splitlines()
    assert len(lines) == 1, lines
    assert said in lines[0]


@pytest.mark.parametrize("kind", [VehicleSimulator, CarController, AdversaryNode, EvaluatorProcess])
def test_an_unknown_parameter_is_warned_of(domain, kind, tmp_path, monkeypatch, capfd):
    """On the command line and in a file alike; what rclpy itself looks after is known."""
    monkeypatch.chdir(tmp_path)
    known = {VehicleSimulator: "command_timeout", CarController: "multiplier", AdversaryNode: "warm_up"}
    name = known.get(kind, "safe_count")
    wrong = name[:2] + name[3:]
    Path("other.yaml").write_text(f"/**:\n  ros__parameters:\n    {wrong}: 3\n    colour: red\n")
    rclpy.shutdown()
    arguments = ["--ros-args", "-p", "use_sim_time:=true", "--params-file", "other.yaml"]
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    node = kind()
    node.destroy_node()
    del node
    gc.collect()
    said = [line.partition("]: ")[2] for line in capfd.readouterr().err.splitlines() if "WARN" in line]
    lines = [line for line in said if "parameter" in line]  # a node of that name may have been here before
    assert sorted(lines) == ["there is no parameter colour", f"there is no parameter {wrong}; did you mean {name}?"]


def test_nobody_walks(context, domain, tmp_path, replay, monkeypatch):
    monkeypatch.setattr(evaluator_module, "_FIRST_DISCOVERY", 3.0)
    simulator = start_node(context, SIMULATOR, tmp_path / "s", domain, startup_timeout=2.0)
    nodes = running(simulator, start_node(context, CONTROLLER, tmp_path / "c", domain))
    with nodes, evaluator(tmp_path / "bags", silence_limit=4.0) as node:
        log = node.run_episode(replay)
    assert log.outcome == Outcome.ABORTED
    assert log.reason == (
        "not started: the adversary (adversary/velocity_command) stayed silent for 2 s at tick 0: "
        "no node publishes on /adversary/velocity_command"
    )
    assert len(log.adversary) == 1
    assert math.isnan(log.impact_time)
    assert_same_log(read_bags([tmp_path / "bags"]).episodes[0].log, log)


def test_nobody_simulates(domain: int, tmp_path: Path, replay: EpisodeSpec) -> None:
    with evaluator(tmp_path / "bags", silence_limit=0.5) as node:
        log = node.run_episode(replay)
    assert log.outcome == Outcome.ABORTED
    assert "vehicle simulator" in log.reason
    recorded = read_bags([tmp_path / "bags"]).episodes[0].log
    assert (recorded.outcome, recorded.reason) == (log.outcome, log.reason)
    assert_same_log(recorded, log)


COME_LATE = 5000  # episodes: some ten seconds, within which a node that has been started is there
LOST = {"lockstep": {}, "real_time": {"pacing": "real_time", "rate_factor": 2.0, "slip_limit": PATIENCE}}


@pytest.mark.parametrize(
    ("module", "topic", "pacing"),
    [(CONTROLLER, "ego/acceleration_command", "lockstep"), (ADVERSARY, "adversary/velocity_command", "real_time")],
)
def test_two_senders(context, domain, tmp_path, replay, module, topic, pacing):
    """Which of them would be heard depends on timing; the second one is refused though it says the same.

    It may come after some episodes that were right.
    """
    settings = {"command_timeout": PATIENCE, "startup_timeout": PATIENCE, **LOST[pacing]}
    nodes = [start_node(context, SIMULATOR, tmp_path / "simulator", domain, **settings)]
    nodes += [start_node(context, name, tmp_path / name, domain) for name in (CONTROLLER, ADVERSARY, module)]
    with running(*nodes), evaluator() as node:
        for number in range(COME_LATE):
            log = node.run_episode(dataclasses.replace(replay, episode_id=replay.episode_id + number))
            if number and log.outcome == Outcome.ABORTED:
                break
    assert log.outcome == Outcome.ABORTED
    assert kind_of(log.reason) == AbortKind.SECOND_SENDER, log.reason
    assert topic in log.reason
