"""The package as installed: shipped files, the evaluator, and an episode with all nodes.

For `colcon test`, with the workspace built and ROS 2 sourced.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy")

from ament_index_python.packages import get_package_share_directory
from skd_sim.ros.installed_nodes import ended, interrupt, parameters_of, shipped_parameters, topics_of

PACKAGE = "skd_evaluator"
pytest_plugins = ["skd_sim.ros.installed_nodes"]


@pytest.mark.parametrize(
    "file",
    ["launch/episode.launch.py", "launch/assessment.launch.py", "rviz/skd.rviz", "foxglove/skd.json"],
)
def test_file_is_installed(file):
    """What `ros2 launch`, RViz and Foxglove take is in share."""
    path = Path(get_package_share_directory(PACKAGE)) / file
    text = path.read_text(encoding="utf-8")
    if path.suffix in (".rviz", ".json"):
        assert yaml.safe_load(text)


def test_parameters_are_those_of_the_shipped_file(watcher, start, tmp_path):
    """All are described, and those of the file as it says; Ctrl-C leaves no results."""
    file, wanted = shipped_parameters(PACKAGE, "evaluator")
    process = start("evaluator", "--params-file", str(file), "-p", f"out:={tmp_path / 'out'}")
    # The node answers while it waits for the simulator.
    values, descriptions = parameters_of(watcher, process, "evaluator")
    assert {name: values[name] for name in wanted} == {**wanted, "out": str(tmp_path / "out")}
    own = {"use_sim_time"} | {name for name in values if name.startswith("qos_overrides")}
    assert [name for name in values if name not in own and not descriptions[name]] == []
    states = {"/ego/odometry", "/adversary/odometry", "/skd/episode_result"}
    recorded = {"/clock", "/ego/acceleration_command", "/adversary/velocity_command"}
    recorded |= {"/robot_description", "/tf", "/tf_static"}
    said = {"/skd/assessment", "/skd/episode", "/skd/markers"}
    topics = (said, states | recorded)
    assert topics_of(watcher, "evaluator", topics) == topics
    code, output = interrupt(process)
    assert code == 130
    assert "nothing was written" in output
    assert list(tmp_path.iterdir()) == []


def test_an_episode_with_all_nodes(start, tmp_path):
    """Four executables run an episode, record it, and end."""
    others = [
        start("vehicle_simulator", package="skd_sim"),
        start("car_controller", package="skd_sim"),
        start("adversary", package="skd_adversary"),
    ]
    evaluator = start("evaluator", "-p", "task:=episode", "-p", "seed:=3", "-p", f"out:={tmp_path / 'out'}")
    code, output = ended(evaluator)
    assert code == 0, output
    episode = json.loads((tmp_path / "out" / "episode.json").read_text(encoding="utf-8"))
    assert episode["outcome"] in ("collision", "missed", "timeout")
    (bag,) = (tmp_path / "out" / "bags").iterdir()
    assert sorted(path.suffix for path in bag.iterdir()) == [".mcap", ".yaml"]
    assert [interrupt(other) for other in others] == [(0, "")] * 3
