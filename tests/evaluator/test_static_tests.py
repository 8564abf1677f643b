"""A regulator's static tests against the closed form of a car with textbook braking."""

import dataclasses
import math

import numpy as np
import pytest
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.scenario.protocol import regulatory_trajectories
from skd_sim.scenario.scenario import Scenario, changed_scenario
from skd_sim.world.state import AdversaryState, CarState
from static_support import StaticRun, static_tests

PERIOD = 0.01  # s between two decisions
KMH = 1.0 / 3.6
VRU_SPEEDS, ALONG_SPEEDS = (10, 20, 30, 40, 50, 60), (30, 40, 50, 60, 70, 80)
# Of each test: its speeds, and of its target the speed (m/s), the reach across the lane and towards the car (m), how it
# goes: −1 to the left, 1 to the right, 0 along; as Euro NCAP has them, and not as the scenarios' files do.
CROSSING = {
    "cpna": (VRU_SPEEDS, 5 * KMH, 0.25, 0.25, -1),
    "cpfa": (VRU_SPEEDS, 8 * KMH, 0.25, 0.25, 1),
    "cpnco": (VRU_SPEEDS, 5 * KMH, 0.25, 0.25, -1),
    "cbna": (VRU_SPEEDS, 15 * KMH, 0.945, 0.25, -1),
    "cbnao": (VRU_SPEEDS, 10 * KMH, 0.945, 0.25, -1),
    "cbfa": (VRU_SPEEDS, 20 * KMH, 0.945, 0.25, 1),
}
TURNING = {
    **{f"cpta{kind}": (10, 15, 20) for kind in ("fs", "fo", "ns", "no")},
    **{f"cbta{kind}": (10, 15, 20) for kind in ("fs", "fo", "ns", "no")},
    "cmcscp": (20, 50, 80),
    "cccscp": (20, 50, 80),
}
ALONG = {
    "cpla": ((20, 30, 40, 50, 60, 80), 5 * KMH, 0.25),
    "cbla": ((20, 30, 40, 50, 60, 80), 15 * KMH, 0.945),
    "ccrs": ((10, 20, 30, 40, 50, 80), 0.0, 2.0115),
    "ccrm": (ALONG_SPEEDS, 20 * KMH, 2.0115),
    "cmrs": ((10, 20, 30, 40, 50, 80), 0.0, 1.04),
    "ccfhos": ((30, 40, 50, 60, 70, 80, 90, 100), -50 * KMH, 2.0115),
}
HALF_WIDTH = 0.9  # m, of the car


class Textbook:
    """Brakes at a constant rate from a time on, until it stands."""

    control_period = PERIOD

    def __init__(self, begins: float, deceleration: float) -> None:
        self.begins, self.deceleration = begins, deceleration

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self.tick = 0

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        self.tick += 1
        return -self.deceleration if (self.tick - 1) * PERIOD >= self.begins - 1e-9 else 0.0


def static_tests_of(name: str, kmh: float, *, begins: float = math.inf, deceleration: float = 6.0) -> list[StaticRun]:
    scenario = changed_scenario(name, {"car.start_speed": kmh * KMH})
    clocked = dataclasses.replace(scenario, control_period=PERIOD)
    return static_tests(clocked, CarUnderTest("basic"), Textbook(begins, deceleration))


def driven(speed: float, begins: float, deceleration: float, time: float) -> float:
    """How far a car has got that brakes from a time on."""
    braking = min(max(0.0, time - begins), speed / deceleration)
    return speed * min(time, begins) + speed * braking - 0.5 * deceleration * braking**2


UNBRAKED = {
    **{name: (speeds, None) for name, (speeds, *_) in CROSSING.items()},
    **{name: (speeds, None) for name, speeds in TURNING.items()},
    **{name: ([one for one in speeds if one * KMH > target], 4.65) for name, (speeds, target, _) in ALONG.items()},
    "ccfhol": ((30, 50, 100), 5.15),
}
"""Speeds, and when (s) who is in the lane is met: 1.5 s before 3 s, or the end of the change, and half of a tick."""


@pytest.mark.parametrize("name", UNBRAKED)
def test_unbraked_the_target_is_met_at_its_impact_place(name: str) -> None:
    speeds, time = UNBRAKED[name]
    for kmh in (speeds[0], speeds[-1]):
        for one in static_tests_of(name, kmh):
            assert one.touched
            assert one.impact_place == pytest.approx(one.place, abs=1.0)
            assert one.impact_speed == pytest.approx(kmh * KMH)
            assert time is None or one.log.impact_time == pytest.approx(time, abs=0.01)


# Curvature (1/m) and length (m) of the parts of the target's path at 50 and at 70 km/h: Vector's OSC-NCAP-scenarios,
# TrajectoryCatalog.xosc, GVT_CCFhol_50 and GVT_CCFhol_70.
PUBLISHED = {
    50: ((0.008, 15), (0.006, 1), (0.001, 1), (0, 10), (-0.006, 1), (-0.008, 15)),
    70: ((0.004, 24), (0.001, 1), (0, 10), (-0.001, 1), (-0.004, 24)),
}


def published_path(kmh: int) -> np.ndarray:
    """Places along and across the lane, m, every centimetre of a published path."""
    curvature = np.concatenate([np.full(100 * length, bent) for bent, length in PUBLISHED[kmh]])
    heading = 0.01 * np.cumsum(curvature)
    return 0.01 * np.column_stack([np.cumsum(np.cos(heading)), np.cumsum(np.sin(heading))])


@pytest.mark.parametrize("kmh", PUBLISHED)
def test_who_changes_lanes_goes_as_the_published_path_does(kmh: int) -> None:
    """Within 0.15 m: at 70 km/h a sixth of that path is straight, of ours a fifth, and ours is 1.6 m longer."""
    changes = {"car.start_speed": kmh * KMH, "protocol.speed": kmh * KMH, "time_step": 0.01}
    scenario = changed_scenario("ccfhol-50", changes)
    (way,) = regulatory_trajectories(scenario)
    ends = 5.15 - 1.5  # s, of the change: 5 s, and half of a tick's range, less the time to collision
    last = round(ends / 0.01)
    middle = way.positions[: last + 1] - way.positions[last]
    theirs = published_path(kmh)
    theirs = theirs - theirs[-1]
    for along, across in theirs[::100]:
        ours = float(np.interp(along, -middle[:, 1], middle[:, 0]))
        assert ours == pytest.approx(across, abs=0.15)
    steps = np.hypot(*np.diff(way.positions, axis=0).T) / 0.01
    assert steps == pytest.approx(kmh * KMH, rel=1e-4)
    assert way.positions[last:, 0] == pytest.approx(0.0, abs=1e-9)
    begins = max(0, round((ends - 3.168) / 0.01))
    assert way.positions[begins, 0] == pytest.approx(-3.5, abs=1e-4)


@pytest.mark.parametrize("name", CROSSING)
def test_impact_speeds_of_textbook_braking_where_the_target_crosses(name: str) -> None:
    """v² − 2·a·d, where the target is still in the way when the front is there; else it is missed."""
    speeds, target, across, along, _ = CROSSING[name]
    touched = 0
    for kmh in speeds[::2]:
        for deceleration, before in ((3.0, 0.8), (6.0, 1.0), (9.0, 0.4)):
            speed, meeting = kmh * KMH, 4.65 - along / (kmh * KMH)
            begins = round((meeting - before) / PERIOD) * PERIOD
            left = speed * 4.65 - along - speed * begins  # m to the target's way when it begins to brake
            squared = speed**2 - 2.0 * deceleration * left
            for one in static_tests_of(name, kmh, begins=begins, deceleration=deceleration):
                if squared <= 0.0:
                    assert not one.touched or one.impact_speed < 0.1
                    continue
                later = begins + (speed - math.sqrt(squared)) / deceleration - meeting
                offset = (one.place / 100.0 - 0.5) * 2.0 * HALF_WIDTH + target * later  # m, the way the target goes
                if abs(offset) <= HALF_WIDTH + (across if along != across else 0.0) - 0.01:
                    assert one.touched
                    assert one.impact_speed == pytest.approx(math.sqrt(squared), abs=0.1)
                    touched += 1
    assert touched > 10


@pytest.mark.parametrize("name", ALONG)
def test_impact_speeds_of_textbook_braking_where_the_target_keeps_to_the_lane(name: str) -> None:
    """The speed relative to the target: (v − v′)² − 2·a·d."""
    speeds, target, _ = ALONG[name]
    for kmh in speeds[::3]:
        for deceleration, before in ((3.0, 0.8), (6.0, 1.0), (9.0, 0.4)):
            speed, closing = kmh * KMH, kmh * KMH - target
            if closing <= 0.0:
                continue
            begins = round((4.65 - before) / PERIOD) * PERIOD
            squared = closing**2 - 2.0 * deceleration * closing * (4.65 - begins)
            stands = speed - deceleration * (closing - math.sqrt(max(0.0, squared))) / deceleration < 0.0
            for one in static_tests_of(name, kmh, begins=begins, deceleration=deceleration):
                if target < 0.0 and stands:
                    continue  # somebody drives into the car that stands
                if squared <= 0.0:
                    assert not one.touched or one.impact_speed < target + 0.3
                    continue
                assert one.touched
                assert one.impact_speed == pytest.approx(math.sqrt(squared) + target, abs=0.1)


@pytest.mark.parametrize("name", ["ccrb", "cmrb"])
def test_a_target_that_brakes_is_met_where_two_parabolas_meet(name: str) -> None:
    """Both brake from the same speed, 1 s apart: at 4 m/s² after 3 s, and as hard 1.2 s later or not at all."""
    for kmh in (30, 130):
        speed = kmh * KMH
        for begins in (math.inf, 4.2):
            times = np.arange(0.0, 12.0, 1e-3)
            gaps = np.array([speed + driven(speed, 3.0, 4.0, t) - driven(speed, begins, 4.0, t) for t in times])
            reached = np.flatnonzero(gaps <= 0.0)
            for one in static_tests_of(name, kmh, begins=begins, deceleration=4.0):
                assert one.touched == bool(len(reached))
                if len(reached):
                    at = float(times[reached[0]])
                    slowed = 4.0 * min(max(0.0, at - begins), speed / 4.0)
                    assert one.impact_speed == pytest.approx(speed - slowed, abs=0.1)
                    assert one.impact_place == pytest.approx(one.place, abs=1.0)
