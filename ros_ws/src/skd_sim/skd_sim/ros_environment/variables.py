"""The variables that a process needs to load ROS 2's libraries from the wheels, and that no other program may inherit.

The wheels bring a `.pth` file that starts every Python of the environment a second time, with LD_LIBRARY_PATH set,
unless a guard says that this was done. A program of ours sets both itself, and only where it needs them.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from collections.abc import Mapping
from pathlib import Path

GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
"""Variable by which the wheels know that LD_LIBRARY_PATH is set."""

PREFIX = "SKD_MESSAGE_PREFIX"
"""Variable that says where a user's packages of messages are for this run."""
_PATH = "LD_LIBRARY_PATH"


def is_sourced(environment: Mapping[str, str] | None = None) -> bool:
    """Return whether a ROS 2 from elsewhere is in force, as after `. /opt/ros/jazzy/setup.bash`."""
    chosen = os.environ if environment is None else environment
    return bool(chosen.get("ROS_DISTRO") or chosen.get("AMENT_PREFIX_PATH"))


def library_folders() -> list[str]:
    """Return the folders of this environment in which the wheels' libraries lie; none where there are no wheels."""
    bundled = sorted(str(folder) for folder in Path(sysconfig.get_path("purelib")).glob("ros_*.libs"))
    return [str(Path(sys.prefix, "lib")), *bundled] if bundled else []


def node_variables(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment in which a Python of ours can import rclpy at once."""
    folders = [] if is_sourced(environment) else library_folders()
    if not folders:
        return dict(environment)
    others = [part for part in environment.get(_PATH, "").split(os.pathsep) if part and part not in folders]
    return {**environment, _PATH: os.pathsep.join([*folders, *others]), GUARD: "1"}


def foreign_variables(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment without what `node_variables` adds: for programs that are not ours."""
    folders = library_folders()
    clean = {name: value for name, value in environment.items() if name not in (GUARD, _PATH)}
    others = [part for part in environment.get(_PATH, "").split(os.pathsep) if part and part not in folders]
    return {**clean, _PATH: os.pathsep.join(others)} if others else clean


def message_variables(environment: Mapping[str, str], prefix: Path | None) -> dict[str, str]:
    """Return the environment in which a Python finds the messages in a prefix too, if there is one."""
    if prefix is None:
        return dict(environment)
    changed = {**environment, PREFIX: str(prefix)}
    modules = sysconfig.get_path("purelib", vars={"base": str(prefix)})
    for name, folder in (("PYTHONPATH", modules), ("LD_LIBRARY_PATH", str(prefix / "lib"))):
        parts = [part for part in environment.get(name, "").split(os.pathsep) if part]
        if folder not in parts:  # else they stay as they are, in whatever order: this program may have begun anew
            changed[name] = os.pathsep.join([folder, *parts])
    return changed


def enter_ros() -> None:
    """Begin this process anew where it could not load ROS 2's libraries: the loader reads its variables only then."""
    wanted = node_variables(os.environ)
    if wanted.get(_PATH) != os.environ.get(_PATH):
        sys.stdout.flush()
        sys.stderr.flush()
        os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], wanted)
