"""What a commanded speed means for the car."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from skd_sim.ros.commands import follow_speed
from skd_sim.world.dynamics.basic import CommandLimits

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
