"""ros_ws as users of ROS 2 have it: colcon builds and tests it, and what is installed runs.

Against the environment's own ROS 2, or against one that is sourced.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import re
import shutil
import signal
import subprocess
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest
from colcon_support import Workspace, make_workspace, signal_group, workspace_folder
from common import PATIENCE, new_domain
from packaging_support import ALL_NODES, NODES, PYTHON_PACKAGES, SOURCE
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories, single_episode
from skd_evaluator.bags.read import read_episodes
from skd_sim.ros_environment import ensure_ros
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeLog, Mode

LAUNCH = ("launch", "launch_ros", "ros2cli", "ros2launch", "ros2run")
NOT_FOUND = [name for name in LAUNCH if importlib.util.find_spec(name) is None]
needs_launch = pytest.mark.skipif(
    bool(NOT_FOUND), reason=f"not found: {', '.join(NOT_FOUND)}; they come with a ROS 2 that is sourced"
)
pytestmark = [
    pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash"),
    pytest.mark.skipif(shutil.which("c++") is None, reason="colcon builds with the machine's compiler: c++ is missing"),
]


@pytest.fixture(scope="session")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workspace]:
    """The workspace, built once."""
    ensure_ros()
    with workspace_folder(tmp_path_factory.mktemp("workspace")) as folder:
        yield make_workspace(folder)


@pytest.fixture(scope="session")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A safe trajectory that needs no planner: straight across."""
    folder = tmp_path_factory.mktemp("safe")
    rows = [f"{0.3 * tick!r},{-3.5 + 0.75 * tick!r},0.0" for tick in range(9)]
    (folder / "across.csv").write_text("t,x,y\n" + "\n".join(rows) + "\n")
    return folder


@pytest.fixture(scope="session")
def expected(straight: Path) -> EpisodeLog:
    """A kamikaze episode, in process."""
    plan = Plan(load_scenario("crossing"), safe=str(straight), safe_count=1, multiplier=0.5, seed=3, simulations=300)
    return run_episode(single_episode(plan, Mode.KAMIKAZE, 0, safe_trajectories(plan, InProcessRunner(1))[0]))


def settings(straight: Path, out: Path) -> dict[str, object]:
    """The same for the evaluator, as parameters or launch arguments."""
    return {"safe": straight, "multiplier": 0.5, "seed": 3, "simulations": 300, "out": out}


def assert_episode(out: Path, expected: EpisodeLog) -> None:
    """The results are those of the plain loop, to the last bit."""
    assert json.loads((out / "episode.json").read_text())["outcome"] == expected.outcome.name.lower()
    (recorded,) = read_episodes([out / "bags"])
    for name in ("adversary", "car"):
        assert getattr(recorded.log, name).tobytes() == getattr(expected, name).tobytes(), name
    assert (recorded.log.impact_time, recorded.log.impact_speed) == (expected.impact_time, expected.impact_speed)


@contextlib.contextmanager
def running(*processes: subprocess.Popen[str]) -> Iterator[None]:
    """Whatever happens, none of the processes is left, nor what it has started."""
    try:
        yield
    finally:
        for process in processes:
            signal_group(process, signal.SIGKILL)
            process.communicate()


def files(folder: Path) -> set[Path]:
    return {path.relative_to(folder) for path in folder.rglob("*") if "__pycache__" not in path.parts}


def test_sources_stay_as_they_are(workspace):
    assert files(workspace.folder / "src") == files(SOURCE)


def test_everything_is_installed(workspace):
    for package in PYTHON_PACKAGES:
        names = {name for name, (where, _) in ALL_NODES.items() if where == package}
        names |= {"skd"} if package == "skd_evaluator" else set()
        assert {path.name for path in workspace.executable(package, "any").parent.iterdir()} == names
    found = workspace.run(
        "python3", "-c", "import skd_sim, skd_adversary, skd_evaluator, skd_msgs as m; print(m, skd_sim)"
    )
    assert found.stdout.count(str(workspace.folder / "install")) == 2, "and not what the environment has of them"


def test_colcon_test(workspace):
    done = workspace.test()
    assert done.returncode == 0, done.stdout[-6000:]
    result = workspace.test_result()
    assert result.returncode == 0, result.stdout
    for package in PYTHON_PACKAGES:
        (suite,) = ElementTree.parse(workspace.folder / "build" / package / "pytest.xml").findall("testsuite")
        assert int(suite.attrib["tests"]) == len(suite.findall("testcase")) > 0
        assert {name: suite.attrib[name] for name in ("errors", "failures", "skipped")} == dict.fromkeys(
            ("errors", "failures", "skipped"), "0"
        )


def episode_by(commands: dict[str, list[object]], workspace: Workspace, straight: Path, out: Path) -> None:
    """Run one episode by commands that start the four nodes; all end as they should."""
    domain = {"ROS_DOMAIN_ID": str(new_domain())}
    parameters = [f"{name}:={value}" for name, value in {"task": "episode", **settings(straight, out)}.items()]
    given = ["--ros-args", *(word for parameter in parameters for word in ("-p", parameter))]
    patience = ["--ros-args", "-p", f"startup_timeout:={PATIENCE}"]  # the first start from a new folder compiles
    more = {"vehicle_simulator": patience, "adversary": [], "car_controller": []}
    others = [workspace.start(*commands[name], *options, **domain) for name, options in more.items()]
    with running(*others):
        done = workspace.run(*commands["evaluator"], *given, **domain)
        assert done.returncode == 0, done.stdout
        for other in others:
            signal_group(other, signal.SIGINT)
        assert [other.wait(PATIENCE) for other in others] == [0, 0, 0]


def test_installed_executables_run_an_episode(workspace, straight, expected, tmp_path):
    commands: dict[str, list[object]] = {name: [workspace.executable(NODES[name][0], name)] for name in NODES}
    episode_by(commands, workspace, straight, tmp_path / "out")
    assert_episode(tmp_path / "out", expected)


# --- where something is missing


def remedy(*names: str) -> str:
    """What is said about missing packages, as a regular expression."""
    do = r"cd \S+ && scripts/skd --version && \. \.venv\S*/bin/activate"
    return rf"skd needs {' and '.join(names)}, which \S+ does not have: {do}"


@pytest.mark.parametrize("node", ["car_controller", "evaluator"])
def test_missing_package_is_one_line(workspace, node):
    done = workspace.run(workspace.executable(NODES[node][0], node), **workspace.without("numba"))
    assert done.returncode == 2
    assert re.fullmatch(rf"skd: error: {remedy('numba')}\n", done.stdout)


@pytest.mark.parametrize("module", ["rclpy", "skd_msgs"])
def test_missing_ros_is_one_line(workspace, module):
    done = workspace.run(workspace.executable("skd_sim", "vehicle_simulator"), **workspace.without(module))
    assert done.returncode == 2
    (line,) = done.stdout.splitlines()
    assert line.startswith(f"skd: error: skd needs {module} of ROS 2, which ")
    assert line.endswith("or use scripts/run-node, which brings its own")


# --- launch and ros2cli


@needs_launch
@pytest.mark.parametrize("task", ["episode", "assessment"])
def test_arguments_of_launch_files_are_shown(workspace, task):
    done = workspace.run("ros2", "launch", "skd_evaluator", f"{task}.launch.py", "--show-args")
    assert done.returncode == 0, done.stdout
    assert re.search(r"'objective':\s+.*'paper', 'frechet'", done.stdout)
    assert not re.search(r"<\w+\.\w+: ", done.stdout), "choices are shown as they are written"


@needs_launch
def test_launch_runs_an_episode(workspace, straight, expected, tmp_path):
    given = {"startup_timeout": PATIENCE, **settings(straight, tmp_path / "out")}
    arguments = [f"{name}:={value}" for name, value in given.items()]
    done = workspace.run("ros2", "launch", "skd_evaluator", "episode.launch.py", *arguments)
    assert done.returncode == 0, done.stdout
    assert_episode(tmp_path / "out", expected)
