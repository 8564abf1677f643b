"""Where the process of a controller runs: beside whoever asks it if it answers quickly, else where it likes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator

import pytest
from skd_sim.apart import nearby
from skd_sim.apart.nearby import Nearby

pytestmark = pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity") or len(os.sched_getaffinity(0)) < 2, reason="this takes Linux, two processors"
)


@pytest.fixture
def process() -> Iterator[int]:
    waiting = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    yield waiting.pid
    waiting.communicate()


class Clock:
    """A clock that is moved by hand, s."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(nearby, "time", made)
    return made


def ask(one: Nearby, clock: Clock, seconds: float, times: int = 1) -> set[int]:
    """Return on which processors this thread may run while it waits for the last answer."""
    mine: set[int] = set()
    for _ in range(times):
        one.begin_waiting()
        mine = os.sched_getaffinity(0)
        clock.now += seconds
        one.end_waiting()
    return mine


def test_who_answers_quickly_is_where_it_is_asked(process: int, clock: Clock) -> None:
    everywhere = os.sched_getaffinity(0)
    one = Nearby(process)
    assert ask(one, clock, 2e-5, times=256) == everywhere
    assert os.sched_getaffinity(process) == everywhere, "threads that it starts first may go anywhere"
    bound = ask(one, clock, 2e-5)
    assert len(bound) == 1
    assert os.sched_getaffinity(process) == bound
    assert os.sched_getaffinity(0) == everywhere, "who asks is free again"


def test_it_follows_who_asks(process: int, clock: Clock) -> None:
    everywhere = os.sched_getaffinity(0)
    one = Nearby(process)
    ask(one, clock, 2e-5, times=256)
    try:
        for processor in sorted(everywhere)[:2] * 2:
            os.sched_setaffinity(0, {processor})
            assert ask(one, clock, 2e-5) == os.sched_getaffinity(process) == {processor}
    finally:
        os.sched_setaffinity(0, everywhere)


def test_who_takes_long_goes_where_it_likes(process: int, clock: Clock) -> None:
    everywhere = os.sched_getaffinity(0)
    one = Nearby(process)
    ask(one, clock, 2e-5, times=512)
    assert len(os.sched_getaffinity(process)) == 1
    assert ask(one, clock, 2e-3, times=257) == everywhere
    assert os.sched_getaffinity(process) == everywhere


def test_a_process_that_has_ended_is_left_alone(clock: Clock) -> None:
    everywhere = os.sched_getaffinity(0)
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    one = Nearby(ended.pid)
    for _ in range(4):
        ask(one, clock, 2e-5, times=256)
    assert os.sched_getaffinity(0) == everywhere
