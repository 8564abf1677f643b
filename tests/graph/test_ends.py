"""Programs that are interrupted before they have begun, and ends that hang: all end in time."""

import os
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest
from common import PATIENCE, new_domain, wait_for_line, wait_until
from graph_support import Finished, Program, assert_all_gone, in_domain, skd_command

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
MARGIN = 2.0  # s that a busy machine may take beyond what a hanging end may cost


def test_a_node_whose_end_hangs(tmp_path: Path) -> None:
    """It ends in time, as if it had ended in order."""
    log = tmp_path / "log"
    environment = {**os.environ, "ROS_DOMAIN_ID": str(new_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with log.open("w") as output:
        command = [sys.executable, "-c", NODE, str(tmp_path / "hangs"), "skd_sim.ros.simulator_node"]
        process = subprocess.Popen(command, env=environment, stdout=output, stderr=output)
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
    command = [
        sys.executable, "-c", ASSESS, "assess", "--graph", "--record", "--adversary-model", "generic",
        "--margin-limit", 0, "--behaviour", "none", "--safe", safe, "--safe-count", 1, "--kamikaze-count", 2,
        "--collision-runs", 2, "--simulations", 50, "--no-pictures", "--out", tmp_path / "out",
    ]  # fmt: skip
    with in_domain(new_domain(), token):
        process = subprocess.Popen([*map(str, command)], stderr=subprocess.PIPE, text=True)
    try:
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


SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"
PROGRAMS = {  # command, exit code when interrupted
    "vehicle_simulator": ([str(SCRIPTS / "run-node"), "vehicle_simulator"], 0),
    "evaluator": ([str(SCRIPTS / "run-node"), "evaluator"], 130),
    "skd": (skd_command("assess"), 130),
}
SLOW_IMPORT = """
import sys, time
print("importing", flush=True)
try:
    for _ in range(100_000):  # one long sleep misses a signal that comes just before it
        time.sleep(0.01)
except KeyboardInterrupt:
    {then}
"""


def interrupted(command: list[str], number: int, path: Path) -> Finished:
    """Start a command, and send it a signal as soon as it has said something."""
    paths = ":".join([str(path), *(entry for entry in sys.path if entry)])
    program = Program(command, {"SKD_ENV": str(Path(sys.executable).parent), "PYTHONPATH": paths})
    assert wait_for_line(program.popen, "") == "importing\n"
    program.popen.send_signal(number)
    return program.finish()


@pytest.mark.parametrize(
    ("name", "number"), [("vehicle_simulator", signal.SIGINT), ("evaluator", signal.SIGTERM), ("skd", signal.SIGINT)]
)
def test_a_signal_during_the_imports(tmp_path: Path, name: str, number: int) -> None:
    (tmp_path / "numba.py").write_text(SLOW_IMPORT.format(then="raise"))
    command, code = PROGRAMS[name]
    finished = interrupted(command, number, tmp_path)
    assert finished.code == code
    said = "skd assess: interrupted; nothing was written\n" if name == "skd" else ""  # it knows its command already
    assert finished.err == said
