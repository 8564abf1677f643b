"""Programs that are told to end before they have begun: quietly, at once, and with the code that is documented."""

from __future__ import annotations

import signal
import sys
from pathlib import Path

import pytest
from common import wait_for_line
from graph_support import Finished, Program, skd_command

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
    program = Program(command, {"SKD_ENV": str(Path(sys.executable).parent), "PYTHONPATH": _first_on_path(path)})
    assert wait_for_line(program.popen, "") == "importing\n"
    program.popen.send_signal(number)
    return program.finish()


def _first_on_path(folder: Path) -> str:
    return ":".join([str(folder), *(entry for entry in sys.path if entry)])


@pytest.mark.parametrize(
    ("name", "number"),
    [("vehicle_simulator", signal.SIGINT), ("evaluator", signal.SIGTERM), ("skd", signal.SIGINT)],
)
def test_a_signal_during_the_imports(tmp_path: Path, name: str, number: int) -> None:
    (tmp_path / "numba.py").write_text(SLOW_IMPORT.format(then="raise"))
    command, code = PROGRAMS[name]
    finished = interrupted(command, number, tmp_path)
    assert finished.code == code
    said = "skd assess: interrupted; nothing was written\n" if name == "skd" else ""  # it knows its command already
    assert finished.err == said


SECOND_SIGNAL = """
import os, signal, sys
from skd_sim.start import start

class Program:
    @staticmethod
    def main():
        return 3

sys.modules["program"] = Program
code = start("program")
os.kill(os.getpid(), int(sys.argv[1]))
print(int(signal.getsignal(signal.SIGINT)))
sys.exit(code)
"""


@pytest.mark.parametrize(("number", "said"), [(signal.SIGINT, "1\n"), (signal.SIGTERM, "")])
def test_a_signal_while_python_itself_ends(number: int, said: str) -> None:
    """SIGINT is ignored (1), and by the kernel, for Python takes its handlers away before its end; SIGTERM ends."""
    finished = Program([sys.executable, "-c", SECOND_SIGNAL, str(int(number))]).finish()
    assert (finished.code, finished.out, finished.err) == (3, said, "")
