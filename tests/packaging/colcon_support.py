"""A workspace that colcon builds from ros_ws, as a user's: where, with which variables, and what runs in it."""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from common import PATIENCE, new_domain
from packaging_support import SOURCE
from skd_sim.ros_environment import is_sourced, node_variables
from skd_sim.ros_environment.installation import cmake_prefix, environment_digest, locked

ENVIRONMENT = Path(sys.executable).parent
"""The environment's bin folder."""
_BUILT = "messages-are-built"

_HIDER = """
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


def signal_group(process: subprocess.Popen[str], number: int) -> None:
    """Signal a process and what it has started, as Ctrl-C in a terminal does; nothing where all of it has ended."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, number)


@dataclass(frozen=True)
class Workspace:
    """A built workspace.

    Attributes:
        folder: that holds src, build, install and log.
        build_variables: with which colcon builds.
        variables: with which users run what is installed: ROS 2, the environment and the workspace are in force.
    """

    folder: Path
    build_variables: Mapping[str, str]
    variables: Mapping[str, str]

    def executable(self, package: str, name: str) -> Path:
        """Return an installed executable."""
        return self.folder / "install" / package / "lib" / package / name

    def start(self, *command: object, **variables: str) -> subprocess.Popen[str]:
        """Start a command with the workspace in force."""
        return subprocess.Popen(
            list(map(str, command)),
            cwd=self.folder,
            env={**self.variables, **variables},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def run(self, *command: object, **variables: str) -> subprocess.CompletedProcess[str]:
        """Run a command to its end with the workspace in force."""
        with self.start(*command, **variables) as process:
            try:
                output, _ = process.communicate(timeout=PATIENCE)
            finally:
                signal_group(process, signal.SIGKILL)
        lines = [line for line in output.splitlines(keepends=True) if "RTPS_TRANSPORT_SHM" not in line]  # not our words
        return subprocess.CompletedProcess(process.args, process.returncode, "".join(lines))

    def test(self, folder: str = "src", **variables: str) -> subprocess.CompletedProcess[str]:
        """Run `colcon test` for the packages in a folder."""
        shown = ("--executor", "sequential", "--event-handlers", "console_direct+", "--return-code-on-test-failure")
        places = ("--build-base", "build", "--install-base", "install", "--base-paths", folder)
        colcon = (sys.executable, ENVIRONMENT / "colcon", "--log-base", "log", "test")
        domain = str(new_domain())
        return self.run(*colcon, *places, *shown, PYTHONDONTWRITEBYTECODE="1", SKD_TEST_DOMAIN=domain, **variables)

    def test_result(self) -> subprocess.CompletedProcess[str]:
        """Run `colcon test-result`."""
        return self.run(
            ENVIRONMENT / "colcon", "--log-base", "log", "test-result", "--test-result-base", "build", "--all"
        )

    def without(self, *modules: str) -> dict[str, str]:
        """Return variables with which no Python finds some modules: as in a shell without the environment."""
        hider = Path(tempfile.mkdtemp(dir=self.folder, prefix="hider."))
        (hider / "sitecustomize.py").write_text(_HIDER)
        path = os.pathsep.join([str(hider), self.variables["PYTHONPATH"]])
        return {"PYTHONPATH": path, "HIDDEN_MODULES": " ".join(modules)}


@contextlib.contextmanager
def workspace_folder(empty: Path) -> Iterator[Path]:
    """Yield where to build: a folder of the environment in which a messages' package may be that was built before.

    It is named for all that decides how the messages are built. Where a ROS 2 is sourced, `empty` takes its place.
    """
    if is_sourced():
        yield empty
        return
    folder = Path(sys.prefix, "workspace", environment_digest()[:16])
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder / ".lock", "testing a workspace"):
        kept = {_BUILT, "build", "install"} if (folder / _BUILT).exists() else set()
        others = [entry for entry in folder.iterdir() if entry.name not in {".lock", *kept}]
        for entry in (*others, *folder.glob("build/skd_[!m]*"), *folder.glob("install/skd_[!m]*")):
            shutil.rmtree(entry)
        yield folder


def make_workspace(folder: Path) -> Workspace:
    """Build a copy of ros_ws from scratch, but for messages that are there, with their own CMakeLists.txt."""
    shutil.copytree(SOURCE, folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
    variables = _base_variables(folder)
    arguments = ["--build-base", "build", "--install-base", "install", "--base-paths", "src"]
    arguments += ["--executor", "sequential", "--event-handlers", "console_direct+"]
    if (folder / _BUILT).exists() and find_spec("colcon_package_selection"):  # else they are built once more
        arguments += ["--packages-skip", "skd_msgs"]
    arguments += ["--cmake-args", "-DBUILD_TESTING=OFF"]  # the last: what follows goes to CMake
    if not is_sourced():
        arguments += ["-G", "Ninja", f"-DPython3_EXECUTABLE={sys.executable}"]
    done = subprocess.run(
        [ENVIRONMENT / "colcon", "--log-base", "log", "build", *arguments],
        cwd=folder,
        env=variables,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=2 * PATIENCE,
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    (folder / _BUILT).mkdir(exist_ok=True)
    return Workspace(folder, variables, _sourced(folder, variables))


def _base_variables(folder: Path) -> dict[str, str]:
    """Return a shell's variables in which ROS 2 is in force, and no workspace of SKD's."""
    ours = {key: value for key, value in os.environ.items() if not key.startswith(("SKD_", "COLCON_"))}
    if "SKD_CACHE_DIR" in os.environ:
        ours["SKD_CACHE_DIR"] = os.environ["SKD_CACHE_DIR"]
    ours |= {"ROS_DOMAIN_ID": str(new_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    if is_sourced():
        # CMake takes the first Python of the PATH, and that has to be the one that ROS 2 is made for.
        others = [part for part in ours["PATH"].split(os.pathsep) if Path(part) != ENVIRONMENT]
        return {**ours, "PATH": os.pathsep.join(others)}
    prefix = folder / "prefix"
    prefix.mkdir()
    cmake_prefix(prefix)
    places = {"AMENT_PREFIX_PATH": str(prefix), "CMAKE_PREFIX_PATH": str(prefix)}
    return {**node_variables(ours), **places, "PATH": os.pathsep.join([str(ENVIRONMENT), ours.get("PATH", os.defpath)])}


def _sourced(folder: Path, variables: Mapping[str, str]) -> dict[str, str]:
    """Return the variables after `. install/setup.bash`, with the environment first on the PATH."""
    script = f". {shlex.quote(str(folder / 'install' / 'setup.bash'))} && env -0"
    bash = shutil.which("bash")
    assert bash is not None
    done = subprocess.run([bash, "-c", script], env=variables, capture_output=True, text=True, check=True)
    after = dict(line.split("=", 1) for line in done.stdout.split("\0") if "=" in line)
    return {**after, "PATH": os.pathsep.join([str(ENVIRONMENT), after["PATH"]])}
