"""What the views for RViz and Foxglove show is published, as the type that they show, whatever the car commands."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from rclpy.parameter import Parameter
from skd_adversary.ros.adversary_node import AdversaryNode
from skd_evaluator.ros.evaluator import Evaluator
from skd_sim.ros.commands import NAMED_FORMATS, message_class, number_paths
from skd_sim.ros.simulator_node import VehicleSimulator

EVALUATOR = Path(__file__).resolve().parents[2] / "ros_ws" / "src" / "skd_evaluator"
VIEW = EVALUATOR / "rviz" / "skd.rviz"
LAYOUT = EVALUATOR / "foxglove" / "skd.json"


@pytest.fixture(params=sorted(NAMED_FORMATS))
def published(request: pytest.FixtureRequest, domain: int) -> Iterator[dict[str, str]]:
    """Topics that SKD's nodes publish where the car commands by messages of a type, with their types."""
    simulator = VehicleSimulator(parameter_overrides=[Parameter("command_type", value=request.param)])
    nodes = [simulator, AdversaryNode(parameter_overrides=[Parameter("warm_up", value=False)]), Evaluator()]
    yield {one.topic_name: f"{one.msg_type.__module__.split('.')[0]}/msg/{one.msg_type.__name__}"
           for node in nodes for one in node.publishers}  # fmt: skip
    for node in nodes:
        node.destroy_node()


def test_rviz(published: dict[str, str]) -> None:
    manager = yaml.safe_load(VIEW.read_text(encoding="utf-8"))["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "map"
    shown = set()
    for display in manager["Displays"]:
        kind = display["Class"].partition("/")[2]
        for topic in (display[key] for key in ("Topic", "Description Topic") if key in display):
            shown.add(topic["Value"])
            assert published[topic["Value"]].endswith(f"/{'String' if kind == 'RobotModel' else kind}")
            latched = topic["Value"] in ("/skd/markers", "/robot_description")
            assert topic["Durability Policy"] == ("Transient Local" if latched else "Volatile")
    assert shown >= {"/skd/markers", "/robot_description", "/ego/scan", "/ego/odometry", "/skd/command"}
    assert "rviz_default_plugins/TF" in {display["Class"] for display in manager["Displays"]}


def strings(content: Any) -> list[str]:
    if isinstance(content, dict):
        return [text for key, value in content.items() for text in (*strings(key), *strings(value))]
    if isinstance(content, list):
        return [text for value in content for text in strings(value)]
    return [content] if isinstance(content, str) else []


def test_foxglove(published: dict[str, str]) -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    panels = layout["configById"]
    assert sorted(text for text in strings(layout["layout"]) if "!" in text) == sorted(panels)
    plotted = [path["value"] for panel in panels.values() for path in panel.get("paths", ())]
    for path in plotted:
        topic, _, field = path.partition(".")
        assert field in number_paths(message_class(published[topic])), path
    assert "/skd/command.accel.linear.x" in plotted
    named = {text.partition(".")[0] for text in strings(panels) if re.match(r"/((skd|ego|adversary)/|robot_)", text)}
    assert named <= published.keys()
    assert [panel["followTf"] for panel in panels.values() if panel.get("followMode") == "follow-pose"] == ["base_link"]
