"""Where programs begin: with no import that takes time, so that an interrupt of the others ends them quietly.

`python -m skd_sim.start NAME` is the program of that name. A workspace built by colcon may lack packages that SKD needs
beside ROS 2.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import re
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import ModuleType

from skd_sim.errors import UsageError
from skd_sim.interruption import END_LIMIT, Interruption, end_within


def start(module: str, interrupted: int = 0, cleaning: float = 0.0) -> int:
    """Import a module, run its `main`, and return the process's exit code.

    A package that is missing or too old is one line, and exit code 2.

    Args:
        module: name of the module, whose `main` takes its arguments from the command line.
        interrupted: exit code when a signal comes before `main` answers to it; a node that ends then has not failed.
        cleaning: s after a signal in which another one does nothing, see `Interruption`.
    """
    _open_closed()
    with contextlib.suppress(OSError):  # the working folder is gone
        sys.path.append(str(Path.cwd()))  # where a user's class may be; behind all else, lest it hide a module
    interruption = Interruption(cleaning)
    interruption.listen()
    code = interrupted
    try:
        main = import_lasting(module).main
        if not interruption.came:
            code = int(main())
    except KeyboardInterrupt:
        pass
    except Exception as error:
        if not interruption.came:  # else an import failed because of it
            line = _remedy(error)
            if line is None:
                _bound_the_end(1)
                raise
            print(f"skd: error: {line}", file=sys.stderr)
            code = 2
    interruption.leave(code)
    _bound_the_end(code)
    return code


def import_lasting(name: str) -> ModuleType:
    """Import a module and return it; where it is new, nothing that is there by then is looked through for garbage.

    Python would do so again and again while modules are imported: a sixth of the start of a node. A process that is
    forked later copies less memory, as well.
    """
    if name in sys.modules or not gc.isenabled():
        return importlib.import_module(name)
    gc.disable()
    try:
        return importlib.import_module(name)
    finally:
        gc.freeze()
        gc.enable()


def _open_closed() -> None:
    """Have each standard stream that is closed, as by `2>&-`, lead nowhere, or the next file would get its number."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:  # Python's own sign of a closed one
            stream = open(number, "w" if number else "r", encoding="utf-8", errors="replace", closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)


def _bound_the_end(code: int) -> None:
    """Limit the time of Python's own end, which takes down what is left of the middleware and may hang there."""
    if "rclpy" in sys.modules:
        end_within(END_LIMIT, code)


def _remedy(error: Exception) -> str | None:
    """Return what to do about a package that is missing or too old; none where the error is another."""
    if isinstance(error, UsageError):
        return str(error)
    if not isinstance(error, ModuleNotFoundError) or error.name is None:
        return None
    name = error.name.partition(".")[0]
    if name in PACKAGES:
        return f"skd needs {name}, which {sys.executable} does not have: {environment([name])}"
    if name == "rclpy" or name.endswith(("_msgs", "_interfaces")):
        return (
            f"skd needs {name} of ROS 2, which {sys.executable} does not find: source ROS 2 Jazzy and "
            "ros_ws/install/setup.bash, or use scripts/run-node, which brings its own"
        )
    return None


PACKAGES = (
    "altair", "jinja2", "matplotlib", "mcap", "numba", "numpy", "pydantic", "rich", "rosbags", "scipy",
    "vl_convert", "yaml",
)  # fmt: skip
"""Modules of the packages that SKD needs beside ROS 2."""


def environment(missing: Sequence[str]) -> str:
    """Return the commands that install packages: as the project's environment, where SKD is in a checkout."""
    above = (folder for folder in Path(__file__).resolve().parents if (folder / "scripts" / "skd").is_file())
    checkout = next((shlex.quote(str(folder)) for folder in above), "")
    if not checkout:
        names = (name.replace("vl_convert", "vl-convert-python").replace("yaml", "PyYAML") for name in missing)
        return f"{shlex.quote(sys.executable)} -m pip install {' '.join(names)}"
    folder = f".venv-{os.environ['ROS_DISTRO']}" if os.environ.get("ROS_DISTRO") else ".venv"
    return f"cd {checkout} && scripts/skd --version && . {folder}/bin/activate"


def installing(extra: str) -> str:
    """Return the command that installs what an extra of SKD asks for, by the names of the packages themselves."""
    from importlib.metadata import PackageNotFoundError, requires

    with contextlib.suppress(PackageNotFoundError):
        asked = [text.partition(";") for text in requires("skd") or ()]
        found = [shlex.quote(name.strip()) for name, _, when in asked if re.search(rf"extra == .{extra}\b", when)]
        return f"{shlex.quote(sys.executable)} -m pip install {' '.join(found)}"
    return f"install what pyproject.toml lists for {extra}"  # of a workspace alone


def start_named(programs: Mapping[str, Callable[[], int]]) -> int:
    """Run the program that the first argument of the command line names."""
    return programs[sys.argv.pop(1)]()


vehicle_simulator = partial(start, "skd_sim.ros.simulator_node")
car_controller = partial(start, "skd_sim.ros.controller_node")
carla_bridge = partial(start, "skd_sim.ros.carla_bridge")
adversary = partial(start, "skd_adversary.ros.adversary_node")

if __name__ == "__main__":
    sys.exit(start_named(globals()))
