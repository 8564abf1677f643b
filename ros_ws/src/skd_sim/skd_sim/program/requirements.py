"""What SKD needs and a workspace built by colcon may lack: one line says what to do.

`python3 -m skd_sim.program.requirements` says it of that Python. Imports nothing of what may be missing.
"""

from __future__ import annotations

import importlib.util
import os
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

PACKAGES = (
    "PIL", "altair", "jinja2", "matplotlib", "mcap", "numba", "numpy", "pydantic", "rich", "rosbags", "scipy",
    "vl_convert", "yaml",
)  # fmt: skip
"""Modules of the packages that SKD needs beside ROS 2."""

EXIT_USAGE = 2


def remedy(modules: Sequence[str]) -> str | None:
    """Return what to do about modules that this Python lacks; None if SKD does not need them."""
    names = sorted({module.partition(".")[0] for module in modules})
    ours = [name for name in names if name in PACKAGES]
    if ours:
        return f"skd needs {_listed(ours)}, which {sys.executable} does not have: {environment()}"
    ros = [name for name in names if name == "rclpy" or name.endswith(("_msgs", "_interfaces"))]
    if ros:
        return (
            f"skd needs {_listed(ros)} of ROS 2, which {sys.executable} does not find: source ROS 2 Jazzy and "
            "ros_ws/install/setup.bash, or use scripts/run-node, which brings its own"
        )
    return None


def environment() -> str:
    """Return the commands that make the project's environment and activate it."""
    folder = f".venv-{os.environ['ROS_DISTRO']}" if os.environ.get("ROS_DISTRO") else ".venv"
    return f"cd {_checkout()} && scripts/skd --version && . {folder}/bin/activate"


def remedy_for_executables() -> str | None:
    """Return what to do so that the installed executables can run; None if they can.

    They run on the `python3` of the PATH, which need not be the Python of this process.
    """
    done = subprocess.run(
        ["/usr/bin/env", "python3", "-m", "skd_sim.program.requirements"], capture_output=True, text=True, check=False
    )
    return done.stderr.strip() if done.returncode == EXIT_USAGE else None


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _checkout() -> str:
    """Return the folder of scripts/, in or above which the workspace lies, as a word of a shell."""
    above = (folder for folder in Path(__file__).resolve().parents if (folder / "scripts" / "skd").is_file())
    return next((shlex.quote(str(folder)) for folder in above), "CHECKOUT_OF_SKD")


def main() -> int:
    """Return 0 where nothing is missing; else say in one line what to do, and return 2."""
    line = remedy([name for name in PACKAGES if importlib.util.find_spec(name) is None])
    if line is None:
        return 0
    print(line, file=sys.stderr)
    return EXIT_USAGE


if __name__ == "__main__":
    sys.exit(main())
