"""A car that never drives, or stands far from everybody, is told from one that stops for somebody: by made-up runs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from skd_evaluator.campaign.judge.alone import doubts_of_standing_off
from skd_evaluator.measure.doubt import DISBELIEF
from skd_sim.encounter.road_user import Other, Waypoint
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.geometry.trajectory import Trajectory

CROSSING = load_scenario("crossing")
LIMIT = CROSSING.collision.hit_speed
STARTS = CROSSING.car.start_speed
FAR = STARTS * (0.5 * STARTS / 2.0) + 5.0
"""m: it stops at 2 m/s² in v/2 s at half of its speed in the mean, 5 m before somebody."""


def run(
    speeds: list[float], away: float = 100.0, outcome: Outcome = Outcome.MISSED, scenario=CROSSING, impact: float = 0.0
) -> EpisodeLog:
    """A run in which the front of the car is so far from somebody, aside and ahead, all the time."""
    direction = np.array([0.6, 0.8])
    car = np.column_stack([np.full(len(speeds), 1.5), np.linspace(-40.0, -30.0, len(speeds)), speeds])
    adversary = car[:, :2] + (away + scenario.car.front + scenario.adversary.reach) * direction
    episode = Episode(scenario, Mode.REPLAY, 1, 1, safe_trajectory=Trajectory(adversary, scenario.time_step))
    time = (len(speeds) - 1.5) * scenario.time_step
    return EpisodeLog(episode, outcome, adversary, car, time, impact, reason="failed: x")


STANDS, DRIVES = run([STARTS, 4.0, 0.0, 0.0]), run([STARTS, 4.0, 4.0, 4.0])


@pytest.mark.parametrize(
    ("log", "found"),
    [
        (run([0.0, 0.0, 0.0], away=1.0), True),  # never drives, however near
        (run([STARTS, 0.99 * LIMIT, 0.0]), True),
        (run([STARTS, LIMIT, LIMIT]), False),  # a hit begins at this speed
        (run([STARTS, 4.0, 0.0], away=FAR + 0.1), True),  # at the last tick
        (run([STARTS, 4.0, 0.0], away=FAR - 0.1), False),  # somebody may have made it stop
        (run([0.0, 0.0, 4.0, 4.0]), False),  # it had to start
        (run([0.0, 4.0, 0.0, 0.0]), True),  # and stands again
        (DRIVES, False),
        (run([STARTS, 0.0, 4.0, 4.0], outcome=Outcome.COLLISION, impact=4.0), False),  # it hit somebody after all
        (run([STARTS, 0.0, 0.0, 0.0], outcome=Outcome.COLLISION, impact=0.0), True),  # somebody ran into it
    ],
)
def test_who_stands_off(log: EpisodeLog, found: bool):
    assert len(doubts_of_standing_off("a.b:C", [log])) == found


@pytest.mark.parametrize("share", [0.8, 0.9, 1.0])
def test_nearly_all_runs_have_to_be_such(share: float):
    stands = round(share * 20)
    lines = doubts_of_standing_off("a.b:C", [DRIVES] * (20 - stands) + [STANDS] * stands)
    assert len(lines) == (share >= 0.9)
    for line in lines:
        assert line.startswith(f"{DISBELIEF}in {stands} of 20 runs along φ a.b:C was slower than {LIMIT:g} m/s")
        assert f"more than {FAR:.0f} m away" in line


def test_the_distance_goes_by_the_speed_at_which_the_car_starts():
    """From 20 m/s it takes 100 m to stop at 2 m/s²."""
    fast = replace(CROSSING, car=replace(CROSSING.car, start_speed=20.0))
    for away, found in ((104.9, 0), (105.1, 1)):
        assert len(doubts_of_standing_off("a.b:C", [run([20.0, 0.0, 0.0], away=away, scenario=fast)])) == found


def test_aborted_runs_say_nothing():
    aborted = replace(STANDS, outcome=Outcome.ABORTED)
    assert doubts_of_standing_off("a.b:C", []) == ()
    assert doubts_of_standing_off("a.b:C", [aborted] * 9) == ()
    assert doubts_of_standing_off("a.b:C", [aborted] * 9 + [DRIVES]) == ()
    (line,) = doubts_of_standing_off("a.b:C", [aborted, STANDS])
    assert "in 1 of 1 runs" in line


def other(away: float, length: float = 6.0) -> Other:
    """A lorry that at the third tick is so far from the front of the car, and 3 km away a second later."""
    car = STANDS.car[2]
    metres = CROSSING.car.front + away + 0.5 * math.hypot(length, 2.0)
    x, y = float(car[0]) - 0.6 * metres, float(car[1]) + 0.8 * metres
    time = 2 * CROSSING.time_step
    way = (Waypoint(0.0, x, y), Waypoint(time, x, y), Waypoint(time + 1.0, 3000.0, y))
    return Other(kind="lorry", length=length, width=2.0, way=way)


@pytest.mark.parametrize("speeds", [[STARTS, 4.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
@pytest.mark.parametrize(("away", "found"), [([FAR + 15], 1), ([FAR - 10], 0), ([200.0, FAR - 10], 0), ([1.0], 0)])
def test_a_car_may_have_to_stand_for_others_that_are_near(speeds: list[float], away: list[float], found: int):
    """The car of `run` goes 10 m: one that is near at the third tick was at most 7 m further at the first."""
    others = replace(CROSSING, others=tuple(map(other, away)))
    assert len(doubts_of_standing_off("a.b:C", [run(speeds, scenario=others)])) == found


@pytest.mark.parametrize(("away", "found"), [(FAR + 0.1, 1), (FAR - 0.1, 0)])
def test_others_count_where_they_are_as_the_car_begins_to_stand(away: float, found: int):
    log = run([STARTS, 4.0, 0.0, 0.0], scenario=replace(CROSSING, others=(other(away),)))
    assert len(doubts_of_standing_off("a.b:C", [log])) == found


def test_the_distance_is_that_of_the_moment_from_which_the_car_stands():
    """Whoever comes up to a car that stands already has not made it stop."""
    log = run([STARTS, 4.0, 0.0, 0.0, 0.0])
    near = log.adversary.copy()
    near[3:] = log.car[3:, :2] + [0.0, CROSSING.car.front + 1.0]
    assert len(doubts_of_standing_off("a.b:C", [replace(log, adversary=near)])) == 1
    near = log.adversary.copy()
    near[2] = log.car[2, :2] + [0.0, CROSSING.car.front + 1.0]
    assert doubts_of_standing_off("a.b:C", [replace(log, adversary=near)]) == ()
    away = math.dist(log.adversary[2], log.car[2, :2]) - CROSSING.adversary.reach
    assert math.isclose(away, 100.0 + CROSSING.car.front)
