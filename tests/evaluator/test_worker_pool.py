"""A pool whose workers die, stop or fall silent: each is replaced, and costs one item at most."""

from __future__ import annotations

import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from skd_evaluator.campaign.run import worker_pool
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.errors import AssessmentError
from skd_sim.episode.aborts import AbortKind, abort_reason, counted_reasons, kind_of


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


_OTHERS = ("HUP", "KILL", "TERM")
_FAULTS = ("SYS", "TRAP")  # those that need no dump of a stack


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
