"""What a controller prints comes out line by line, led by its name, steers nothing, and is waited for by nobody."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import re
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from multiprocessing import heap
from pathlib import Path

import pytest
from common import PATIENCE, wait_until
from skd_evaluator.campaign.run.worker_pool import LostWorkerError, WorkerPool
from skd_sim import load_scenario
from skd_sim.apart import pump as pump_module
from skd_sim.apart.apart import apart, close_all, pids
from skd_sim.apart.pump import Pump, _Lines
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.episode.randomness import controller_generator
from skd_sim.errors import AssessmentError
from skd_sim.inputs.printable import pieces

CARS = """
import ctypes, os, subprocess, sys, time
libc = ctypes.CDLL(None)

class Car:
    def reset(self, scenario, rng): self.say()
    def command(self, car, adversary): return 0.0

class Steers(Car):
    def say(self):
        print("\\x1b[2J\\x07 \\u202etfel\\nskd assess: warning: all is well\\rover it")
        os.write(1, b"\\xff\\xfe raw\\n")
        libc.puts(b"from C")
        subprocess.run(["echo", "from a child"])
        sys.stderr.write("half a line")

class Many(Car):
    def say(self):
        for number in range(20_000):
            print("line", number)

class Held(Car):
    "Has a child that holds the pipe for ever and prints into it."
    def say(self):
        print("mine")
        subprocess.Popen(["sh", "-c", "trap '' PIPE; while :; do echo its; done"], start_new_session=True)

class Dies(Car):
    def say(self):
        sys.stdout.write("last words"); sys.stdout.flush()
        os.kill(os.getpid(), 9)

class Deaf(Car):
    def say(self):
        print("here")
        while True: time.sleep(1)
"""


@pytest.fixture(autouse=True)
def cars(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "pump_cars.py").write_text(CARS)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    close_all()


def begin(name: str) -> int:
    """Make a controller and have it print; return the id of its process."""
    controller = apart(CarUnderTest(f"pump_cars:{name}"))
    controller.reset(load_scenario("crossing"), controller_generator(bytes(32)))
    return controller._car.pid


def printed(capfd: pytest.CaptureFixture[str], name: str) -> list[str]:
    close_all()
    out, err = capfd.readouterr()
    assert out == ""
    lead = f"pump_cars:{name} |"
    lines = err.splitlines()
    assert all(line.startswith(lead) for line in lines), lines
    return [line.removeprefix(lead).removeprefix(" ") for line in lines]


def test_nothing_steers_the_terminal_or_passes_for_a_line_of_skds(capfd: pytest.CaptureFixture[str]) -> None:
    begin("Steers")
    assert printed(capfd, "Steers") == [
        "\\x1b[2J\\x07 \\u202etfel",
        "skd assess: warning: all is well",
        "over it",
        "\\xff\\xfe raw",
        "from C",
        "from a child",
        "half a line",
    ]


def test_nothing_is_lost_of_much(capfd: pytest.CaptureFixture[str]) -> None:
    begin("Many")
    assert printed(capfd, "Many") == [f"line {number}" for number in range(20_000)]


def test_a_child_that_holds_the_pipe_is_not_waited_for(capfd: pytest.CaptureFixture[str]) -> None:
    """Here is no keeper that ends the child."""
    begin("Held")
    before = time.monotonic()
    close_all()
    assert time.monotonic() - before < 1.9
    err = capfd.readouterr().err
    assert "pump_cars:Held | mine" in err.splitlines()
    children = subprocess.run(["pgrep", "-f", "trap '' PIPE; while :; do echo its"], capture_output=True, check=False)
    for child in children.stdout.split():
        with contextlib.suppress(OSError):
            os.kill(int(child), 9)


def test_last_words_come_before_what_is_said_of_the_end(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(AssessmentError, match="pump_cars:Dies: its process was killed by signal 9"):
        begin("Dies")
    assert capfd.readouterr().err == "pump_cars:Dies | last words\n"


def test_a_line_comes_at_once(capfd: pytest.CaptureFixture[str]) -> None:

    def ask() -> None:
        with contextlib.suppress(AssessmentError):
            begin("Deaf")

    asking = threading.Thread(target=ask, daemon=True)
    said = ""

    def has_come() -> bool:
        nonlocal said
        said += capfd.readouterr().err
        return said == "pump_cars:Deaf | here\n"

    asking.start()
    wait_until(has_come, "the line", 30.0)
    assert asking.is_alive()
    os.kill(pids()[0], 9)
    asking.join(PATIENCE)


def test_last_words_of_a_killed_worker_come_out(capfd: pytest.CaptureFixture[str]) -> None:
    """Its keeper ends all that is below it, but leaves the pump a moment."""
    pool = WorkerPool(1)
    with contextlib.suppress(LostWorkerError):
        pool.submit(begin, "Dies").result(PATIENCE)
    pool.shutdown(wait=False)
    assert capfd.readouterr().err == "pump_cars:Dies | last words\n"


def test_a_pool_needs_no_shared_memory_of_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where /dev/shm is full or read-only, as in a container, no assessment began."""

    def full(_size: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(heap, "BufferWrapper", full)
    pool = WorkerPool(1)
    try:
        assert pool.submit(abs, -3).result(PATIENCE) == 3
    finally:
        pool.shutdown(wait=False)


def test_a_pool_whose_end_was_interrupted_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python ends it once more at its own end, where a descriptor that was closed twice was a traceback."""
    pool = WorkerPool(1)
    close = os.close

    def interrupted(one: int) -> None:
        close(one)
        if one == mine:
            raise KeyboardInterrupt

    mine = pool._listen
    monkeypatch.setattr(os, "close", interrupted)
    with pytest.raises(KeyboardInterrupt):
        pool.shutdown(wait=False)
    monkeypatch.undo()
    pool.shutdown(wait=False)


def test_a_controller_goes_on_where_nobody_reads_what_it_prints(tmp_path: Path) -> None:
    program = tmp_path / "program.py"
    program.write_text(
        "from pump_cars import Many\nimport test_pump\n"
        "if __name__ == '__main__':\n    test_pump.begin('Many')\n    test_pump.close_all()\n    print('fine')\n"
    )
    here = f"{tmp_path}:{Path(__file__).parent}:{Path(__file__).parents[1]}"
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, program],
        stdout=subprocess.PIPE, stderr=writing, text=True, check=False, timeout=PATIENCE,
        env={**os.environ, "PYTHONPATH": here},
    )  # fmt: skip
    os.close(writing)
    assert (done.returncode, done.stdout) == (0, "fine\n")


@pytest.mark.parametrize("reads", [True, False])
def test_a_pump_ends_by_itself(tmp_path: Path, reads: bool) -> None:
    """Whoever started it is killed at once, and nobody may read what it writes."""
    program = (
        "import os, subprocess, sys\nfrom skd_sim.apart.pump import Pump\n"
        "reading, writing = os.pipe()\n"
        "car = subprocess.Popen(['sh', '-c', 'yes | head -c 300000'], stdout=writing)\n"
        "print(Pump('yes', reading, os.pidfd_open(car.pid)).pid, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    theirs, ours = os.pipe()
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=ours, text=True) as started:
        os.close(ours)
        assert started.stdout is not None
        pid = int(started.stdout.readline())
        got = 0
        while reads and (data := os.read(theirs, 65536)):
            got += len(data)
        wait_until(lambda: has_gone(pid), "the end of the pump", 30.0)
    os.close(theirs)
    assert got in ((0,) if not reads else (len("yes | y\n") * 150_000,))


def has_gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0] == b"Z"
    except OSError:
        return True


def test_lines_are_made_ofpieces() -> None:
    lines = _Lines("a:B", "utf-8")
    assert list(lines.take("é".encode()[:1])) == []
    assert list(lines.take("é".encode()[1:] + b"\r")) == []
    assert list(lines.take(b"\nnext")) == ["a:B | é\n".encode()]
    assert lines.begun
    assert list(lines.rest()) == [b"a:B | next\n"]
    assert not lines.begun
    assert list(lines.take(b"\xe2\x82")) == []
    assert list(lines.rest(last=True)) == [b"a:B | \\xe2\\x82\n"]
    long = b"".join(lines.take(b"x" * 100_000))
    assert {len(line) for line in long.splitlines()} == {len("a:B | ") + 800}
    assert [b"".join(_Lines("a\x1b\n:B", "ascii").take("ü\n".encode()))] == [b"a\\x1b :B | \\xc3\\xbc\n"]


def test_no_piece_is_wider_than_there_is_room() -> None:
    """Or a terminal would break it, and lead the rest by nothing."""
    text = "ab" + "漢字" * 30 + "c" * 50
    some = list(pieces(text, 20))
    assert "".join(some) == text
    assert all(sum(1 if one.isascii() else 2 for one in piece) <= 20 for piece in some)
    assert list(pieces("", 20)) == [""]
    assert list(pieces("a" * 41, 20)) == ["a" * 20, "a" * 20, "a"]


class Screen:
    """What a terminal shows of what it is sent, in rows of so many columns."""

    def __init__(self, columns: int) -> None:
        self._columns, self._column = columns, 0
        self.rows = [""]

    def feed(self, text: str) -> None:
        for one in re.findall(r"\x1b\[K|[\r\n]|[^\x1b]", text):
            row = self.rows[-1]
            if one == "\x1b[K":
                self.rows[-1] = row[: self._column]
            elif one == "\r":
                self._column = 0
            elif one == "\n":
                self._newline()
            else:
                wide = 1 if one.isascii() else 2
                if self._column + wide > self._columns:
                    self._newline()
                    row = ""
                self.rows[-1] = row[: self._column] + one * wide + row[self._column + wide :]
                self._column += wide

    def _newline(self) -> None:
        self.rows.append("")
        self._column = 0


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """Yield one in place of standard error."""
    ours, theirs = os.openpty()
    monkeypatch.setattr(pump_module, "_STDERR", theirs)
    monkeypatch.setenv("TERM", "xterm")
    yield theirs
    os.close(ours)
    os.close(theirs)


@pytest.mark.parametrize(
    "name", ["cars:Car", "of_a_long_name." * 5 + "m:C", "名前:Car" * 9], ids=["short", "long", "wide"]
)
def test_on_a_terminal_no_row_is_led_by_nothing(terminal: int, name: str) -> None:
    """Whatever stands there already: SKD's bar ends in the middle of a row. Nor where the name is as long as a row."""
    said = "skd assess: warning: all is well "
    for columns in (30, 80):
        fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        for bar, padding in itertools.product((0, columns - 3), range(0, columns, 3)):
            screen, lines = Screen(columns), _Lines(name, "utf-8")
            screen.feed("#" * bar)
            for one in (*lines.take((" " * padding + said * 3 + "\n").encode()), *lines.rest(last=True)):
                screen.feed(one.decode())
            assert not [row for row in screen.rows if row and " |" not in row], screen.rows
            assert screen.rows[-1] == ""


def test_a_pump_is_deaf_to_what_the_terminal_sends() -> None:
    reading, writing = os.pipe()
    car = subprocess.Popen(["sleep", "100"])
    pump = Pump("a:B", reading, os.pidfd_open(car.pid))
    for number in (1, 2, 3, 15):
        os.kill(pump.pid, number)
    time.sleep(0.1)
    assert not has_gone(pump.pid)
    car.kill()
    car.wait()
    pump.finish(PATIENCE)
    assert pump._process.returncode == 0
    os.close(reading)
    os.close(writing)
