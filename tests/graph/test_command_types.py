"""A car whose messages SKD has never seen: from a folder of .msg files to the command line, the car and the bag."""

import dataclasses
import shlex
import sys
from pathlib import Path

import numpy as np
from graph_support import HERE, assert_same_log, skd
from rosbags.highlevel import AnyReader
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.bags.read import read_bags
from skd_sim import AdversaryState, CarState, Scenario

MESSAGES = HERE / "messages"
VENDOR = (
    "-p", "command_type:=vendor_control_msgs/msg/Control", "-p", "command_topic:=/control/command/control_cmd",
    "-p", f"message_folder:={MESSAGES}",
)  # fmt: skip
NODE = shlex.join([sys.executable, str(HERE / "fake_nodes.py"), "vendor"])


class Vendor:
    """The law of the foreign node of that name in fake_nodes.py, as a class."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        pass

    def command(self, car: CarState, adversary: AdversaryState) -> tuple[float, float]:
        return (-3.0, 0.03) if car.y > -9.0 else (0.0, 0.0)


def test_a_type_from_a_folder_drives_the_car(safe: Path, tmp_path: Path) -> None:
    """With its own control period too: the motion is that of the same law in process, to the last bit."""
    run = ("episode", "--mode", "replay", "--safe", safe, "--controller", "external", "--controller-command", NODE)
    run += ("--adversary-model", "generic")
    field = ("-p", "command_field:=longitudinal.acceleration", "-p", "command_steering:=steering_tire_angle")
    done = skd(*run, *VENDOR, *field, "-p", "control_period:=0.1", "--out", tmp_path / "out")
    assert done.code == 0, done.err
    (found,) = read_bags([tmp_path / "out"]).episodes
    assert found.log.episode.scenario.control_periods == 3
    plain = run_episode(dataclasses.replace(found.log.episode, controller="basic"), Vendor())
    assert plain.car[:, 3].min() < 6.0  # it did brake
    assert plain.car[-1, 0] < -0.05  # and went to the left
    assert_same_log(plain, found.log)
    with AnyReader([next((tmp_path / "out" / "bags").iterdir())]) as reader:
        (connection,) = [one for one in reader.connections if one.topic == "/control/command/control_cmd"]
        commands = [reader.deserialize(data, connection.msgtype) for *_, data in reader.messages([connection])]
    assert connection.msgtype == "vendor_control_msgs/msg/Control"
    assert len(commands) >= 3 * (len(plain.car) - 2)
    assert {command.source for command in commands} == {"vendor"}
    assert {command.longitudinal.acceleration for command in commands} == {0.0, -3.0}
