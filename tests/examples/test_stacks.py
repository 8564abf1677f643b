"""The examples that run stacks of others: what their files say fits together, and fits what SKD publishes."""

import re
import shlex
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
import yaml

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
TUTORIAL = EXAMPLES.parent / "docs" / "validation.md"
LAUNCHES = sorted(EXAMPLES.glob("*/*.launch.xml"))
HEARD = {"/ego/odometry", "/ego/scan"}  # what the examples take of SKD


def nodes(launch: Path) -> dict[str, ET.Element]:
    return {node.get("name") or node.get("exec", ""): node for node in ET.parse(launch).getroot().iter("node")}


def parameters(launch: Path) -> dict[str, Any]:
    """What the parameter files of a launch file say, by node."""
    files = {param.get("from", "") for param in ET.parse(launch).getroot().iter("param")}
    found = {}
    for name in files:
        content = yaml.safe_load((launch.parent / name.removeprefix("$(dirname)/")).read_text(encoding="utf-8"))
        found |= {node: content[node].pop("ros__parameters") for node in content}
        assert not any(content.values()), name
    return found


def remapped(node: ET.Element) -> dict[str, str]:
    return {remap.get("from", ""): remap.get("to", "") for remap in node.iter("remap")}


def planner(launch: Path) -> dict[str, str]:
    """What `constant_speed.py` is told in a launch file: parameters and remapped topics, by name."""
    (element,) = ET.parse(launch).getroot().iter("executable")
    words = shlex.split(element.get("cmd", ""))
    assert words[:2] == ["python3", "$(dirname)/../constant_speed/constant_speed.py"]
    return dict(word.split(":=") for word in words if ":=" in word)


def commands(launch: Path) -> list[list[str]]:
    """The commands, in the tutorial and beside a launch file, that assess what it starts."""
    texts = [path.read_text(encoding="utf-8") for path in (TUTORIAL, launch.parent / "README.md")]
    blocks = [block for text in texts for block in re.findall(r"```bash\n(.*?)```", text, re.DOTALL)]
    lines = [line for block in blocks for line in block.splitlines()]
    return [shlex.split(line) for line in lines if "scripts/skd assess" in line and str(launch.name) in line]


def option(words: list[str], name: str) -> str:
    return words[words.index(name) + 1]


@pytest.mark.parametrize("launch", LAUNCHES, ids=lambda launch: launch.parent.name)
def test_a_launch_file_names_files_that_there_are_and_nodes_that_have_parameters(launch):
    for name in re.findall(r"\$\(dirname\)/([\w./]+)", launch.read_text(encoding="utf-8")):
        assert (launch.parent / name).is_file(), name
    assert set(parameters(launch)) <= set(nodes(launch))
    clocks = {node: given.get("use_sim_time") for node, given in parameters(launch).items()}
    assert clocks.pop("lifecycle_manager", None) is None  # it works by the wall clock
    assert set(clocks.values()) == {True}


@pytest.mark.parametrize("launch", LAUNCHES, ids=lambda launch: launch.parent.name)
def test_the_documents_assess_what_the_launch_file_starts(launch):
    found = commands(launch)
    assert len(found) >= 2
    for words in found:
        assert option(words, "--controller-command") == f"ros2 launch {launch.relative_to(EXAMPLES.parent)}"
        assert option(words, "--controller") == "external"


def test_the_collision_monitor_stands_between_planner_and_car():
    launch = EXAMPLES / "collision_monitor" / "collision_monitor.launch.xml"
    monitor = parameters(launch)["collision_monitor"]
    assert planner(launch) == {"command": f"/{monitor['cmd_vel_in_topic']}"}
    assert monitor["enable_stamped_cmd_vel"] is True
    for words in commands(launch):
        assert f"command_topic:=/{monitor['cmd_vel_out_topic']}" in words
        assert "command_type:=twist_stamped" in words
    assert {monitor[source]["topic"] for source in monitor["observation_sources"]} <= HEARD
    assert parameters(launch)["lifecycle_manager"]["node_names"] == ["collision_monitor"]


def test_the_emergency_brake_goes_before_the_planner():
    launch = EXAMPLES / "emergency_brake" / "emergency_brake.launch.xml"
    mux = parameters(launch)["ackermann_mux"]["topics"]
    assert mux["emergency"]["priority"] > mux["cruise"]["priority"]
    assert planner(launch) == {"ackermann": "true", "command": mux["cruise"]["topic"]}
    for words in commands(launch):  # after a release the car has no command until the timeout is over
        (period,) = (float(word.partition(":=")[2]) for word in words if word.startswith("control_period:="))
        assert mux["emergency"]["timeout"] <= 2.0 * period
    brake = remapped(nodes(launch)["safety_node"])
    assert brake.pop("drive") == mux["emergency"]["topic"]
    assert set(brake.values()) == HEARD
    driven = remapped(nodes(launch)["ackermann_mux"])["ackermann_cmd"]
    for words in commands(launch):
        assert f"command_topic:={driven}" in words
        assert "command_type:=ackermann" in words
