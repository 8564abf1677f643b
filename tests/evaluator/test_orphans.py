"""What a controller has started ends with its worker, however it hides and however the assessment ends."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from pathlib import Path

import pytest
from cli_support import SMALL, skd, started
from common import PATIENCE, wait_until
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_sim.episode.aborts import AbortKind, kind_of

MOTHERS = """
import os, signal, subprocess, sys, time

SLEEPS = "import os, sys, time; open(sys.argv[1] + '/' + str(os.getpid()), 'w').close(); time.sleep(1000)"

def note():
    open(os.path.join(os.environ["ORPHANS"], str(os.getpid())), "w").close()

def popen(**options):
    return subprocess.Popen([sys.executable, "-I", "-S", "-c", SLEEPS, os.environ["ORPHANS"]], **options)

class _Mother:
    born = False
    def reset(self, scenario, rng):
        self.calls = 0
        if not _Mother.born:
            _Mother.born = True
            self.bear()
            while not os.listdir(os.environ["ORPHANS"]): time.sleep(0.01)
    def command(self, car, adversary):
        self.calls += 1
        if self.calls == 3: self.end()
        return 0.0
    def end(self):
        how = os.environ.get("END")
        if how == "exit": os._exit(3)
        if how == "crash": os.kill(os.getpid(), signal.SIGSEGV)
        if how == "raise": raise RuntimeError("a controller's own")
        if how == "wait": time.sleep(1000)

class Popen(_Mother):
    def bear(self): popen()
class Setsid(_Mother):
    def bear(self): popen(start_new_session=True, env={})
class Fork(_Mother):
    def bear(self):
        if os.fork() == 0:
            note()
            time.sleep(1000)
class DoubleFork(_Mother):
    def bear(self):
        child = os.fork()
        if child == 0:
            os.setsid()
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP): signal.signal(number, signal.SIG_IGN)
            if os.fork() == 0:
                os.closerange(0, 1000)
                note()
                time.sleep(1000)
            os._exit(0)
        os.waitpid(child, 0)
class Many(_Mother):
    def bear(self):
        for kind in (Popen, Setsid, Fork, DoubleFork): kind.bear(self)
"""
KINDS = ("Popen", "Setsid", "Fork", "DoubleFork", "Many")


@pytest.fixture
def mothers(here: Path) -> Path:
    (here / "mothers.py").write_text(MOTHERS)
    (here / "born").mkdir()
    return here


def alive(folder: Path) -> list[int]:
    """Processes that have left their name in a folder, and are still there."""
    found = []
    for entry in folder.iterdir():
        with contextlib.suppress(OSError):
            if Path(f"/proc/{entry.name}/stat").read_bytes().rpartition(b")")[2].split()[0] not in (b"Z", b"X"):
                found.append(int(entry.name))
    return found


def words(kind: str) -> list[str]:
    return [
        "assess", *SMALL, "--safe", "good.csv", "--knowledge", "nothing", "--margin-limit", "0",
        "--controller", f"mothers:{kind}", "--out", "out",
    ]  # fmt: skip


@contextlib.contextmanager
def nobody_is_left(folder: Path):
    """All that was started is gone at the end; what is not is killed, lest a failed test leave it."""
    try:
        yield
        assert list(folder.iterdir())
        assert alive(folder) == []
    finally:
        for pid in alive(folder):
            with contextlib.suppress(OSError):
                os.kill(pid, signal.SIGKILL)


@pytest.mark.parametrize("kind", KINDS)
def test_children_end_with_the_assessment(mothers, kind):
    with nobody_is_left(mothers / "born"):
        done = skd(*words(kind), cwd=mothers, ORPHANS=str(mothers / "born"))
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("end", ["exit", "crash", "raise"])
def test_children_end_with_their_worker(mothers, end):
    with nobody_is_left(mothers / "born"):
        done = skd(*words("Many"), cwd=mothers, ORPHANS=str(mothers / "born"), END=end)
        assert done.returncode == 1, done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("kind", ["Many", "DoubleFork"])
def test_children_end_with_a_command_that_is_ended(mothers, kind, number):
    with nobody_is_left(mothers / "born"):
        running = started(*words(kind), cwd=mothers, ORPHANS=str(mothers / "born"), END="wait")
        wait_until(lambda: len(alive(mothers / "born")) >= (4 if kind == "Many" else 1), "the children")
        os.kill(running.pid, number)
        begin = time.monotonic()
        code = running.finish(PATIENCE).returncode
        assert code == (-signal.SIGKILL if number == signal.SIGKILL else 130)
        # Of a command that is killed nobody waits for the keepers, which look after it twice a second.
        wait_until(lambda: not alive(mothers / "born"), "their end", 20.0 if number == signal.SIGKILL else 0.1)
        assert time.monotonic() - begin < 20.0


# --- a worker that is stopped


def _stopped_at_first(item: tuple[Path, int, int]) -> int:
    folder, number, stops = item
    count = len(list(folder.iterdir()))
    if number == 21 and count < stops:
        folder.joinpath(f"stop-{count}").touch()
        os.kill(os.getpid(), signal.SIGSTOP)
    return 2 * number


@pytest.mark.parametrize("stops", [1, 2, 3])
def test_an_item_whose_worker_is_stopped_is_done_again_but_not_for_ever(tmp_path, stops):
    reasons = []
    begin = time.monotonic()
    with InProcessRunner(2) as runner:
        items = [(tmp_path, item, stops) for item in range(40)]
        found = list(runner.map(_stopped_at_first, items, lambda item, reason: (reasons.append(reason), -1)[1]))
    assert time.monotonic() - begin < 18.0  # a heartbeat that is missed for 20 s is not waited for
    expected = [2 * item for item in range(40)]
    if stops == 3:
        expected[21] = -1
    assert found == expected
    assert [kind_of(reason) for reason in reasons] == [AbortKind.STOPPED] * (stops == 3)


def _ended_at_first(item: tuple[Path, int, int]) -> int:
    folder, number, signal_number = item
    if number == 7 and not (folder / "ended").exists():
        (folder / "ended").touch()
        if signal_number != signal.SIGKILL:
            signal.signal(signal_number, signal.SIG_DFL)  # a shell has what it starts in the background ignore some
        os.kill(os.getpid(), signal_number)
    return 2 * number


_OTHERS = ("HUP", "KILL", "QUIT", "TERM", "USR1", "USR2", "ALRM", "VTALRM", "PROF", "IO", "RTMIN")
_FAULTS = ("SYS", "TRAP", "XCPU")  # those that need no dump of a stack


@pytest.mark.parametrize("name", [*_OTHERS, *_FAULTS])
def test_who_ends_by_a_signal_of_somebody_else_is_run_again_and_who_faults_is_not(tmp_path, name):
    reasons = []
    items = [(tmp_path, item, getattr(signal, f"SIG{name}")) for item in range(12)]
    with InProcessRunner(2) as runner:
        found = list(runner.map(_ended_at_first, items, lambda item, reason: (reasons.append(reason), -1)[1]))
    expected = [2 * item for item in range(12)]
    if name in _FAULTS:
        expected[7] = -1
        assert f"SIG{name}" in reasons[0]
    assert found == expected
    assert len(reasons) == (name in _FAULTS)


STOPS = """
import os, signal
class Car:
    def reset(self, scenario, rng): self.calls = 0
    def command(self, car, adversary):
        self.calls += 1
        marker = os.environ.get("MARKER")
        if marker and self.calls == 4 and abs(adversary.x) < 2.0 and not os.path.exists(marker):
            open(marker, "w").close()
            os.kill(os.getpid(), signal.SIGSTOP)
        return -2.0 if 500.0 > adversary.y > -1.0 else 0.5
"""


def test_figures_do_not_move_when_a_worker_is_stopped(mothers):
    (mothers / "stops.py").write_text(STOPS)
    arguments = words("Many")
    arguments[arguments.index("mothers:Many")] = "stops:Car"
    arguments[arguments.index("--collision-runs") + 1] = "8"
    assert skd(*arguments, cwd=mothers).returncode == 0
    undisturbed = (mothers / "out" / "episodes.npz").read_bytes()
    done = skd(*arguments, "--overwrite", cwd=mothers, MARKER=str(mothers / "stopped"))
    assert (mothers / "stopped").exists()
    assert done.returncode == 0, done.stderr
    assert (mothers / "out" / "episodes.npz").read_bytes() == undisturbed
