"""The scripts that a user calls first, in a copy of the repository's top."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from common import PATIENCE

ROOT = Path(__file__).resolve().parent.parent
pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    shutil.copytree(ROOT / "scripts", tmp_path / "scripts")
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def without_choice() -> dict[str, str]:
    """Return the environment's variables without those that choose an environment."""
    return {key: value for key, value in os.environ.items() if key not in ("ROS_DISTRO", "SKD_ENV", "SKD_PYTHON")}


def run(
    copy: Path, script: str, *arguments: object, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    # No script may reach the network from here, whatever goes wrong.
    variables = without_choice() | {"PIP_NO_INDEX": "1", "PIP_CONFIG_FILE": os.devnull} | environment
    words, said = [copy / "scripts" / script, *arguments], {"capture_output": True, "text": True}
    return subprocess.run(words, cwd=cwd or copy.parent, env=variables, timeout=PATIENCE, **said)


def program(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)


def make_environment(copy: Path, name: str) -> None:
    """Make what the first run leaves: an interpreter, and a stamp of the pyproject.toml it was made for."""
    program(copy / name / "bin" / "python", f'exec "{sys.executable}" "$@"')
    with (copy / "pyproject.toml").open() as file:
        stamp = subprocess.run(["cksum"], stdin=file, capture_output=True, text=True, check=True).stdout
    (copy / name / ".skd-run").write_text(stamp)


def test_skd_runs_where_the_environment_exists(copy):
    make_environment(copy, ".venv")
    before = sorted(path.name for path in copy.iterdir())
    done = run(copy, "skd", "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert "assess" in done.stdout
    assert run(copy, "skd", "assess", "--seed", "x").returncode == 2
    assert sorted(path.name for path in copy.iterdir()) == before


def test_ros_environment_is_made_with_the_python_that_ros_is_compiled_for(copy):
    calls = copy / "calls.txt"
    bin_folder = copy / "bin"
    for name in ("python3", "python3.12"):  # as where another Python comes before the system's
        program(bin_folder / name, f'echo "{name} $*" >>"{calls}"')
    path = f"{bin_folder}{os.pathsep}{os.environ['PATH']}"
    run(copy, "skd", PATH=path, ROS_DISTRO="jazzy", PYTHONPATH="/opt/ros/jazzy/lib/python3.12/site-packages")
    made = [call for call in calls.read_text().splitlines() if "-m venv" in call]
    assert made == [f"python3.12 -m venv {copy}/.venv-jazzy"]


@pytest.mark.parametrize("python", ["/nonexistent/python", "false"])
def test_unsuitable_python_is_refused(copy, python):
    done = run(copy, "skd", "--version", SKD_PYTHON=python)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == f"skd: no Python 3.11 to 3.13 found (looked for: {python}); set SKD_PYTHON to one\n"
    assert not (copy / ".venv").exists()


def test_a_scheduler_brings_dask_once(copy):
    make_environment(copy, ".venv")
    log = copy / "calls.txt"
    python = copy / "python3.12"
    program(python, f'echo "$@" >>"{log}"')
    command = ("assess", "--scheduler", "tcp://127.0.0.1:8786", "--help")
    for _ in range(2):
        done = run(copy, "skd", *command, SKD_PYTHON=str(python))
        assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    (call,) = [call for call in log.read_text().splitlines() if "-m pip" in call]
    assert f"-e {copy}[dask]" in call
    assert run(copy, "skd", "--version").stderr == ""


def test_a_class_in_the_working_folder_is_found_and_hides_no_module_of_skds(tmp_path: Path) -> None:
    """What names come first in a set is the same in each run: who goes by it is the same car."""
    for name in ("json", "yaml", "random"):
        (tmp_path / f"{name}.py").write_text("raise ImportError('of the working folder')\n")
    (tmp_path / "car.py").write_text(
        "import os\nclass Car:\n    def reset(self, scenario, rng): pass\n"
        "    def command(self, car, adversary): return 'hash seed ' + os.environ['PYTHONHASHSEED']\n"
    )
    words = ("--adversary-model", "generic", "--margin-limit", "0", "--behaviour", "none", "--safe-count", "1", "-q")
    words += ("--controller", "car:Car", "--out", tmp_path / "out")
    done = run(ROOT, "skd", "assess", *words, cwd=tmp_path, SKD_ENV=str(Path(sys.executable).parent))
    assert "(m/s²), or two with a steering angle (rad); got 'hash seed 0'" in done.stderr, done.stderr
    assert done.returncode == 1
