"""Views, containers, scripts and the tutorial: valid, and naming only what exists."""

from __future__ import annotations

import importlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging_support import ROOT, SOURCE, check_command

SCRIPTS = ("run-node", "assess-controller", "replay-logs")
ERRORS = {"run-node": ["", "juggler", "--"], "assess-controller": ["", "--seed 3"], "replay-logs": [""]}


def topics() -> set[str]:
    support = importlib.import_module("skd_sim.ros.support")
    names = (
        *("EGO_ODOMETRY", "EGO_SCAN", "ROBOT_DESCRIPTION", "ADVERSARY_ODOMETRY"),
        *("COMMAND", "MARKERS", "ASSESSMENT", "CLEARANCE", "DEVIATION", "BELIEVED_CAR"),
    )
    return {f"/{getattr(support, name)}" for name in names}


def strings(content: Any) -> list[str]:
    if isinstance(content, dict):
        return [text for key, value in content.items() for text in (*strings(key), *strings(value))]
    if isinstance(content, list):
        return [text for value in content for text in strings(value)]
    return [content] if isinstance(content, str) else []


def test_rviz_view():
    view = yaml.safe_load((SOURCE / "skd_evaluator" / "rviz" / "skd.rviz").read_text(encoding="utf-8"))
    manager = view["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "map"
    assert manager["Views"]["Current"]["Class"] == "rviz_default_plugins/TopDownOrtho"
    shown = {}
    for display in manager["Displays"]:
        for topic in (display[key] for key in ("Topic", "Description Topic") if key in display):
            shown[topic["Value"]] = (display["Class"].partition("/")[2], topic["Durability Policy"])
    assert shown == {
        "/skd/markers": ("MarkerArray", "Transient Local"),
        "/robot_description": ("RobotModel", "Transient Local"),
        "/ego/scan": ("LaserScan", "Volatile"),
        "/ego/odometry": ("Odometry", "Volatile"),
        "/adversary/odometry": ("Odometry", "Volatile"),
    }
    assert set(shown) <= topics()
    assert "rviz_default_plugins/TF" in {display["Class"] for display in manager["Displays"]}


def test_foxglove_layout():
    layout = json.loads((SOURCE / "skd_evaluator" / "foxglove" / "skd.json").read_text(encoding="utf-8"))
    panels = layout["configById"]
    placed = [text for text in strings(layout["layout"]) if "!" in text]
    assert sorted(placed) == sorted(panels)
    absolute = re.compile(r"/((skd|ego|adversary)/|robot_description)")
    named = {text.split(".")[0] for text in strings(panels) if absolute.match(text)}
    assert named == topics()
    following = [panel["followTf"] for panel in panels.values() if panel.get("followMode") == "follow-pose"]
    assert following == ["base_link"]


DOCUMENTS = sorted(
    path
    for path in ROOT.rglob("*.md")
    if not {".venv", ".git", "build", "install", "node_modules"} & set(path.relative_to(ROOT).parts)
    and not any(part.startswith(".venv") for part in path.relative_to(ROOT).parts)
)


def anchors(text: str) -> set[str]:
    """The anchors that headings of a document make, as GitHub does."""
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    headings = re.findall(r"^#+ +(.*)$", prose, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_of_the_documents_lead_somewhere(document):
    text = document.read_text(encoding="utf-8")
    prose = re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)[^)]*\)", prose):
        if re.match(r"[a-z]+:", target):
            continue  # another site, which a test does not ask
        path, _, anchor = target.partition("#")
        there = (document.parent / path).resolve() if path else document
        assert there.exists(), f"{document.name}: {target}"
        assert there.is_relative_to(ROOT), f"{document.name}: {target}"
        if anchor:
            assert anchor in anchors(there.read_text(encoding="utf-8")), f"{document.name}: {target}"
    # What stands in backquotes and looks like a file of this project is one.
    for name in re.findall(r"`((?:docs|scripts|benchmarks|tests|examples|docker)/[\w./-]+)`", text):
        assert (ROOT / name).exists(), f"{document.name}: {name}"


# --- scripts


def run_script(name: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"SKD_ENV": str(Path(sys.executable).parent)}
    command = [str(ROOT / "scripts" / name), *arguments]
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=300)


needs_bash = pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")


@needs_bash
@pytest.mark.parametrize("name", SCRIPTS)
def test_help(name, tmp_path):
    done = run_script(name, "--help", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout.startswith(f"usage: scripts/{name} ")
    assert done.stderr == ""
    for line in done.stdout.splitlines():
        assert len(line) <= 120
        if line.startswith("    scripts/") and "your_package" not in line:
            check_command(line.split("#")[0].strip())


@needs_bash
@pytest.mark.parametrize(("name", "arguments"), [(name, text) for name, texts in ERRORS.items() for text in texts])
def test_errors_are_one_line(name, arguments, tmp_path):
    done = run_script(name, *arguments.split(), cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"{name}: error: ")


@needs_bash
def test_words_of_a_controller_command_survive(tmp_path):
    """Quoting: the command arrives as it was given, spaces and all."""
    script = tmp_path / "my controller.sh"
    said = tmp_path / "said"
    script.write_text(f'#!/bin/sh\nprintf "%s|" "$@" >"{said}"\nexit 2\n')
    script.chmod(0o755)
    few = ["--safe-count=1", "--kamikaze-count=1", "--collision-runs=1", "--simulations=1", "--adversary-model=generic"]
    done = run_script("assess-controller", *few, "--", str(script), "a b", "it's", cwd=tmp_path)
    assert done.returncode == 1
    assert said.read_text() == "a b|it's|"


@needs_bash
def test_a_node_of_yours_finds_ros_and_the_messages(tmp_path):
    """With no ROS 2 sourced, and by the name that its first line has; its exit code is that of the script."""
    (tmp_path / "my_node.py").write_text("import sys, rclpy, skd_msgs.msg\nprint(sys.argv[1:])\nsys.exit(3)\n")
    done = run_script("run-node", "--", "python3", "my_node.py", "--ros-args", "-p", "a:=b c", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (3, "['--ros-args', '-p', 'a:=b c']\n"), done.stderr
