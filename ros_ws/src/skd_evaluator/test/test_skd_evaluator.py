"""The package as installed: shipped files, the evaluator, and an episode with all nodes.

For `colcon test`, with the workspace built and ROS 2 sourced.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import time
from pathlib import Path

import pytest
import yaml

ament_packages = pytest.importorskip("ament_index_python.packages")
rclpy = pytest.importorskip("rclpy")
parameter_client = pytest.importorskip("rclpy.parameter_client")

PACKAGE = "skd_evaluator"
TIMEOUT = 300.0  # s; discovery takes a few, the first start compiles, and the machine may be busy
EVERY_NODE = {"/parameter_events", "/rosout"}


@pytest.fixture
def watcher(monkeypatch):
    """Give a node that looks on from outside, in a domain of its own."""
    domain = os.environ.get("SKD_TEST_DOMAIN") or str(random.SystemRandom().randint(1, 101))
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init()
    node = rclpy.create_node("watcher")
    yield node
    node.destroy_node()
    rclpy.shutdown()


@pytest.fixture
def start(watcher):
    """Give what starts an installed executable; none outlives the test."""
    started = []

    def start(name, *arguments, package=PACKAGE):
        file = Path(ament_packages.get_package_prefix(package)) / "lib" / package / name
        process = subprocess.Popen(
            [file, "--ros-args", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def ended(process):
    """Wait for a process; return exit code and output, without what Fast DDS says of ports that other programs hold."""
    output, _ = process.communicate(timeout=TIMEOUT)
    lines = [line for line in output.splitlines(keepends=True) if "RTPS_TRANSPORT_SHM" not in line]
    return process.returncode, "".join(lines)


def interrupt(process):
    """End a process as Ctrl-C does; return exit code and output."""
    process.send_signal(signal.SIGINT)
    return ended(process)


def shipped_parameters(name):
    """Return the parameter file of a node and its content."""
    file = Path(ament_packages.get_package_share_directory(PACKAGE)) / "config" / f"{name}.yaml"
    return file, yaml.safe_load(file.read_text(encoding="utf-8"))[f"/**/{name}"]["ros__parameters"]


def parameters_of(watcher, process, name):
    """Return values and descriptions of a running node's parameters, by name."""
    client = parameter_client.AsyncParameterClient(watcher, name)
    deadline = time.monotonic() + TIMEOUT
    while not client.wait_for_services(1.0):
        assert process.poll() is None, ended(process)
        assert time.monotonic() < deadline, f"{name} did not come up"

    def answer(ask, *given):
        while True:  # an answer is lost where the node has not found us yet, though we have found it
            future = ask(*given)
            rclpy.spin_until_future_complete(watcher, future, timeout_sec=5.0)
            if future.done():
                return future.result()
            assert time.monotonic() < deadline, f"{name} does not answer"

    names = [name for name in answer(client.list_parameters).result.names if name != "start_type_description_service"]
    values = [rclpy.parameter.parameter_value_to_python(value) for value in answer(client.get_parameters, names).values]
    described = answer(client.describe_parameters, names).descriptors
    return dict(zip(names, values, strict=True)), {one.name: one.description for one in described}


def topics_of(watcher, name, wanted):
    """Return what a node publishes and what it listens to, once it is what is wanted, or at last."""
    deadline = time.monotonic() + TIMEOUT
    while True:
        try:
            published = {topic for topic, _ in watcher.get_publisher_names_and_types_by_node(name, "/")} - EVERY_NODE
            heard = {topic for topic, _ in watcher.get_subscriber_names_and_types_by_node(name, "/")}
        except RuntimeError:  # its services are known already, the node itself not yet
            published = heard = set()
        if (published, heard) == wanted or time.monotonic() > deadline:
            return published, heard
        rclpy.spin_once(watcher, timeout_sec=0.1)


@pytest.mark.parametrize(
    "file",
    ["launch/episode.launch.py", "launch/assessment.launch.py", "rviz/skd.rviz", "foxglove/skd.json"],
)
def test_file_is_installed(file):
    """What `ros2 launch`, RViz and Foxglove take is in share."""
    path = Path(ament_packages.get_package_share_directory(PACKAGE)) / file
    text = path.read_text(encoding="utf-8")
    if path.suffix in (".rviz", ".json"):
        assert yaml.safe_load(text)


def test_parameters_are_those_of_the_shipped_file(watcher, start, tmp_path):
    """All are described; Ctrl-C leaves no results."""
    file, wanted = shipped_parameters("evaluator")
    process = start("evaluator", "--params-file", str(file), "-p", f"out:={tmp_path / 'out'}")
    # The node answers while it waits for the simulator.
    values, descriptions = parameters_of(watcher, process, "evaluator")
    assert values == {**wanted, "out": str(tmp_path / "out")}
    assert [name for name in wanted if name != "use_sim_time" and not descriptions[name]] == []
    states = {"/ego/odometry", "/pedestrian/odometry", "/skd/episode_result"}
    recorded = {"/clock", "/ego/acceleration_command", "/pedestrian/velocity_command"}
    topics = ({"/skd/assessment", "/skd/episode", "/skd/markers"}, states | recorded)
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
        start("pedestrian_adversary", package="skd_adversary"),
    ]
    evaluator = start("evaluator", "-p", "task:=episode", "-p", "seed:=3", "-p", f"out:={tmp_path / 'out'}")
    code, output = ended(evaluator)
    assert code == 0, output
    episode = json.loads((tmp_path / "out" / "episode.json").read_text(encoding="utf-8"))
    assert episode["outcome"] in ("collision", "missed", "timeout")
    (bag,) = (tmp_path / "out" / "bags").iterdir()
    assert sorted(path.suffix for path in bag.iterdir()) == [".mcap", ".yaml"]
    assert [interrupt(other) for other in others] == [(0, "")] * 3
