"""Commands: how old they are, and speed targets."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim.ros.commands import follow_speed
from skd_sim.world.dynamics.basic import CommandLimits
from skd_sim.world.timing import CommandAges, Schedule

STEP = 100  # ns of simulation time between states


def test_a_command_is_as_old_as_the_state_that_it_names() -> None:
    ages = CommandAges(waited_for=False)
    for tick in range(3):
        ages.publish(tick * STEP, 10.0 + tick)
    ages.come(STEP, 12.1)
    ages.use(12.5)
    ages.come(2 * STEP - 1, 12.6)  # between two states: it knows the earlier one
    ages.use(13.5)
    ages.use(14.5)  # no other has come
    ages.come(None, 15.4)  # it does not say, so it is as old as its arrival
    ages.use(15.5)
    ages.come(10**18, 16.3)  # of another clock
    ages.use(16.5)
    ages.come(-1, 17.2)  # of before the episode
    ages.use(17.5)
    assert ages.ages == pytest.approx([1.5, 2.5, 3.5, 0.1, 0.2, 0.3])
    assert ages.held == 1
    ages.begin()
    assert (ages.ages, ages.held) == ([], 0)


def test_who_waits_sees_how_long_the_answer_takes() -> None:
    """However long the other side needs then; a repeated state counts from its repetition on."""
    ages = CommandAges(waited_for=True)
    ages.publish(0, 1.0)
    ages.publish(0, 1.2)
    ages.come(0, 1.25)
    ages.use(9.0)
    ages.publish(STEP, 9.0)
    ages.come(None, 9.4)
    ages.use(9.5)
    ages.publish(2 * STEP, 9.5)
    ages.use(9.7)  # the quiet time is over
    assert ages.ages == pytest.approx([0.05, 0.4, 0.7])
    assert ages.held == 1


def test_a_schedule_goes_on_from_where_it_is() -> None:
    """Timers leave out what they have missed: 3.5 periods late at once is late once."""
    schedule = Schedule(0.0, 1.0)
    assert schedule.late(1.0) == 0.0
    assert schedule.late(5.5) == 3.5
    assert schedule.late(6.0) == 0.0
    assert schedule.late(6.9) == pytest.approx(-0.1)  # a timer may wake early
    assert schedule.worst == 3.5
    assert math.isfinite(schedule.late(8.0))


BOUNDS = CommandLimits(-8.0, 3.0)
SPEEDS = st.floats(0.0, 40.0)


@given(target=SPEEDS, speed=SPEEDS, duration=st.floats(0.01, 1.0), limit=st.floats(0.0, 20.0))
def test_a_speed_target_is_reached_as_soon_as_all_limits_allow(target, speed, duration, limit):
    """Its own limit is a magnitude, of decelerations too, and none where it is zero."""
    acceleration = follow_speed(target, speed, duration, BOUNDS, limit)
    greatest = min(3.0, limit or 3.0) if target > speed else min(8.0, limit or 8.0)
    after = speed + acceleration * duration
    assert abs(acceleration) <= greatest
    if abs(target - speed) <= greatest * duration:
        assert abs(after - target) <= 1e-9 * max(1.0, target, speed)
    else:
        assert abs(acceleration) == greatest
        assert (acceleration > 0.0) == (target > speed)
