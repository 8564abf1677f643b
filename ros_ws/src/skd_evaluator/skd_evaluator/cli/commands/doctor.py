"""`skd doctor`: what is installed, what is missing and for what, and whether a message comes through."""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as version_of
from typing import Any

from skd_sim.ros_environment.installation import is_ready, is_sourced, node_variables
from skd_sim.start import PACKAGES, environment, installing

from skd_evaluator.cli.arguments import Parser
from skd_evaluator.cli.output import print_json, say
from skd_evaluator.version import version

FINE, ABSENT, BROKEN = "fine", "absent", "broken"
_DISTRIBUTIONS = {"yaml": "pyyaml", "vl_convert": "vl-convert-python"}
_TOOLS = {
    "git": "the commit of a car's code in results",
    "ffmpeg": "films as mp4 (skd report --format mp4)",
}
_EXTRAS = {
    "dask": ("dask", "runs on a cluster (--scheduler)"),
    "notebook": ("xarray", "tables and arrays of results in a notebook"),
    "exchange": ("osi_utilities", "ASAM OSI (skd export --format osi, skd import)"),
}
_PATIENCE = 60.0  # s


@dataclass(frozen=True)
class Finding:
    """Something that was looked at.

    Attributes:
        name: what.
        state: FINE; ABSENT: something optional is not there; BROKEN: what SKD needs is not there, or does not work.
        text: what was found.
        remedy: what to do about it; empty where nothing has to be done.
    """

    name: str
    state: str
    text: str
    remedy: str = ""


def add(parser: Parser) -> None:
    """Say what is installed, what is missing, and for what.

    Say what is installed, what is missing and what to do about it. Send a message between two ROS 2 nodes. The exit
    code is 1 where something does not work.
    """
    parser.set_defaults(group="look")
    parser.add_flag("--no-round-trip", "start no nodes: look at files alone")
    parser.add_flag("--json", "print JSON instead of lines")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code: 1 where something that SKD needs is missing or does not work."""
    found = []
    for finding in findings(round_trip=arguments.round_trip):
        found.append(finding)
        if not arguments.json:
            sign = {FINE: "ok", ABSENT: "--", BROKEN: "!!"}[finding.state]
            remedy = f": {finding.remedy}" if finding.remedy else ""
            print(f"{sign} {finding.name}: {finding.text}{remedy}", flush=True)
    broken = [one.name for one in found if one.state == BROKEN]
    if arguments.json:
        print_json({"findings": [asdict(one) for one in found], "fine": not broken})
    elif broken:
        say("doctor", f"{', '.join(broken)}: see above")
    else:
        print("All that SKD needs is there. Lines with -- are optional.")
    return 1 if broken else 0


def findings(*, round_trip: bool = True) -> Iterator[Finding]:
    """Yield what is found, one thing after another; with `round_trip` nodes of ROS 2 are started."""
    from skd_sim.kernels.compilation import cache_folder

    yield Finding("skd", FINE, f"{version()}, Python {platform.python_version()} in {sys.prefix}")
    if missing := [name for name in PACKAGES if importlib.util.find_spec(name) is None]:
        yield Finding("packages", BROKEN, f"{', '.join(missing)} cannot be imported", environment(missing))
    else:
        yield Finding("packages", FINE, ", ".join(f"{name} {_version(name)}" for name in PACKAGES))
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    yield Finding("processors", FINE, f"{cores}, which --workers uses by default")
    folder = cache_folder()
    count = len(list(folder.glob("*.kernel")))
    compiled = f"{count} compiled ones are kept in {folder}" if count else "the next run compiles them, for a minute"
    yield Finding("kernels", FINE, compiled)
    for name, use in _TOOLS.items():
        where = shutil.which(name)
        yield Finding(name, FINE, str(where)) if where else Finding(name, ABSENT, f"not installed; for {use}")
    for extra, (module, use) in _EXTRAS.items():
        if importlib.util.find_spec(module) is not None:
            yield Finding(module, FINE, f"installed; {use}")
        else:
            yield Finding(module, ABSENT, f"not installed; for {use}", installing(extra))
    yield from _ros(round_trip=round_trip)


def _version(module: str) -> str:
    try:
        return version_of(_DISTRIBUTIONS.get(module, module))
    except PackageNotFoundError:
        return "?"


def _ros(*, round_trip: bool, ask: Callable[[], dict[str, Any]] | None = None) -> Iterator[Finding]:
    """Yield what there is of ROS 2, for the node graph; nothing is installed here."""
    sourced = is_sourced()
    if not is_ready():
        text = "not added yet, for the node graph (--graph, scripts/run-node)"
        yield Finding("ROS 2", ABSENT, text, "the first command with --graph adds it, which takes a minute")
        return
    source = f"{os.environ.get('ROS_DISTRO', '')}, which is sourced" if sourced else "Jazzy, which came with SKD"
    if not round_trip:
        yield Finding("ROS 2", FINE, source)
        return
    answer = (ask or _asked)()
    if "error" in answer:
        remedy = "cd ros_ws && colcon build && . install/setup.bash"
        if not sourced:
            remedy = f"remove {sys.prefix}, and install SKD anew"
        yield Finding("ROS 2", BROKEN, f"{source}; its nodes do not start ({answer['error']})", remedy)
        return
    yield Finding("ROS 2", FINE, f"{source}, with {answer['middleware']}")
    packages = answer["packages"]
    yield Finding("ROS 2 packages", FINE, ", ".join(name for name, there in packages.items() if there))
    absent = [name for name, there in packages.items() if not there]
    if absent:
        how = "install them beside it" if sourced else "no wheels hold them: source a ROS 2 Jazzy that has them"
        yield Finding("further packages", ABSENT, f"{', '.join(absent)}; for stacks that import them", how)
    seconds = answer["round_trip"]
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    if seconds is None:
        text = f"a message that was published did not come back (ROS_DOMAIN_ID={domain})"
        yield Finding("round trip", BROKEN, text, "is multicast on lo allowed, and /dev/shm not full?")
    else:
        yield Finding("round trip", FINE, f"a message between two nodes came after {seconds:.2f} s")


def _asked() -> dict[str, Any]:
    """Return what a process with ROS 2 says of it."""
    words = [sys.executable, "-P", "-m", "skd_sim.ros.round_trip"]
    variables = node_variables(dict(os.environ))
    variables.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    try:
        done = subprocess.run(words, env=variables, capture_output=True, text=True, timeout=_PATIENCE, check=False)
        answer: dict[str, Any] = json.loads(done.stdout.strip().rpartition("\n")[2])
    except subprocess.TimeoutExpired:
        return {"error": f"no answer within {_PATIENCE:g} s"}
    except ValueError:
        return {"error": (done.stderr.strip().rpartition("\n")[2] or "it said nothing")[:200]}
    return answer
