"""What the tests of packages, launch files and scripts share."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "ros_ws" / "src"
PYTHON_PACKAGES = ("skd_sim", "skd_adversary", "skd_evaluator")
NODES = {  # node → package, module
    "vehicle_simulator": ("skd_sim", "skd_sim.nodes.vehicle_simulator"),
    "car_controller": ("skd_sim", "skd_sim.nodes.car_controller"),
    "pedestrian_adversary": ("skd_adversary", "skd_adversary.nodes.pedestrian_adversary"),
    "evaluator": ("skd_evaluator", "skd_evaluator.ros.evaluator_main"),
}
ALL_NODES = {**NODES, "carla_bridge": ("skd_sim", "skd_sim.nodes.carla_bridge")}  # no launch file starts the last


def settings(node: str) -> dict[str, Any]:
    """Return the parameters that a node declares, by name."""
    return {setting.name: setting for setting in importlib.import_module(ALL_NODES[node][1])._SETTINGS}


def defaults_on_file(node: str) -> dict[str, Any]:
    """Return the parameters of a node's file in config/."""
    content = yaml.safe_load((SOURCE / ALL_NODES[node][0] / "config" / f"{node}.yaml").read_text(encoding="utf-8"))
    assert list(content) == [f"/**/{node}"]
    assert list(content[f"/**/{node}"]) == ["ros__parameters"]
    return dict(content[f"/**/{node}"]["ros__parameters"])


def setup_arguments(package: str) -> dict[str, Any]:
    """Return what a package's setup.py says, as far as it is literal."""
    tree = ast.parse((SOURCE / package / "setup.py").read_text(encoding="utf-8"))
    (call,) = [
        node for node in ast.walk(tree) if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "setup"
    ]
    found = {}
    for keyword in call.keywords:
        try:
            found[str(keyword.arg)] = ast.literal_eval(keyword.value)
        except ValueError:
            found[str(keyword.arg)] = ast.unparse(keyword.value)
    return found


def executables(package: str) -> dict[str, str]:
    """Return the console scripts of a package: name → module:function."""
    scripts = setup_arguments(package)["entry_points"]["console_scripts"]
    return dict(tuple(part.strip() for part in script.split("=")) for script in scripts)
