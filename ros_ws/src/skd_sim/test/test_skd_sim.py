"""The package as installed: scenarios, parameter files, both nodes, and an episode between them.

For `colcon test`, with the workspace built and ROS 2 sourced.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy")

from skd_sim.ros.installed_nodes import ended, interrupt, parameters_of, shipped_parameters, topics_of

PACKAGE = "skd_sim"
pytest_plugins = ["skd_sim.ros.installed_nodes"]

COMMANDS = ("/ego/acceleration_command", "/adversary/velocity_command")
STATES = ("/ego/odometry", "/adversary/odometry")
SENSORS = {"/ego/imu", "/ego/points", "/ego/scan"}
if importlib.util.find_spec("vision_msgs"):
    SENSORS.add("/adversary/detections")
FRAMES = {"/robot_description", "/tf", "/tf_static"}
TOPICS = {
    "vehicle_simulator": (
        {"/clock", *STATES, *SENSORS, *FRAMES, "/skd/episode_result"},
        {*COMMANDS, "/skd/episode"},
    ),
    "car_controller": ({COMMANDS[0]}, {*STATES, "/skd/episode"}),
}


def test_scenarios_are_installed():
    """All can be read."""
    folder = Path(importlib.util.find_spec(PACKAGE).origin).parent / "scenarios"
    for name in ("crossing", "citr_crossing", "crossing_multi_body"):
        assert yaml.safe_load((folder / f"{name}.yaml").read_text(encoding="utf-8"))["name"] == name


def test_network_of_cal_is_installed():
    """Both its files."""
    folder = Path(importlib.util.find_spec(PACKAGE).origin).parent / "controllers"
    assert [path.stat().st_size > 0 for path in sorted(folder.glob("hazard_network.*"))] == [True, True]


@pytest.mark.parametrize("name", TOPICS)
def test_node(watcher, start, name):
    """It has the parameters of its shipped file, described, and its topics; Ctrl-C ends it without a word."""
    file, wanted = shipped_parameters(PACKAGE, name)
    process = start(name, "--params-file", str(file))
    values, descriptions = parameters_of(watcher, process, name)
    assert {name: values[name] for name in wanted} == wanted
    own = {"use_sim_time"} | {name for name in values if name.startswith("qos_overrides")}
    assert [name for name in values if name not in own and not descriptions[name]] == []
    assert topics_of(watcher, name, TOPICS[name]) == TOPICS[name]
    assert interrupt(process) == (0, "")


@pytest.mark.parametrize(
    ("parameter", "said"),
    [("pacing:=fast", "must be one of lockstep, real_time"), ("rate_factor:=0.0", "rate_factor")],
)
def test_wrong_parameter_is_one_line_and_exit_code_2(start, parameter, said):
    """Nothing is started with a value that makes no sense."""
    process = start("vehicle_simulator", "-p", parameter)
    code, output = ended(process)
    assert code == 2
    assert said in output
    assert len(output.splitlines()) == 1
