"""Parked rectangles block the ways of the adversary, and stand clear of the car's path."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Obstacle, Scenario, check_trajectory, load_scenario, scenario_from_dict
from skd_sim.world.contact import clearance, runs_into
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, Trajectory

CROSSING = load_scenario("crossing")
PARKED = Obstacle(-2.6, -3.0, math.pi / 2, 4.3, 1.8)
COORDINATE = st.floats(-6.0, 6.0)


def with_obstacles(*obstacles: Obstacle, name: str = "crossing") -> Scenario:
    data = load_scenario(name).as_dict()
    keys = ("x", "y", "heading", "length", "width")
    return scenario_from_dict({**data, "obstacles": [{key: getattr(one, key) for key in keys} for one in obstacles]})


def distance_to_polygon(corners: np.ndarray, x: float, y: float) -> float:
    """Of a point to a convex polygon, edge by edge; 0 inside."""
    inside, nearest = True, math.inf
    for begin, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        edge, away = end - begin, np.array([x, y]) - begin
        inside &= edge[0] * away[1] - edge[1] * away[0] >= 0.0
        share = min(1.0, max(0.0, float(edge @ away) / float(edge @ edge)))
        nearest = min(nearest, float(np.hypot(*(away - share * edge))))
    return 0.0 if inside else nearest


@given(COORDINATE, COORDINATE, COORDINATE, COORDINATE, st.floats(-3.0, 3.0), st.floats(0.1, 8.0), st.floats(0.1, 3.0))
def test_a_step_into_a_rectangle_is_one_whose_points_come_too_near(x, y, x_after, y_after, heading, length, width):
    parked = Obstacle(0.5, -0.5, heading, length, width)
    rectangles = replace(CROSSING, obstacles=(parked,)).rectangles
    shares = np.linspace(0.0, 1.0, 400)
    least = min(distance_to_polygon(parked.corners, x + s * (x_after - x), y + s * (y_after - y)) for s in shares)
    spacing = math.hypot(x_after - x, y_after - y) / 399
    for radius in (0.05, 0.3, 1.0):
        found = runs_into(rectangles, x, y, x_after, y_after, radius)
        if least < radius - 1e-9:
            assert found
        if least > radius + spacing:
            assert not found
    assert clearance(rectangles, x, y) == pytest.approx(distance_to_polygon(parked.corners, x, y), abs=1e-9)


def test_who_runs_into_one_has_missed_but_a_replay_goes_on() -> None:
    scenario = with_obstacles(PARKED)
    inside = AdversaryState(-3.0, -0.7, 0.0, -1.4)
    before = AdversaryState(-3.0, -0.7 + 1.4 * scenario.time_step, 0.0, -1.4)
    phi = Trajectory(np.array([(-5.0, 1.0), (5.0, 1.0)]), scenario.time_step)
    for mode in Mode:
        episode = EpisodeSpec(scenario, mode, 0, 0, safe_trajectory=None if mode == Mode.SAFE else phi)
        over = Outcome.RUNNING if mode == Mode.REPLAY else Outcome.MISSED
        assert episode.outcome(1, inside, collided=False) == (over if mode != Mode.REPLAY else Outcome.ARRIVED)
        if mode != Mode.REPLAY:
            assert episode.outcome(1, before, collided=False) == Outcome.RUNNING
        assert episode.outcome(1, inside, collided=True) == Outcome.COLLISION


@pytest.mark.parametrize(
    ("obstacle", "said"),
    [
        (Obstacle(0.0, 20.0, 0.0, 1.0, 1.0), "obstacles[1] stands in the car's path: it comes within 0.05 m"),
        (Obstacle(-1.9, -10.0, 0.0, 2.2, 1.0), "obstacles[1] stands in the car's path: it comes within 0.80 m"),
        (Obstacle(1.9, -10.0, math.pi, 2.2, 1.0), "obstacles[1] stands in the car's path: it comes within 0.80 m"),
        (Obstacle(0.0, -30.0, 0.0, 30.0, 0.2), "takes 0.9 m to each side"),
        (Obstacle(CROSSING.adversary.start_x - 0.7, CROSSING.adversary.start_y, 0.0, 1.0, 1.0), "adversary starts in"),
    ],
)
def test_one_in_the_way_of_the_car_or_at_the_start_is_refused(obstacle: Obstacle, said: str) -> None:
    with pytest.raises(UsageError) as refused:
        with_obstacles(PARKED, obstacle)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_way_through_one_is_refused_and_said_where() -> None:
    scenario = with_obstacles(Obstacle(5.0, 8.0, 0.0, 1.0, 1.0), PARKED)
    points = np.array([(-2.6, 2.0), (-2.6, 0.0), (-2.6, -4.0), (-2.6, -8.0)])
    with pytest.raises(
        UsageError, match=r"'way' runs into obstacles\[1\] of scenario crossing at 0.6 s, at \(-2.6, -4\)"
    ):
        check_trajectory(scenario, Trajectory(points, 0.3, "way"))
    check_trajectory(scenario, Trajectory(points[:2], 0.3, "way"))
    check_trajectory(CROSSING, Trajectory(points, 0.3, "way"))
