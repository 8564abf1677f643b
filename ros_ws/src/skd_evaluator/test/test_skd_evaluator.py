"""The packages as installed: shipped files, every node, and an episode with all of them.

For `colcon test`, with the workspace built and ROS 2 sourced.
"""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy")

from ament_index_python.packages import get_package_share_directory
from installed_nodes import ended, interrupt, parameters_of, shipped_parameters, topics_of

pytest_plugins = ["installed_nodes"]

COMMANDS = ("/ego/acceleration_command", "/adversary/velocity_command")
STATES = ("/ego/odometry", "/adversary/odometry")
SENSORS = {"/ego/imu", "/ego/points", "/ego/scan"}
if importlib.util.find_spec("vision_msgs"):
    SENSORS.add("/adversary/detections")
FIGURES = {"/skd/clearance", "/skd/deviation"}
FRAMES = {"/robot_description", "/tf", "/tf_static"}
NODES = {
    "vehicle_simulator": ("skd_sim", {"/clock", *STATES, *SENSORS, *FRAMES, "/skd/episode_result", "/skd/command"},
                          {*COMMANDS, "/skd/episode"}),
    "car_controller": ("skd_sim", {COMMANDS[0]}, {*STATES, "/skd/episode"}),
    "adversary": ("skd_adversary", {COMMANDS[1], "/skd/believed_car"}, {STATES[0], "/skd/episode"}),
    "evaluator": ("skd_evaluator", {"/skd/assessment", "/skd/episode", "/skd/markers", "/diagnostics", *FIGURES},
                  {"/clock", *STATES, *COMMANDS, *FRAMES, "/skd/episode_result", "/skd/command"}),
}  # fmt: skip
"""Package of each node, what it publishes, and what it listens to."""


@pytest.mark.parametrize(
    "file",
    ["launch/episode.launch.py", "launch/assessment.launch.py", "rviz/skd.rviz", "foxglove/skd.json"],
)
def test_file_is_installed(file):
    """What `ros2 launch`, RViz and Foxglove take is in share."""
    path = Path(get_package_share_directory("skd_evaluator")) / file
    text = path.read_text(encoding="utf-8")
    if path.suffix in (".rviz", ".json"):
        assert yaml.safe_load(text)


def looks_as_shipped(watcher, start, name, *arguments):
    """Start a node with its shipped file: it has the parameters in there, all described, and its topics."""
    package, said, heard = NODES[name]
    file, wanted = shipped_parameters(package, name)
    process = start(package, name, "--params-file", str(file), *arguments)
    values, descriptions = parameters_of(watcher, process, name)
    given = dict(word.split(":=") for word in arguments[1::2])
    assert {name: values[name] for name in wanted} == wanted | given
    own = {"use_sim_time"} | {name for name in values if name.startswith("qos_overrides")}
    assert [name for name in values if name not in own and not descriptions[name]] == []
    assert topics_of(watcher, name, (said, heard)) == (said, heard)
    return process


def test_the_evaluator_alone(watcher, start, tmp_path):
    """Ctrl-C ends it and leaves no results."""
    process = looks_as_shipped(watcher, start, "evaluator", "-p", f"out:={tmp_path / 'out'}")
    code, output = interrupt(process)
    assert code == 130
    assert "nothing was written" in output
    assert list(tmp_path.iterdir()) == []


def test_an_episode_with_all_nodes(watcher, start, tmp_path):
    """Four executables run an episode, record it, and end."""
    others = [looks_as_shipped(watcher, start, name) for name in NODES if name != "evaluator"]
    out = tmp_path / "out"
    evaluator = start("skd_evaluator", "evaluator", "-p", "task:=episode", "-p", "seed:=3", "-p", f"out:={out}")
    code, output = ended(evaluator)
    assert code == 0, output
    episode = json.loads((out / "episode.json").read_text(encoding="utf-8"))
    assert episode["outcome"] in ("collision", "missed", "timeout")
    (bag,) = (out / "bags").iterdir()
    assert sorted(path.suffix for path in bag.iterdir()) == [".mcap", ".yaml"]
    assert [interrupt(other) for other in others] == [(0, "")] * 3
