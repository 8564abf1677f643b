"""What ran through the graph is run again: in a new graph."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import pytest
from graph_support import HERE, skd
from skd_evaluator.metrics.aborted import NOT_CREDIBLE

NODE = [sys.executable, "-m", "skd_sim.ros.controller_node", "--ros-args", "-p"]
PATHS = {"PYTHONPATH": str(HERE / "controllers")}
SMALL = (
    *("--safe-count", 1, "--kamikaze-count", 4, "--collision-runs", 12, "--simulations", 20, "--seed", 2),
    *("--margin-limit", 0, "--behaviour", "none", "--knowledge", "nothing"),
)


def options_of(name: str, *, node: bool) -> tuple[str, ...]:
    """Return how a car is given as a class, or as a node that somebody else wrote."""
    if not node:
        return ("--controller", f"remembering:{name}")
    command = shlex.join([*NODE, f"controller:=remembering:{name}"])
    return ("--controller", "external", "--controller-command", command)


@pytest.mark.parametrize(("name", "node"), [("Counting", True), ("Honest", False)])
def test_a_car_that_keeps_something_is_not_credible(tmp_path: Path, safe: Path, name: str, node: bool) -> None:
    out = tmp_path / "out"
    car = options_of(name, node=node)
    done = skd("assess", "--graph", "--safe", safe, *SMALL, *car, "--out", out, environment=PATHS)
    found = json.loads((out / "assessment.json").read_text())["warnings"]
    lines = [line for line in found if line.startswith(NOT_CREDIBLE)]
    assert len(lines) == done.code == (name == "Counting"), done.err
    for line in lines:
        assert "episodes went differently when they were run again" in line
        assert line in done.err


def test_one_that_is_probed(tmp_path: Path) -> None:
    car = options_of("Counting", node=True)
    done = skd("probe", "--graph", "--episodes", 24, *car, "--out", tmp_path / "out", environment=PATHS)
    (line,) = json.loads((tmp_path / "out" / "probe.json").read_text())["warnings"]
    assert "episodes went differently when they were run again" in line
    assert line in done.err
