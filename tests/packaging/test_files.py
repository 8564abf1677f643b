"""Files of the repository, launch files included."""

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from common import run_program
from packaging_support import NODES, ROOT, SOURCE, STEERING, settings
from skd_evaluator.ros.launch_support import _PACKAGES, arguments_of, text_of, values_and_nodes

DOCUMENTS = [ROOT / name for name in run_program("git", "ls-files", "*.md", cwd=ROOT).stdout.splitlines()]


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


def run_script(name: str, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return run_program(ROOT / "scripts" / name, *arguments, cwd=cwd, SKD_ENV=str(Path(sys.executable).parent))


needs_bash = pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")


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


OWN = {
    "episode": {"mode", "trial"},
    "assessment": {"safe_count", "kamikaze_count", "collision_runs", "maximum_distance"},
}


def nodes(task: str, **given: str) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes that a launch with these arguments starts, by name."""
    texts = {name: text_of(one.plain_default) for name, (one, _) in arguments_of(task).items()}
    assert set(given) <= set(texts)
    return values_and_nodes(task, texts | given)[1]


@pytest.mark.parametrize("task", OWN)
def test_arguments_set_parameters_that_exist(task):
    arguments = arguments_of(task)
    assert OWN[task] <= set(arguments)
    assert {name for name, (_, nodes) in arguments.items() if not nodes} == STEERING
    for name, (argument, names) in arguments.items():
        for node in names:
            setting = settings(node)[name]
            assert (argument.plain_default, argument.texts) == (setting.plain_default, setting.texts), name
            assert type(argument.plain_default) is type(setting.plain_default), name
            assert {type(choice) for choice in argument.texts} <= {str}, "shown as they are written"


@pytest.mark.parametrize("task", OWN)
def test_every_node_is_started_with_the_arguments(task):
    found = nodes(task, seed="7", pacing="real_time", record="false", multiplier="0.5")
    assert set(found) == set(NODES)
    for name, chosen in found.items():
        assert _PACKAGES[name] == NODES[name][0]
        assert set(chosen) <= set(settings(name))
    evaluator = found["evaluator"]
    assert [evaluator[name] for name in ("task", "seed", "record", "multiplier")] == [task, 7, False, 0.5]
    assert found["vehicle_simulator"]["pacing"] == "real_time"


@pytest.mark.parametrize("given", [{"use_builtin_controller": "false"}, {"controller": "external"}])
def test_external_controller_is_left_to_the_user(given):
    found = nodes("assessment", command_type="twist", **given)
    assert set(found) == set(NODES) - {"car_controller"}
    assert found["evaluator"]["controller"] == "external"
    assert found["evaluator"]["command_type"] == found["vehicle_simulator"]["command_type"] == "twist"


def test_a_wrong_argument_is_said():
    with pytest.raises(ValueError, match="launch argument seed must be a whole number, got 'seven'"):
        nodes("episode", seed="seven")


@pytest.mark.parametrize("task", OWN)
def test_each_task_has_a_launch_file(task):
    text = (SOURCE / "skd_evaluator" / "launch" / f"{task}.launch.py").read_text(encoding="utf-8")
    (call,) = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    assert ast.unparse(call) == f"graph_description('{task}')"
