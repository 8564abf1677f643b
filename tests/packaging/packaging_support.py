"""What the tests of packages, launch files and scripts share."""

import configparser
import importlib
import re
import shlex
from pathlib import Path
from typing import Any

import yaml
from common import run_program
from skd_evaluator.assessment.options import CampaignOptions, EvaluatorOptions, TaskOptions
from skd_evaluator.cli.main import make_parser
from skd_sim.options.options import SimulatorOptions, options_of

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "ros_ws" / "src"
PYTHON_PACKAGES = ("skd_sim", "skd_adversary", "skd_evaluator")
NODES = {  # node → package, module
    "vehicle_simulator": ("skd_sim", "skd_sim.ros.simulator_node"),
    "car_controller": ("skd_sim", "skd_sim.ros.controller_node"),
    "adversary": ("skd_adversary", "skd_adversary.ros.adversary_node"),
    "evaluator": ("skd_evaluator", "skd_evaluator.ros.evaluator_node"),
}
STEERING = {"use_builtin_controller", "params_file", "rviz", "end_launch"}  # arguments that change the launch itself
ALL_NODES = {**NODES, "carla_bridge": ("skd_sim", "skd_sim.ros.carla_bridge")}  # no launch file starts the last


def tracked(*folders: str) -> list[str]:
    """Files of the checkout, of which a test's own are none."""
    listed = run_program(
        "git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", *folders, cwd=ROOT
    ).stdout
    return [name for name in listed.split("\0") if name and (ROOT / name).is_file()]


def settings(node: str) -> dict[str, Any]:
    """Return the parameters that a node declares, by name."""
    tables = importlib.import_module(ALL_NODES[node][1]).TABLES
    return {one.name: one for table in tables for one in options_of(table)}


def defaults_on_file(node: str) -> dict[str, Any]:
    """Return the parameters of a node's file in config/."""
    content = yaml.safe_load((SOURCE / ALL_NODES[node][0] / "config" / f"{node}.yaml").read_text(encoding="utf-8"))
    assert list(content) == [f"/**/{node}"]
    assert list(content[f"/**/{node}"]) == ["ros__parameters"]
    return dict(content[f"/**/{node}"]["ros__parameters"])


def setup_section(package: str, section: str) -> configparser.SectionProxy:
    """Return what a package's setup.cfg says in a section."""
    found = configparser.ConfigParser()
    found.read(SOURCE / package / "setup.cfg", encoding="utf-8")
    return found[section]


def executables(package: str) -> dict[str, str]:
    """Return the console scripts of a package: name → module:function."""
    scripts = setup_section(package, "options.entry_points")["console_scripts"].strip().splitlines()
    return dict(tuple(part.strip() for part in script.split("=")) for script in scripts)


def check_command(line: str) -> None:
    """Every word of a command of ours that can be checked: executable, parameters, options."""
    words = shlex.split(line)
    while re.match(r"[A-Z_]+=", words[0]) and len(words) > 1:  # variables of this command alone
        del words[0]
    if words[:2] == ["ros2", "run"] and words[2].startswith("skd_"):
        assert words[3] in executables(words[2])
        check_parameters(words[3], words[4:])
    elif words[0] == "scripts/run-node":
        if words[1] != "--":
            check_parameters(words[1], words[2:])
    elif words[:2] == ["ros2", "launch"] and words[2].startswith("skd_"):
        assert (SOURCE / words[2] / "launch" / words[3]).is_file()
        tables = (TaskOptions, CampaignOptions, EvaluatorOptions, SimulatorOptions)
        names = {one.name for table in tables for one in options_of(table) if words[3].split(".")[0] in one.launches}
        assert {argument.split(":=")[0] for argument in words[4:]} <= names | STEERING
    elif words[0] in ("scripts/skd", "scripts/assess-controller", "scripts/replay-logs") and words[1:] != ["--version"]:
        command = {"scripts/assess-controller": ["assess"], "scripts/replay-logs": ["replay"]}.get(words[0], [])
        options = words[1 : words.index("--")] if "--" in words else words[1:]
        make_parser().parse_args([*command, *(word for word in options if word != "--help")])
    for word in words:
        if re.match(r"(scripts|examples|docker|docs)/", word):
            assert (ROOT / word.partition(":")[0]).exists(), word


def check_parameters(node: str, words: list[str]) -> None:
    given = [words[index + 1].split(":=")[0] for index, word in enumerate(words) if word == "-p"]
    assert set(given) <= set(settings(node))
