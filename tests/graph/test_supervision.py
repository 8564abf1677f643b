"""Processes that hang or leave children."""

from __future__ import annotations

import os
import re
import shlex
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from common import wait_until
from graph_support import Skd, of_node, whole_graph
from skd_evaluator.assessment.stages.graph_options import GraphOptions
from skd_evaluator.ros.processes import GraphError, Program, Supervisor
from skd_sim.world.episode import AbortKind, Episode, Outcome, kind_of


@pytest.mark.parametrize(
    ("program", "words"),
    [
        (
            "import tf2_nowhere",
            "ModuleNotFoundError: No module named 'tf2_nowhere'; the ROS 2 that SKD brings has rclpy",
        ),
        ("import sys; sys.exit(127)", "(it has printed nothing)"),
    ],
)
def test_what_can_never_start_is_not_started_again_and_again(tmp_path: Path, program: str, words: str) -> None:
    environment = {"PATH": os.environ["PATH"]}
    said: list[str] = []
    with Supervisor({"driver": Program([sys.executable, "-c", program], environment)}, tmp_path, said.append) as one:
        problems = []
        with pytest.raises(GraphError, match=re.escape(f"for the 2. time; its last words: {words}")):
            wait_until(lambda: problems.extend(filter(None, [one.check()])), "an end")
    assert len(problems) == 1
    assert len(said) == 1


def test_a_node_that_does_not_answer_is_replaced(tmp_path: Path, episode: Episode) -> None:
    """It runs, but hangs: a controller whose command waits for ever, and does not listen to signals either."""
    code = (
        "import signal, sys; [signal.signal(n, signal.SIG_IGN) for n in (2, 15)]; import rclpy; rclpy.init();"
        "from geometry_msgs.msg import AccelStamped; node = rclpy.create_node('hangs');"
        "p = node.create_publisher(AccelStamped, '/ego/acceleration_command', 10); signal.pause()"
    )
    options = GraphOptions(controller_command=shlex.join([sys.executable, "-c", code]), startup_timeout=5.0)
    with whole_graph(tmp_path, options) as (evaluator, token):
        hanging = of_node(token, "'hangs'")
        while kind_of((log := evaluator.run_episode(episode)).reason) == AbortKind.NOT_STARTED:
            pass  # it was not there yet
        assert log.outcome == Outcome.ABORTED
        assert kind_of(log.reason) == AbortKind.NO_ANSWER
        assert of_node(token, "'hangs'") != hanging


def campaign(folder: Path, safe: Path, command: Sequence[str]) -> Skd:
    """Start a campaign with a controller, and wait until that runs."""
    program = Skd(
        *(
            "assess",
            "--graph",
            "--knowledge",
            "nothing",
            "--controller",
            "external",
            "--controller-command",
            shlex.join(command),
        ),
        *("--safe", safe, "--safe-count", 1, "--out", folder / "out"),
    )
    wait_until(lambda: list(folder.glob("running*")), "the controller")
    return program


def test_a_controller_that_ignores_signals(tmp_path: Path, safe: Path) -> None:
    code = (
        "import signal, sys, pathlib; [signal.signal(n, signal.SIG_IGN) for n in (1, 2, 15)];"
        "pathlib.Path(sys.argv[1]).touch(); [signal.pause() for _ in iter(int, 1)]"
    )
    program = campaign(tmp_path, safe, [sys.executable, "-c", code, str(tmp_path / "running")])
    program.send_signal(signal.SIGINT)
    finished = program.finish(60.0)
    assert finished.code == 130
    assert finished.lines[-1] == "skd assess: interrupted; nothing was written"
    assert [entry.name for entry in tmp_path.iterdir()] == ["running"]


LEAVES = """
import os, pathlib, signal, sys, time
if os.fork() == 0:
    [signal.signal(n, signal.SIG_IGN) for n in (1, 2, 15)]
    pathlib.Path(sys.argv[1]).touch()
    while True:
        time.sleep(1.0)
signal.pause()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_child_that_a_controller_leaves(tmp_path: Path, safe: Path, number: int) -> None:
    program = campaign(tmp_path, safe, [sys.executable, "-c", LEAVES, str(tmp_path / "running")])
    program.send_signal(number)
    program.finish()  # which sees that nothing is left
