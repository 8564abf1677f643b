"""Processes that cannot start, and those that hang."""

from __future__ import annotations

import os
import re
import shlex
import sys
from pathlib import Path

import pytest
from common import wait_until
from graph_support import of_node, whole_graph
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.ros.processes import GraphError, Program, Supervisor
from skd_sim.world.episode import AbortKind, EpisodeSpec, Outcome, kind_of


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


def test_a_node_that_does_not_answer_is_replaced(tmp_path: Path, episode: EpisodeSpec) -> None:
    """It runs, but hangs: a controller whose command waits for ever, and does not listen to signals either."""
    code = (
        "import signal, sys; [signal.signal(n, signal.SIG_IGN) for n in (2, 15)]; import rclpy; rclpy.init();"
        "from geometry_msgs.msg import AccelStamped; node = rclpy.create_node('hangs');"
        "p = node.create_publisher(AccelStamped, '/ego/acceleration_command', 10); signal.pause()"
    )
    options = GraphOptions(controller_command=shlex.join([sys.executable, "-c", code]), startup_timeout=3.0)
    with whole_graph(tmp_path, options) as (evaluator, token):
        hanging = of_node(token, "'hangs'")
        while kind_of((log := evaluator.run_episode(episode)).reason) == AbortKind.NOT_STARTED:
            pass  # it was not there yet
        assert log.outcome == Outcome.ABORTED
        assert kind_of(log.reason) == AbortKind.NO_ANSWER
        assert of_node(token, "'hangs'") != hanging
