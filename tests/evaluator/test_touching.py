"""By how much time a hit is missed, against what follows from a car's braking."""

from __future__ import annotations

import math

import numpy as np
import pytest
from skd_evaluator.risk.crossings import CREEPING, IN_A_CURVE, SAME, missed_by, side_touched

FOOTPRINT, RADIUS, HIT_SPEED, STEP = (2.25, 2.25, 0.9), 0.25, 0.556, 0.05


def missed(car: np.ndarray, user: np.ndarray) -> float:
    """Least over an episode, of places along North and speeds of the car, and places of somebody."""
    least = math.inf
    for tick in range(len(car) - 1):
        path = np.array([[0.0, car[tick + end, 0], 0.5 * math.pi, car[tick + end, 1]] for end in (0, 1)])
        here, there = tuple(user[tick]), tuple(user[tick + 1])
        least = min(least, missed_by(path, here, there, 1.0, FOOTPRINT, RADIUS, HIT_SPEED, STEP))
    return least


@pytest.mark.parametrize("short", [0.02, 0.1, 0.5, 2.0])
@pytest.mark.parametrize("deceleration", [3.0, 8.0])
def test_of_a_car_that_brakes_it_follows_from_where_it_would_come_to_the_speed_of_a_hit(short, deceleration):
    """(m + (x² + 2·h·x)/2b) / max(x, c) over x = v − h: √(2m/b) + h/b at x = √(2bm), where that is c or more; m/c at 0.

    Near 0 it is looked at up to a quarter of a tick before.
    """
    speeds = np.maximum(8.0 - deceleration * STEP * np.arange(80), 0.0)
    places = np.concatenate([[0.0], np.cumsum(0.5 * STEP * (speeds[1:] + speeds[:-1]))])
    there = (8.0**2 - HIT_SPEED**2) / (2.0 * deceleration) + FOOTPRINT[0] + RADIUS + short
    found = missed(np.column_stack([places, speeds]), np.tile([0.3, there], (80, 1)))
    creeps = short / CREEPING
    if math.sqrt(2.0 * deceleration * short) >= CREEPING:
        drives = math.sqrt(2.0 * short / deceleration) + HIT_SPEED / deceleration
        if drives < creeps:
            assert found == pytest.approx(drives, rel=0.03)
            return
    before = deceleration * STEP / 4.0
    late = (before**2 + 2.0 * HIT_SPEED * before) / (2.0 * deceleration * CREEPING)
    assert creeps <= found <= 1.03 * creeps + late


def test_whoever_stands_beside_the_way_is_further_from_a_hit_than_whoever_walks_into_it():
    places = 5.0 * STEP * np.arange(40)
    car = np.column_stack([places, np.full(40, 5.0)])
    stands = np.tile([1.5, 6.0], (40, 1))
    comes = stands - np.column_stack([1.5 * STEP * (np.arange(40) - 15.0), np.zeros(40)])
    goes = stands + np.column_stack([1.5 * STEP * np.arange(40), np.zeros(40)])
    assert missed(car, comes) < 0.5 < missed(car, stands)
    assert missed(car, goes) > 0.5
    assert missed(np.column_stack([places, np.full(40, 0.5)]), stands) == math.inf  # too slow for a hit


FRONT, ELSEWHERE, NO_HIT = 1, 2, 3


@pytest.mark.parametrize(
    ("footprint", "place", "counts"),
    [
        ((2.25, 2.25, 0.9), (0.3, 2.5), FRONT),
        ((2.25, 2.25, 0.9), (1.1, 2.4), FRONT),  # 0.25 from a corner
        ((2.25, 2.25, 0.9), (-1.1, 2.4), FRONT),
        ((2.25, 2.25, 0.9), (1.15, 2.2), ELSEWHERE),
        ((2.25, 2.25, 0.9), (-1.15, 1.0), ELSEWHERE),
        ((2.25, 2.25, 0.9), (0.3, -2.5), ELSEWHERE),
        ((3.5, 1.0, 0.9), (1.1, 3.65), FRONT),
        ((3.5, 1.0, 0.9), (1.1, -1.15), ELSEWHERE),
        ((1.0, 3.5, 0.9), (0.0, 1.25), FRONT),
        ((1.0, 3.5, 0.9), (0.0, -3.75), ELSEWHERE),
    ],
)
@pytest.mark.parametrize(("impact", "hits"), [(5.0, True), (HIT_SPEED, True), (0.999 * HIT_SPEED, False)])
def test_a_touch_counts_by_its_side_and_by_the_speed(footprint, place, counts, impact, hits):
    right, ahead = place
    for same in (SAME, IN_A_CURVE):
        found = side_touched(ahead, -right, footprint, RADIUS, impact, HIT_SPEED, same)
        assert found == (counts if hits else NO_HIT)


@pytest.mark.parametrize(
    ("ahead", "left", "exactly", "in_a_curve"),
    [
        (2.2, 1.1499, FRONT, ELSEWHERE),  # nothing but a side is there, a tenth of a millimetre off
        (2.2, -1.1499, FRONT, ELSEWHERE),
        (2.26, 1.1499, FRONT, FRONT),  # at a corner
        (2.2, 1.13, FRONT, FRONT),  # too deep to have just touched a side
        (2.26, 1.15, ELSEWHERE, ELSEWHERE),
    ],
)
def test_in_a_curve_who_is_not_ahead_of_the_front_touches_a_side(ahead, left, exactly, in_a_curve):
    for same, wanted in ((SAME, exactly), (IN_A_CURVE, in_a_curve)):
        assert side_touched(ahead, left, FOOTPRINT, RADIUS, 5.0, HIT_SPEED, same) == wanted
