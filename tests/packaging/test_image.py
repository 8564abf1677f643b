"""The Docker image, made step by step: colcon builds and tests the workspace, and containers run what is installed.

Against the environment's own ROS 2, or against one that is sourced.
"""

from __future__ import annotations

import ast
import importlib.util
import json
import re
import shlex
import shutil
import signal
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml
from common import PATIENCE, new_domain
from image_support import BIN, DOCKERFILE, Image, build_image, context, image_folder, signal_group, value
from packaging_support import ALL_NODES, NODES, PYTHON_PACKAGES, ROOT, SOURCE, check_command
from skd_evaluator.bags.read import read_episodes
from skd_sim.ros_environment.installation import ensure_ros

SERVICES = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text(encoding="utf-8"))["services"]
LAUNCH = ("launch", "launch_ros", "ros2cli", "ros2launch", "ros2run")
NOT_FOUND = [name for name in LAUNCH if importlib.util.find_spec(name) is None]
needs_launch = pytest.mark.skipif(
    bool(NOT_FOUND), reason=f"not found: {', '.join(NOT_FOUND)}; they come with a ROS 2 that is sourced"
)
needs_compiler = pytest.mark.skipif(
    not (shutil.which("bash") and shutil.which("c++") and shutil.which("git")), reason="needs bash, git and c++"
)
HIDER = """
import os, sys

class Hiding:
    def __init__(self, finder):
        self._finder = finder

    def find_spec(self, name, *rest):
        return None if name in os.environ["HIDDEN_MODULES"].split() else self._finder.find_spec(name, *rest)

    def __getattr__(self, name):
        return getattr(self._finder, name)

sys.meta_path[:] = map(Hiding, sys.meta_path)
"""


@pytest.fixture(scope="session")
def image(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Image]:
    """The image, built once."""
    ensure_ros()
    with image_folder(tmp_path_factory.mktemp("image")) as folder:
        yield build_image(folder)


@pytest.fixture(scope="session")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A safe trajectory that needs no planner: straight across."""
    folder = tmp_path_factory.mktemp("safe")
    rows = [f"{0.3 * tick!r},{-3.5 + 0.75 * tick!r},0.0" for tick in range(9)]
    (folder / "across.csv").write_text("t,x,y\n" + "\n".join(rows) + "\n")
    return folder


def settings(straight: Path, out: Path) -> dict[str, object]:
    """The same for the evaluator, as parameters or launch arguments."""
    return {"safe": straight, "multiplier": 0.5, "seed": 3, "simulations": 300, "out": out}


def command(service: str, image: Image) -> list[object]:
    """Return the command of one of compose's services, with defaults of variables; without ros2cli, its executable."""
    words: list[object] = list(shlex.split(re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", SERVICES[service]["command"])))
    if words[:2] == ["ros2", "run"] and NOT_FOUND:
        return [image.executable(str(words[2]), str(words[3])), *words[4:]]
    return words


def test_compose_has_one_service_a_node():
    nodes = {name for name, service in SERVICES.items() if service["command"].startswith("ros2 run skd_")}
    assert nodes == set(NODES)
    assert set(SERVICES) - nodes == {"external_controller"}
    for name, service in SERVICES.items():
        assert service["image"] == "skd"
        check_command(re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", service["command"]))
        if name in nodes:
            assert service["command"].split(" --ros-args")[0].split()[-1] == name
    assert SERVICES["vehicle_simulator"]["build"] == {"context": "..", "dockerfile": "docker/Dockerfile"}


def test_what_takes_long_does_not_depend_on_what_changes_often():
    steps = [f"{word} {rest}" for word, rest in DOCKERFILE]
    everything = next(number for number, step in enumerate(steps) if step.endswith(" . ."))
    assert any("skd_environment" in step for step in steps[:everything])
    assert any("colcon build" in step for step in steps[:everything])
    assert not [name for name in context() if name.startswith((".venv", "tests/", "docs/"))]
    assert [rest for word, rest in DOCKERFILE if word == "USER"] == ["skd"]


@needs_compiler
def test_everything_is_installed(image):
    for package in PYTHON_PACKAGES:
        names = {name for name, (where, _) in ALL_NODES.items() if where == package}
        names |= {"skd"} if package == "skd_evaluator" else set()
        assert {path.name for path in image.executable(package, "any").parent.iterdir()} == names
    found = image.run("python3", "-c", "import skd_sim, skd_adversary, skd_evaluator, skd_msgs as m; print(m, skd_sim)")
    assert found.stdout.count(str(image.workspace / "install")) == 2, "and not what the environment has of them"
    assert set(map(str, (image.folder / ".venv-jazzy").rglob("skd_evaluator"))) == set()


@needs_compiler
def test_colcon_test(image):
    """In one process a package, which has the environment of the tests: the image has no pytest."""
    done = image.run(
        sys.executable, BIN / "colcon", "test", "--return-code-on-test-failure", "--event-handlers", "console_direct+",
        "--base-paths", "ros_ws/src", "--build-base", "ros_ws/build", "--install-base", "ros_ws/install",
        PYTHONDONTWRITEBYTECODE="1", SKD_TEST_DOMAIN=str(new_domain()),
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-6000:]
    for package in PYTHON_PACKAGES:
        (suite,) = ElementTree.parse(image.workspace / "build" / package / "pytest.xml").findall("testsuite")
        assert int(suite.attrib["tests"]) == len(suite.findall("testcase")) > 0
        assert [suite.attrib[name] for name in ("errors", "failures", "skipped")] == ["0", "0", "0"]


@needs_compiler
def test_a_node_of_others_runs_in_a_container_of_its_own(image, straight, tmp_path):
    """By the commands that compose gives the containers, and by the environment's ROS 2 for the node of others."""
    domain = {"ROS_DOMAIN_ID": str(new_domain())}
    with ExitStack() as ending:
        for name in ("vehicle_simulator", "adversary", "external_controller"):
            process = image.start(*command(name, image), **domain)
            ending.callback(process.communicate)
            ending.callback(signal_group, process, signal.SIGKILL)
        given = {**settings(straight, tmp_path / "out"), "task": "episode", "controller": "external"}
        words = [word for name, text in given.items() for word in ("-p", f"{name}:={text}")]
        done = image.run(*command("evaluator", image), *words, "-p", "adversary_model:=generic", **domain)
    assert done.returncode == 0, done.stdout
    (recorded,) = read_episodes([tmp_path / "out" / "bags"])
    assert recorded.log.outcome.name.lower() == json.loads((tmp_path / "out" / "episode.json").read_text())["outcome"]


@needs_compiler
def test_a_container_is_healthy(image):
    healthy = image.run(*value("HEALTHCHECK")[1:])
    assert healthy.returncode == 0, healthy.stdout
    assert "round trip: a message between two nodes came" in healthy.stdout


# --- where something is missing


@needs_compiler
@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("numba", r"skd needs numba, which .*: cd \S+ && scripts/skd --version && \. \.venv\S*/bin/activate"),
        ("rclpy", r"skd needs rclpy of ROS 2, which .* or use scripts/run-node, which brings its own"),
        ("skd_msgs", r"skd needs skd_msgs of ROS 2, which .* or use scripts/run-node, which brings its own"),
    ],
)  # fmt: skip
def test_what_is_missing_is_one_line(image, module, line, tmp_path):
    (tmp_path / "sitecustomize.py").write_text(HIDER)
    script = f'export PYTHONPATH={tmp_path}:"$PYTHONPATH"; exec {image.executable("skd_sim", "vehicle_simulator")}'
    done = image.run("bash", "-c", script, HIDDEN_MODULES=module)
    assert done.returncode == 2
    assert re.fullmatch(rf"skd: error: {line}\n", done.stdout)


# --- launch and ros2cli


@needs_launch
@needs_compiler
@pytest.mark.parametrize("task", ["episode", "assessment"])
def test_arguments_of_launch_files_are_shown(image, task):
    done = image.run("ros2", "launch", "skd_evaluator", f"{task}.launch.py", "--show-args")
    assert done.returncode == 0, done.stdout
    assert re.search(r"'objective':\s+.*'paper', 'frechet'", done.stdout)
    assert not re.search(r"<\w+\.\w+: ", done.stdout), "choices are shown as they are written"


@needs_launch
@needs_compiler
def test_launch_runs_an_episode(image, straight, tmp_path):
    given = {"startup_timeout": PATIENCE, **settings(straight, tmp_path / "out")}
    arguments = [f"{name}:={text}" for name, text in given.items()]
    done = image.run("ros2", "launch", "skd_evaluator", "episode.launch.py", *arguments)
    assert done.returncode == 0, done.stdout
    assert (tmp_path / "out" / "episode.json").is_file()


EXAMPLE = ROOT / "examples" / "launch_test" / "test_safety.py"


@needs_launch
@needs_compiler
def test_the_example_of_a_launch_test_passes(image):
    done = image.run("python3", "-m", "launch_testing.launch_test", EXAMPLE)
    assert done.returncode == 0, done.stdout


def test_the_example_of_a_launch_test_uses_what_there_is():
    """By its syntax: here there may be no `launch`."""
    module = SOURCE / "skd_evaluator" / "skd_evaluator" / "ros" / "launch_testing.py"
    defined = {one.name for one in ast.parse(module.read_text()).body if isinstance(one, ast.FunctionDef)}
    (ours,) = [
        node for node in ast.walk(ast.parse(EXAMPLE.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module == "skd_evaluator.ros.launch_testing"
    ]  # fmt: skip
    assert {name.name for name in ours.names} == defined
