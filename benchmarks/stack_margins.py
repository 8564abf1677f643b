"""How near the margin of a stack behind the node graph comes to that of the same law searched in process.

    PYTHONPATH=benchmarks python benchmarks/stack_margins.py [--safe-count 5] [--attempts 5] [--seed 0]

Each law is assessed twice, in the same attempts: as a node of somebody else's, whose margin is found by whole episodes,
and as a Python class, copies of which are searched tick by tick. It runs `skd assess`, and needs what that needs.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skd_sim.ros_environment.variables import node_variables

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Stack:
    """A law, and the node that drives by it.

    Attributes:
        label: in the table.
        law: as a Python controller.
        command: that starts the node.
        options: of the graph.
    """

    label: str
    law: str
    command: str
    options: tuple[str, ...] = ()


def _law_node(law: str, timer: float = 0.0) -> str:
    return f"python3 {ROOT / 'benchmarks' / 'law_node.py'} --ros-args -p law:={law} -p timer:={timer}"


_VENDOR = f"python3 {ROOT / 'examples' / 'vendor_controller' / 'vendor_controller.py'}"
_BRAKE, _ENCROACHMENT = "cars.collision_time:CollisionTimeBrake", "cars.encroachment:EncroachmentBrake"
_REQUIRED = "cars.required_brake:RequiredDecelerationBrake"

STACKS = (
    Stack("vendor's example", "cars.vendor:VendorCar", _VENDOR),
    Stack("time to collision", _BRAKE, _law_node(_BRAKE), ("--control-period", "0.05")),
    Stack("encroachment", _ENCROACHMENT, _law_node(_ENCROACHMENT), ("--control-period", "0.05")),
    Stack(
        "required deceleration, timer",
        _REQUIRED,
        _law_node(_REQUIRED, 0.1),
        ("--control-period", "0.1", "--quiet-time", "0.1"),
    ),
)


def assessed(words: list[str], out: Path) -> dict[str, Any]:
    """Run `skd assess`, and return what it wrote.

    Raises:
        SystemExit: it failed.
    """
    command = [sys.executable, "-m", "skd_evaluator", "assess", *words, "--quiet", "--out", str(out)]
    paths = os.pathsep.join([str(ROOT / "benchmarks"), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**node_variables(os.environ), "PYTHONPATH": paths}  # messages are needed by the vendor's law
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if not (out / "assessment.json").is_file():
        raise SystemExit(f"{shlex.join(command)}\n{done.stdout}{done.stderr}")
    found: dict[str, Any] = json.loads((out / "assessment.json").read_text(encoding="utf-8"))
    return found


def main() -> None:
    """Compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--safe-count", type=int, default=5, metavar="N", help="φ (default 5)")
    parser.add_argument("--attempts", type=int, default=5, metavar="N", help="per φ, at most 5 (default 5)")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--only", choices=[one.label for one in STACKS], action="append", help="this stack")
    arguments = parser.parse_args()
    counts = ["--safe-count", arguments.safe_count, "--kamikaze-count", arguments.attempts, "--seed", arguments.seed]
    shared = [*map(str, counts), "--collision-runs", str(arguments.safe_count), "--knowledge", "nothing"]
    print(f"{'':30} {'graph (m)':>10} {'in process (m)':>15} {'graph / in process':>19}  how")
    for stack in STACKS:
        if arguments.only and stack.label not in arguments.only:
            continue
        with tempfile.TemporaryDirectory() as folder:
            external = ["--graph", "--controller", "external", "--controller-command", stack.command, *stack.options]
            walked = assessed([*external, *shared], Path(folder) / "graph")
            searched = assessed(["--controller", stack.law, "--workers", "1", *shared], Path(folder) / "process")
        one, other = walked["margin"], searched["margin"]
        if one is None or other is None:
            raise SystemExit(f"{stack.label}: {walked['margin_note'] or searched['margin_note']}")
        state = "" if walked["margin_converged"] else "not converged; "
        took = f"{walked['seconds']:.0f} and {searched['seconds']:.0f} s"
        print(f"{stack.label:30} {one:10.3f} {other:15.3f} {one / other:19.3f}  {state}{walked['margin_how']}; {took}")


if __name__ == "__main__":
    main()
