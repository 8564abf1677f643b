"""An end that hangs and holds Python's lock is bounded: of SKD's nodes, of a user's controller, of the command."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest
from common import PATIENCE, new_domain, wait_until
from graph_support import assert_all_gone, in_domain, whole_graph
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.ros import processes
from skd_sim.world.episode import EpisodeLog, EpisodeSpec

HANGS = """
import ctypes, pathlib, sys
import rclpy.node

def destroy_node(self):
    pathlib.Path(sys.argv[1]).touch()
    while True:
        ctypes.PyDLL(None).sleep(1000)  # holds the global lock; a signal ends one sleep only

rclpy.node.Node.destroy_node = destroy_node
"""
NODE = (
    HANGS
    + """
from skd_sim.ros import support
from skd_sim.start import start
spin = support.spin

def spin_and_say_so(*arguments):
    pathlib.Path(sys.argv[1] + "-ready").touch()
    spin(*arguments)

support.spin = spin_and_say_so
sys.exit(start(sys.argv[2]))
"""
)
CONTROLLER = (
    HANGS
    + """
from skd_sim.ros import support, controller_node
import contextlib
support.end_within = lambda *_: contextlib.nullcontext()  # as of somebody else's node
sys.exit(controller_node.main(["--ros-args", "-p", "controller:=basic"]))
"""
)
MARGIN = 2.0  # s that a busy machine may take beyond what a hanging end may cost


def test_a_node_whose_end_hangs(tmp_path: Path) -> None:
    """It ends in time, as if it had ended in order."""
    log = tmp_path / "log"
    environment = {**os.environ, "ROS_DOMAIN_ID": str(new_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with log.open("w") as output:
        process = subprocess.Popen(
            [sys.executable, "-c", NODE, str(tmp_path / "hangs"), "skd_sim.ros.simulator_node"],
            env=environment,
            stdout=output,
            stderr=output,
        )
    try:
        wait_until(lambda: (tmp_path / "hangs-ready").exists() or process.poll() is not None, "the node")
        assert process.poll() is None, log.read_text()
        process.send_signal(signal.SIGINT)
        wait_until((tmp_path / "hangs").exists, "its end")
        begin = time.monotonic()
        assert process.wait(PATIENCE) == 0, log.read_text()
        assert 0.5 < time.monotonic() - begin < 2.0 + MARGIN
        assert log.read_text() == ""
    finally:
        process.kill()
        process.wait()


def test_a_controller_whose_end_hangs(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], episode: EpisodeSpec, expected: EpisodeLog
) -> None:
    """It is killed after two seconds, and a line says so; nothing else waits for it."""
    marker = tmp_path / "hangs"
    command = shlex.join([sys.executable, "-c", CONTROLLER, str(marker)])
    with whole_graph(tmp_path, GraphOptions(controller_command=command)) as (evaluator, _):
        log = evaluator.run_episode(episode)
        begin = time.monotonic()
    took = time.monotonic() - begin
    assert log.car.tobytes() == expected.car.tobytes()
    assert marker.exists()
    assert processes.END_LIMIT == 2.0
    assert 1.5 < took < 2.0 + MARGIN
    lines = [line for line in capfd.readouterr().err.splitlines() if "killed" in line]
    assert lines == ["skd: car_controller did not end within 2 s of SIGINT; it is killed, with its group"]


ASSESS = """
import ctypes, sys
import rclpy.node

def destroy_node(self):
    print("hangs", file=sys.stderr, flush=True)
    ctypes.PyDLL(None).sleep(1000)

rclpy.node.Node.destroy_node = destroy_node
from skd_evaluator.start import skd
sys.argv[0] = "skd"
sys.exit(skd())
"""


def test_a_command_whose_own_node_hangs_in_its_end(tmp_path: Path, safe: Path) -> None:
    """Results are written before, and it ends in time with the code that it deserves."""
    token = uuid.uuid4().hex
    arguments = [
        "assess", "--graph", "--record", "--adversary-model", "generic", "--margin-limit", 0, "--behaviour", "none",
        "--safe", safe, "--safe-count", 1, "--kamikaze-count", 2, "--collision-runs", 2, "--simulations", 50,
        "--out", tmp_path / "out",
    ]  # fmt: skip
    with in_domain(new_domain(), token):
        process = subprocess.Popen(
            [sys.executable, "-c", ASSESS, *map(str, arguments)], stderr=subprocess.PIPE, text=True
        )
    try:
        assert process.stderr is not None
        lines = []
        for line in process.stderr:
            lines.append(line)
            if line == "hangs\n":
                break
        assert (tmp_path / "out" / "assessment.json").exists(), lines
        assert len(list((tmp_path / "out" / "bags").iterdir())) >= 4
        begin = time.monotonic()
        assert process.wait(PATIENCE) == 0, lines
        assert time.monotonic() - begin < 2.0 + MARGIN
        assert_all_gone(token)
    finally:
        process.kill()
        process.communicate()
