"""Real time in lockstep's place: the simulator does not wait, and what was said last holds."""

from __future__ import annotations

import pytest
from lockstep_bench import START, Bench, stamp
from skd_sim.ros.lockstep import LEAD, ControlStep, End, Repeat, Start


@pytest.fixture
def real_time() -> Bench:
    made = Bench(real_time=True)
    assert made.begin() is None
    return made


def test_real_time_starts_once_and_holds_what_came_last(real_time: Bench) -> None:
    lockstep = real_time.lockstep
    assert lockstep.go_on() is None
    assert lockstep.drive(stamp(0), 1.0) is None
    assert lockstep.drive(stamp(0), 2.0) is None  # no contradiction: the last one counts
    assert lockstep.walk(stamp(5) + 1, (1.0, 0.0)) == Start()
    for tick in range(1, 4):
        assert lockstep.go_on() == ControlStep(2.0, (1.0, 0.0))
        assert real_time.advance(tick) is None
    assert lockstep.walk(stamp(2), (0.0, 1.0)) is None
    assert lockstep.drive(START - 1, 9.0) is None
    assert lockstep.go_on() == ControlStep(2.0, (0.0, 1.0))


def test_in_real_time_a_stamp_that_nobody_set_means_now(real_time: Bench) -> None:
    real_time.lockstep.walk(stamp(0), (1.0, 0.0))
    assert real_time.lockstep.drive(1, 1.0) is None  # one that somebody set, long ago
    assert real_time.lockstep.drive(0, 2.0) == Start()
    assert real_time.lockstep.go_on() == ControlStep(2.0, (1.0, 0.0))


def test_the_clock_begins_before_the_episode(real_time: Bench) -> None:
    """So a car that decides by a timer speaks before the first tick, and what it says then counts."""
    real_time.cars.alive = ["/one"]
    assert real_time.lockstep.lead == LEAD
    real_time.now += 0.3
    assert real_time.lockstep.watch(real_time.now) == Repeat()
    assert 0 < real_time.lockstep.lead < LEAD
    real_time.lockstep.walk(stamp(0), (1.0, 0.0))
    assert real_time.lockstep.drive(START - LEAD - 1, 9.0) is None  # of the episode before
    assert real_time.lockstep.drive(START - LEAD, 2.0) == Start()
    assert real_time.lockstep.go_on() == ControlStep(2.0, (1.0, 0.0))
    assert real_time.advance(1) is None
    assert real_time.lockstep.lead == 0


def test_in_real_time_only_who_is_gone_is_missed(real_time: Bench) -> None:
    real_time.lockstep.drive(stamp(0), 1.0)
    real_time.lockstep.walk(stamp(0), (1.0, 0.0))
    assert real_time.lockstep.watch(real_time.now + 1e6) is None
    real_time.cars.alive = []
    end = real_time.lockstep.watch(real_time.now + 1e6)
    assert isinstance(end, End)
    assert end.reason == "process ended: the car controller (publisher of ego/acceleration_command) is gone"
