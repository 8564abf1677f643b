"""Containers, scripts and the tutorial: valid, and naming only what exists."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from common import PATIENCE
from packaging_support import ROOT, check_command

SCRIPTS = ("run-node", "assess-controller", "replay-logs")
ERRORS = {"run-node": ["", "juggler", "--"], "assess-controller": ["", "--seed 3"], "replay-logs": [""]}


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
    return subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, timeout=PATIENCE)


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
