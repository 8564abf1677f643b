"""The colour of one test, by what Euro NCAP's 2026 matrices go by.

Source: Euro NCAP, Crash Avoidance - Frontal Collisions v1.2, section 5.2, as its calculator has it
(`euroncap-rating-2026` 5.4.9: `measured_color`, to which the tolerance of a verification test does not apply). A speed
reduction of more than 30 km/h is red there; so it is here.
"""

from __future__ import annotations

import math
from typing import Final

from skd_evaluator.extensions.ncap.matrices import Criterion

GREEN, YELLOW, ORANGE, BROWN, RED = COLOURS = ("green", "yellow", "orange", "brown", "red")
ROOM: Final = 0.5
"""m, the margin below which a green test stands out, unless something else is asked for."""
_BELOW: Final = {  # by test speed, km/h: the relative impact speed (km/h) below which a test that hit has a colour
    10.0: (),
    20.0: (),
    30.0: ((10.0, BROWN),),
    40.0: ((10.0, ORANGE), (20.0, BROWN)),
    50.0: ((10.0, YELLOW), (20.0, ORANGE), (30.0, BROWN)),
}
_REDUCTIONS: Final = ((10.0, RED), (20.0, ORANGE), (30.0, GREEN), (math.inf, RED))


def colour_of(criterion: Criterion, speed: float, value: float) -> str:
    """Return the colour of a test.

    Args:
        criterion: what it goes by.
        speed: test speed, km/h.
        value: of the criterion, km/h; without a contact an impact speed of 0.

    Raises:
        ValueError: the criterion has no colours at this test speed.
    """
    if criterion is Criterion.REDUCTION:
        return next(name for most, name in _REDUCTIONS if value <= most)
    if value <= 0.0:
        return GREEN
    if criterion is Criterion.IMPACT:
        return RED
    bands = _BELOW.get(min(speed, max(_BELOW)))
    if bands is None:
        raise ValueError(f"there are no colours at {speed:g} km/h")
    return next((name for most, name in bands if value < most), RED)
