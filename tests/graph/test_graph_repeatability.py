"""A sample of what ran through the graph is run again, in a new graph."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

from graph_support import HERE, skd
from skd_evaluator.metrics.aborted import NOT_CREDIBLE

NODE = [sys.executable, "-m", "skd_sim.ros.controller_node", "--ros-args", "-p"]
PATHS = {"PYTHONPATH": str(HERE / "controllers")}
SMALL = (
    *("--safe-count", 1, "--kamikaze-count", 4, "--collision-runs", 12, "--simulations", 20, "--seed", 2),
    *("--margin-limit", 0, "--behaviour", "none", "--adversary-model", "generic"),
)


def test_a_car_that_keeps_something_is_not_credible(tmp_path: Path, safe: Path) -> None:
    out, command = tmp_path / "out", shlex.join([*NODE, "controller:=remembering:Counting"])
    car = ("--controller", "external", "--controller-command", command)
    done = skd("assess", "--graph", "--safe", safe, *SMALL, *car, "--out", out, environment=PATHS)
    found = json.loads((out / "assessment.json").read_text())["warnings"]
    (line,) = [line for line in found if line.startswith(NOT_CREDIBLE)]
    assert done.code == 1, done.err
    assert "episodes went differently when they were run again" in line
    assert line in done.err
