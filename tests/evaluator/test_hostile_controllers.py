"""A controller under test may do anything: the campaign ends and says who is to blame; exit code 0 means it is done."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from cli_support import SMALL, one_line, skd
from common import wait_until
from skd_evaluator.campaign.plan.plan import Plan, Recorder, collision_runs
from skd_evaluator.campaign.run import worker_pool
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.errors import AssessmentError
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.aborts import AbortKind, abort_reason, counted_reasons, kind_of
from skd_sim.episode.episode import Outcome

HOSTILE = """
import ctypes, os, signal, sys, time

class _Car:
    def reset(self, scenario, rng): self.calls = 0
    def command(self, car, adversary):
        self.calls += 1
        return 0.0 if self.calls < 3 else self.late()

class LeavesQuietly(_Car):
    def late(self): os._exit(0)
class Crashes(_Car):
    def late(self): ctypes.string_at(0)
class Huge(_Car):
    def late(self): return 10 ** 400
class _NoFloat:
    def __float__(self): raise SystemExit(0)
    def __repr__(self): raise RuntimeError("nor this")
class NoFloat(_Car):
    def late(self): return _NoFloat()
class Stop(BaseException):
    def __str__(self): raise ValueError("unspeakable")
class RaisesBase(_Car):
    def late(self): raise Stop
class Interrupts(_Car):
    def late(self): raise KeyboardInterrupt
class Text(_Car):
    def late(self): return "1.0"
class QuietInInit(_Car):
    def __init__(self): sys.exit(0)
class GoneInInit(_Car):
    def __init__(self): os._exit(0)
class CrashesInInit(_Car):
    def __init__(self): ctypes.string_at(0)
class Moody(_Car):
    # Every fourth process that is made for it dies in its second episode.
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        with open("episodes", "a") as file: file.write("x")
        if os.path.getsize("episodes") % 8 == 5: os._exit(7)
    def late(self): return 0.0
class Ignores(_Car):
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        open("ready", "w").close()
    def late(self): time.sleep(1000)
class Strong(_Car):
    def late(self): return -200.0
class Rocket(_Car):
    def late(self): return 1e300
"""


@pytest.fixture
def hostile(here: Path) -> Path:
    (here / "hostile.py").write_text(HOSTILE)
    (here / "leaves_at_import.py").write_text("import sys; sys.exit(0)\nclass Car: pass\n")
    (here / "gone_at_import.py").write_text("import os; os._exit(0)\nclass Car: pass\n")
    return here


def assess(hostile: Path, name: str, *more: str) -> subprocess.CompletedProcess[str]:
    controller = name if ":" in name else f"hostile:{name}"
    return skd(
        "assess",
        *SMALL,
        "--safe",
        "good.csv",
        "--knowledge",
        "nothing",
        "--controller",
        controller,
        "--out",
        "out",
        *more,
        cwd=hostile,
    )


@pytest.mark.parametrize("workers", ["1", "2"])
@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("LeavesQuietly", ["3 starts in a row failed", "process ended", "exit code 0"]),
        ("Crashes", ["3 starts in a row failed", "process ended", "SIGSEGV"]),
    ],
)
def test_a_controller_that_ends_the_process_ends_no_campaign_with_0(hostile, name, parts, workers):
    one_line(assess(hostile, name, "--workers", workers), 1, *parts)
    assert not (hostile / "out").exists()


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("QuietInInit", ["cannot be loaded", "SystemExit: 0"]),
        ("GoneInInit", ["cannot be loaded", "exit code 0"]),
        ("CrashesInInit", ["cannot be loaded", "SIGSEGV"]),
        ("leaves_at_import:Car", ["cannot be loaded", "SystemExit: 0"]),
        ("gone_at_import:Car", ["cannot be loaded", "exit code 0"]),
    ],
)
def test_a_controller_that_ends_the_process_when_it_is_made(hostile, name, parts):
    one_line(assess(hostile, name), 2, *parts)


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("Huge", ["finite number", "100000"]),
        ("NoFloat", ["finite number", "_NoFloat", "cannot be shown"]),
        ("RaisesBase", ["command failed with Stop", "cannot be shown", "hostile.py, line"]),
        ("Interrupts", ["command failed with KeyboardInterrupt", "hostile.py, line"]),
        ("Text", ["finite number", "'1.0'"]),
    ],
)
def test_whatever_a_controller_answers_or_raises_is_one_line(hostile, name, parts):
    one_line(assess(hostile, name), 1, f"hostile:{name}", *parts)


def test_some_aborted_episodes_are_counted_and_too_many_fail(hostile):
    done = assess(hostile, "Moody", "--kamikaze-count", "6", "--collision-runs", "30", "--json")
    result = json.loads(done.stdout)
    kind = result["aborted_reasons"]["process ended"]
    assert kind["count"] >= 3
    assert "exit code 7" in kind["first"]
    assert "hostile:Moody" in kind["first"]
    assert done.returncode == 1
    assert "episodes were aborted, more than --max-aborted 5 %" in done.stderr
    assert (hostile / "out" / "assessment.json").exists()
    allowed = assess(
        hostile,
        "Moody",
        "--kamikaze-count",
        "6",
        "--collision-runs",
        "30",
        "--max-aborted",
        "40",
        "--overwrite",
        "--details",
    )
    assert allowed.returncode == 0, allowed.stderr
    assert "aborted episodes: process ended" in allowed.stdout


def test_interrupt_does_not_wait_for_a_controller_that_ignores_sigterm(hostile):
    command = [sys.executable, "-m", "skd_evaluator", "assess", *SMALL, "--workers", "2", "--safe", "good.csv"]
    process = subprocess.Popen(
        [*command, "--knowledge", "nothing", "--controller", "hostile:Ignores"],
        cwd=hostile,
        env={**os.environ, "PYTHONPATH": str(hostile)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        wait_until((hostile / "ready").exists)
        process.send_signal(signal.SIGINT)
        assert process.wait(60.0) == 130
        assert "interrupted" in process.stderr.read()
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)


def test_commands_are_clipped_to_what_the_car_can_do_and_counted(hostile):
    for name, greatest in (("Strong", "-11.5"), ("Rocket", "11.5")):
        done = assess(hostile, name, "--overwrite", "--max-aborted", "100", "--details")
        assert "commands beyond what the car can do" in done.stdout
        assert "asked more than this car can do" in done.stderr
        assert greatest in done.stderr
        clipped = json.loads((hostile / "out" / "assessment.json").read_text())["commands_clipped"]
        assert clipped["commands"] >= clipped["episodes"] >= 1


# --- a pool whose workers fail


def _echo(item: int) -> int:
    if item == 13:
        os._exit(5)
    if item == 17:
        os.kill(os.getpid(), signal.SIGSTOP)
    return 2 * item


def _pid(_item: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def _killed_at_first(item: tuple[Path, int, int]) -> int:
    folder, number, deaths = item
    count = len(list(folder.iterdir()))
    if number == 21 and count < deaths:
        folder.joinpath(f"death-{count}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def _dies(_item: int) -> int:
    os._exit(5)


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(worker_pool, "HEARTBEAT_LIMIT", 2.0)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("bad", [13, 17])
def test_a_worker_that_dies_or_stops_is_replaced_and_costs_one_item(impatient, count, bad):
    items = [item for item in range(60) if item == bad or item not in (13, 17)]
    reasons = []
    with InProcessRunner(count, isolated=True) as runner:
        found = list(runner.map(_echo, items, lambda item, reason: (reasons.append(reason), -item)[1]))
    assert found == [-item if item == bad else 2 * item for item in items]
    (reason,) = reasons
    assert kind_of(reason) == (AbortKind.ENDED if bad == 13 else AbortKind.STOPPED)


@pytest.mark.parametrize("deaths", [1, 2, 3])
def test_an_item_whose_worker_somebody_else_ends_is_done_again_but_not_for_ever(tmp_path, deaths):
    reasons = []
    with InProcessRunner(2) as runner:
        items = [(tmp_path, item, deaths) for item in range(40)]
        found = list(runner.map(_killed_at_first, items, lambda item, reason: (reasons.append(reason), -1)[1]))
    assert len(list(tmp_path.iterdir())) == deaths
    expected = [2 * item for item in range(40)]
    if deaths == 3:
        expected[21] = -1
    assert found == expected
    assert ["SIGKILL" in reason for reason in reasons] == [True] * (deaths == 3)


def test_three_starts_in_a_row_that_fail_are_the_end():
    lost = []
    with InProcessRunner(1, isolated=True) as runner, pytest.raises(AssessmentError, match=r"3 starts .*exit code 5"):
        list(runner.map(_dies, range(10), lambda item, reason: lost.append(item)))
    assert len(lost) <= 3


def test_workers_that_are_left_in_the_middle_can_be_used_again():
    with InProcessRunner(2) as runner:
        begun = runner.map(_pid, range(40))
        next(begun)
        begun.close()
        assert list(runner.map(_echo, range(10))) == [2 * item for item in range(10)]


def test_several_threads_share_the_workers_and_each_gets_its_own_in_order():
    with InProcessRunner(2) as runner, ThreadPoolExecutor(3) as threads:
        runner.start()
        shares = [range(first, first + 400) for first in (100, 1000, 10_000)]
        found = list(threads.map(lambda share: list(runner.map(_echo, share)), shares))
    assert found == [[2 * item for item in share] for share in shares]


class Sleeper:
    def reset(self, scenario, rng):
        pass

    def command(self, car, adversary):
        if car.y > -16.0:
            time.sleep(1000.0)
        return 0.0


def test_an_answer_that_never_comes_aborts_its_episode(impatient):
    from test_campaign import straight

    plan = Plan(load_scenario("crossing"), controller=f"{__name__}:Sleeper", collision_runs=2)
    with InProcessRunner(2, answer_limit=1.0) as runner:
        runner.start()
        recorder = Recorder(runner)
        with pytest.raises(AssessmentError, match="no answer"):
            collision_runs(plan, [straight()] * 2, recorder) and collision_runs(plan, [straight()] * 2, recorder)
    assert all(log.outcome == Outcome.ABORTED for log in recorder.logs)


# --- reasons


def test_reasons_are_counted_by_their_kind():
    reasons = [
        abort_reason(AbortKind.NO_ANSWER, "nothing\nfor 5 s"),
        "vehicle_simulator: something else",
        abort_reason(AbortKind.NO_ANSWER, "nothing for 6 s"),
        "",
    ]
    assert reasons[0] == "no answer: nothing for 5 s"
    assert counted_reasons(reasons) == {
        "no answer": {"count": 2, "first": reasons[0]},
        "other": {"count": 2, "first": "vehicle_simulator: something else"},
    }
    assert counted_reasons([]) == {}
    for kind in AbortKind:
        assert kind_of(abort_reason(kind, "why")) == kind
