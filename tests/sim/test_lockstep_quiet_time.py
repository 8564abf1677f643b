"""Lockstep with a car that only follows the clock: a period is over when it has been quiet for a while."""

from __future__ import annotations

import pytest
from lockstep_bench import START, Bench, stamp
from skd_sim.ros.lockstep import LEAD, ControlStep, End, Repeat
from skd_sim.world.episode import AbortKind, kind_of

QUIET = 0.02


@pytest.fixture
def quiet() -> Bench:
    made = Bench(quiet_time=QUIET)
    assert made.begin() is None
    return made


def test_with_a_quiet_time_a_period_is_over_when_the_car_has_spoken(quiet: Bench) -> None:
    now = quiet.now + 1.0
    assert quiet.lockstep.drive(stamp(0), 1.0, now=now) is None
    assert quiet.lockstep.drive(stamp(0), 2.0, now=now) is None  # the last word counts, and no second one is a fault
    assert quiet.lockstep.walk(stamp(0), (2.0, 0.0), now=now) == ControlStep(2.0, (2.0, 0.0))
    assert quiet.advance(1) is None
    assert quiet.lockstep.walk(stamp(1), (2.0, 1.0), now=now) is None
    assert quiet.lockstep.drive(stamp(0), 3.0, now=now) is None  # too late for tick 0, and no answer to tick 1 …
    assert quiet.lockstep.quiet(now) == ControlStep(3.0, (2.0, 1.0))  # … but the newest word when the time is over
    assert quiet.advance(2) is None
    assert quiet.lockstep.drive(None, 4.0, now=now) is None
    assert quiet.lockstep.walk(stamp(2), (0.0, 1.0), now=now) == ControlStep(4.0, (0.0, 1.0))
    assert quiet.lockstep.ages.held == 0


def test_when_the_quiet_time_is_over_the_last_command_is_held(quiet: Bench) -> None:
    now = quiet.now + 1.0
    assert quiet.lockstep.quiet(now) is None  # nothing to hold yet
    assert quiet.lockstep.drive(stamp(0), 1.0, now=now) is None
    assert isinstance(quiet.lockstep.walk(stamp(0), (2.0, 0.0), now=now), ControlStep)
    assert quiet.advance(1) is None
    assert quiet.lockstep.quiet(now) is None  # the adversary is waited for, as ever
    assert quiet.lockstep.walk(stamp(1), (2.0, 1.0), now=now) == ControlStep(1.0, (2.0, 1.0))
    assert quiet.advance(2) is None
    assert quiet.lockstep.walk(stamp(2), (2.0, 2.0), now=now) is None
    assert quiet.lockstep.quiet(now) == ControlStep(1.0, (2.0, 2.0))
    assert quiet.lockstep.ages.held == 2


def test_commands_of_the_last_episode_do_not_drive_this_one(quiet: Bench) -> None:
    soon, later = quiet.now + 0.5 * QUIET, quiet.now + 2.0 * QUIET
    assert quiet.lockstep.walk(stamp(0), (2.0, 0.0), now=soon) is None
    assert quiet.lockstep.drive(START - LEAD - 1, 9.0, now=later) is None
    assert quiet.lockstep.drive(None, 9.0, now=soon) is None  # it may have been under way
    assert quiet.lockstep.drive(0, 9.0, now=soon) is None  # as is one whose stamp says nothing
    assert quiet.lockstep.quiet(later) is None
    assert quiet.lockstep.drive(START - LEAD, 1.0, now=later) == ControlStep(1.0, (2.0, 0.0))


def test_the_clock_comes_nearer_while_a_car_that_is_there_has_nothing_to_say(quiet: Bench) -> None:
    """For it may decide by a timer, and its timer by the clock; one that is not there yet would miss it."""
    leads = [quiet.lockstep.lead]
    quiet.cars.alive = []
    quiet.now += 0.3
    assert quiet.lockstep.watch(quiet.now) == Repeat()
    assert quiet.lockstep.lead == leads[0] == LEAD
    quiet.cars.alive = ["/one"]
    for _ in range(12):
        quiet.now += 0.3
        assert quiet.lockstep.watch(quiet.now) == Repeat()
        leads.append(quiet.lockstep.lead)
    assert leads == sorted(leads, reverse=True)
    assert len(set(leads)) == 10
    assert leads[-1] == 0
    quiet.lockstep.walk(stamp(0), (2.0, 0.0))
    assert isinstance(quiet.lockstep.drive(START - 5, 1.0, now=quiet.now), ControlStep)
    assert quiet.advance(1) is None
    assert quiet.lockstep.lead == 0


def test_a_car_that_follows_the_clock_and_is_gone_ends_the_episode(quiet: Bench) -> None:
    quiet.lockstep.walk(stamp(0), (2.0, 0.0))
    quiet.lockstep.drive(stamp(0), 1.0, now=quiet.now)
    quiet.advance(1)
    quiet.now += 100.0
    quiet.lockstep.walk(stamp(1), (2.0, 0.0))
    quiet.cars.alive = []
    end = quiet.lockstep.watch(quiet.now)
    assert isinstance(end, End)
    assert kind_of(end.reason) == AbortKind.ENDED
