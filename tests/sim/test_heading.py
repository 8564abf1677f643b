from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st
from skd_sim.world.state import heading_of, on_grid


@given(st.floats(-100.0, 100.0))
def test_a_heading_of_the_grid_survives_the_quaternion_to_the_last_bit(heading: float) -> None:
    kept = float(on_grid(heading))
    assert heading_of(math.sin(0.5 * kept), math.cos(0.5 * kept)) == kept
    assert -math.pi < kept <= math.pi
    assert abs(math.remainder(kept - heading, math.tau)) < 2e-12
    assert on_grid(kept) == kept
