"""Starts nodes as installed and looks at them from outside: a pytest plugin with the fixtures `watcher` and `start`."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
import yaml
from ament_index_python.packages import get_package_prefix, get_package_share_directory
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

TIMEOUT = 300.0  # s; discovery takes a few, and the machine may be busy
EVERY_NODE = {"/parameter_events", "/rosout"}
Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def watcher(monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    """Give a node that looks on from outside, in a domain of its own."""
    domain = os.environ.get("SKD_TEST_DOMAIN") or str(random.SystemRandom().randint(1, 101))
    monkeypatch.setenv("ROS_DOMAIN_ID", domain)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init()
    node = rclpy.create_node("watcher")
    yield node
    node.destroy_node()
    rclpy.shutdown()


UNHEARD = "ignore:failed to send response:RuntimeWarning"
"""rclpy's warning of a node that answers before it has discovered the client: `parameters_of` then asks again."""


@pytest.fixture
def start(watcher: Node) -> Iterator[Start]:
    """Give what starts an executable of a package; none outlives the test."""
    started: list[subprocess.Popen[str]] = []

    def start(package: str, name: str, *arguments: str) -> subprocess.Popen[str]:
        file = Path(get_package_prefix(package)) / "lib" / package / name
        process = subprocess.Popen(
            [file, "--ros-args", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            env={**os.environ, "PYTHONWARNINGS": UNHEARD},
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def ended(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Wait for a process; return exit code and output, without what Fast DDS says of ports that other programs hold."""
    output, _ = process.communicate(timeout=TIMEOUT)
    lines = [line for line in output.splitlines(keepends=True) if "RTPS_TRANSPORT_SHM" not in line]
    return process.returncode, "".join(lines)


def interrupt(process: subprocess.Popen[str]) -> tuple[int, str]:
    """End a process as Ctrl-C does; return exit code and output."""
    process.send_signal(signal.SIGINT)
    return ended(process)


def shipped_parameters(package: str, name: str) -> tuple[Path, dict[str, Any]]:
    """Return the parameter file of a package's node and its content."""
    file = Path(get_package_share_directory(package)) / "config" / f"{name}.yaml"
    content: dict[str, Any] = yaml.safe_load(file.read_text(encoding="utf-8"))
    return file, content[f"/**/{name}"]["ros__parameters"]


def parameters_of(watcher: Node, process: subprocess.Popen[str], name: str) -> tuple[dict[str, Any], dict[str, str]]:
    """Return values and descriptions of a running node's parameters, by name."""
    client = AsyncParameterClient(watcher, name)
    deadline = time.monotonic() + TIMEOUT
    while not client.wait_for_services(1.0):
        assert process.poll() is None, ended(process)
        assert time.monotonic() < deadline, f"{name} did not come up"

    def answer(ask: Callable[..., Any], *given: Any) -> Any:
        while True:  # an answer is lost where the node has not found us yet, though we have found it
            future = ask(*given)
            rclpy.spin_until_future_complete(watcher, future, timeout_sec=5.0)
            if future.done():
                return future.result()
            assert time.monotonic() < deadline, f"{name} does not answer"

    names = [name for name in answer(client.list_parameters).result.names if name != "start_type_description_service"]
    values = [parameter_value_to_python(value) for value in answer(client.get_parameters, names).values]
    described = answer(client.describe_parameters, names).descriptors
    return dict(zip(names, values, strict=True)), {one.name: one.description for one in described}


def topics_of(watcher: Node, name: str, wanted: tuple[set[str], set[str]]) -> tuple[set[str], set[str]]:
    """Return what a node publishes and what it listens to, once it is what is wanted, or at last."""
    deadline = time.monotonic() + TIMEOUT
    while True:
        try:
            published = {topic for topic, _ in watcher.get_publisher_names_and_types_by_node(name, "/")} - EVERY_NODE
            heard = {topic for topic, _ in watcher.get_subscriber_names_and_types_by_node(name, "/")}
        except RuntimeError:  # its services are known already, the node itself not yet
            published, heard = set(), set()
        if (published, heard) == wanted or time.monotonic() > deadline:
            return published, heard
        rclpy.spin_once(watcher, timeout_sec=0.1)
