"""What ran through the graph is run again: a class in a process, a node through a graph of its own."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path

import pytest
from graph_support import HERE, Finished, skd
from skd_evaluator.measure.doubt import in_doubt

NODE = [sys.executable, "-m", "skd_sim.nodes.car_controller", "--ros-args", "-p"]
PATHS = {"PYTHONPATH": str(HERE / "controllers")}


def options_of(name: str, *, node: bool) -> tuple[str, ...]:
    """Return how a car is given as a class, or as a node that somebody else wrote."""
    if not node:
        return ("--controller", f"remembering:{name}")
    command = shlex.join([*NODE, f"controller:=remembering:{name}"])
    return ("--controller", "external", "--controller-command", command)


def assess(folder: Path, safe: Path, name: str, *options: object, node: bool) -> tuple[Finished, list[str]]:
    """Return how an assessment ended, and what it found against its figures."""
    sizes = ("--safe-count", 1, "--kamikaze-count", 4, "--collision-runs", 12, "--simulations", 20)
    less = ("--margin-limit", 0, "--behaviour", "none", "--knowledge", "nothing", "--seed", 2)
    done = skd(
        *("assess", "--graph", "--safe", safe, *sizes, *less, *options_of(name, node=node), *options),
        *("--out", folder / "out"),
        environment=PATHS,
    )
    return done, in_doubt(json.loads((folder / "out" / "assessment.json").read_text())["warnings"])


@pytest.mark.parametrize("node", [False, True])
def test_one_that_keeps_something_is_found(tmp_path: Path, safe: Path, node: bool) -> None:
    done, found = assess(tmp_path, safe, "Counting", node=node)
    assert "episodes went otherwise when they were run again, in a new" in found[0], done.err
    assert "as by what it keeps from one episode to the next" in found[0]
    assert found[0] in done.err
    assert (tmp_path / "out" / "logs" / "again" / "car_controller.log").exists() == node


def test_one_that_does_not_is_not(tmp_path: Path, safe: Path) -> None:
    """Another test looks at such a node, in test_learning_and_margin.py."""
    done, found = assess(tmp_path, safe, "Honest", "--nodes", "separate", node=False)
    assert done.code == 0, done.err
    assert not found


def test_one_that_is_probed(tmp_path: Path) -> None:
    car = options_of("Counting", node=True)
    done = skd("probe", "--graph", "--episodes", 24, *car, "--out", tmp_path / "out", environment=PATHS)
    (line,) = json.loads((tmp_path / "out" / "probe.json").read_text())["warnings"]
    assert "episodes went otherwise when they were run again, in a new" in line
    assert line in done.err
