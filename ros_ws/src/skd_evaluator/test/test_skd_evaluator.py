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


@pytest.mark.parametrize("name", NODES)
def test_node(watcher, start, name, tmp_path):
    """It has the parameters of its shipped file, described, and its topics; Ctrl-C ends it and leaves no results."""
    package, said, heard = NODES[name]
    file, wanted = shipped_parameters(package, name)
    out = {"out": str(tmp_path / "out")} if name == "evaluator" else {}
    process = start(
        package, name, "--params-file", str(file), *(word for path in out.values() for word in ("-p", f"out:={path}"))
    )
    values, descriptions = parameters_of(watcher, process, name)
    assert {name: values[name] for name in wanted} == wanted | out
    own = {"use_sim_time"} | {name for name in values if name.startswith("qos_overrides")}
    assert [name for name in values if name not in own and not descriptions[name]] == []
    assert topics_of(watcher, name, (said, heard)) == (said, heard)
    code, output = interrupt(process)
    assert code == (130 if out else 0)
    assert ("nothing was written" in output) if out else not output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("parameter", "said"),
    [("pacing:=fast", "must be one of lockstep, real_time"), ("rate_factor:=0.0", "rate_factor")],
)
def test_wrong_parameter_is_one_line_and_exit_code_2(start, parameter, said):
    """Nothing is started with a value that makes no sense."""
    process = start("skd_sim", "vehicle_simulator", "-p", parameter)
    code, output = ended(process)
    assert code == 2
    assert said in output
    assert len(output.splitlines()) == 1


def test_an_episode_with_all_nodes(start, tmp_path):
    """Four executables run an episode, record it, and end."""
    others = [start(package, name) for name, (package, *_) in NODES.items() if name != "evaluator"]
    out = tmp_path / "out"
    evaluator = start("skd_evaluator", "evaluator", "-p", "task:=episode", "-p", "seed:=3", "-p", f"out:={out}")
    code, output = ended(evaluator)
    assert code == 0, output
    episode = json.loads((out / "episode.json").read_text(encoding="utf-8"))
    assert episode["outcome"] in ("collision", "missed", "timeout")
    (bag,) = (out / "bags").iterdir()
    assert sorted(path.suffix for path in bag.iterdir()) == [".mcap", ".yaml"]
    assert [interrupt(other) for other in others] == [(0, "")] * 3
