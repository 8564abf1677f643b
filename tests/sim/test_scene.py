"""Parked rectangles and the others of a scenario: where they are, who sees them, and what they block."""

import copy
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from common import refused
from hypothesis import given
from hypothesis import strategies as st
from skd_adversary.adversary import ReplayAdversary
from skd_evaluator.assessment.plausibility import ROUNDING, implausible, recompute, touches
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim.controllers.controller import takes_scene
from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Obstacle, Scenario, check_trajectory, load_scenario, scenario_from_dict
from skd_sim.world.contact import clearance, runs_into
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, CarState, RoadUserState, Scene, Trajectory

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
    with refused(said):
        with_obstacles(PARKED, obstacle)


def test_a_way_through_one_is_refused_and_said_where() -> None:
    scenario = with_obstacles(Obstacle(5.0, 8.0, 0.0, 1.0, 1.0), PARKED)
    points = np.array([(-2.6, 2.0), (-2.6, 0.0), (-2.6, -4.0), (-2.6, -8.0)])
    with refused("'way' runs into obstacles[1] of scenario crossing at 0.6 s, at (-2.6, -4)"):
        check_trajectory(scenario, Trajectory(points, 0.3, "way"))
    check_trajectory(scenario, Trajectory(points[:2], 0.3, "way"))
    check_trajectory(CROSSING, Trajectory(points, 0.3, "way"))


BASE = load_scenario("crossing").as_dict()
ASIDE = Trajectory(np.tile([-6.0, 0.0], (30, 1)), 0.3)  # an adversary who stays away
STANDING = {"kind": "pedestrian", "radius": 0.25, "way": [{"time": 0.0, "x": 0.5, "y": 10.0}]}
WALKING = {
    "kind": "pedestrian",
    "radius": 0.25,
    "way": [{"time": 0.6, "x": -3.0, "y": 20.0}, {"time": 3.6, "x": 3.0, "y": 20.0}],
}
LEADING = {
    "kind": "car",
    "length": 4.0,
    "width": 1.6,
    "start_heading": math.pi / 2.0,
    "way": [{"time": 0.0, "x": 0.0, "y": 5.0}, {"time": 10.0, "x": 0.0, "y": 45.0}],  # at 4 m/s
}


def scenario_with(*others: dict[str, Any], noise: bool = True, **changes: Any) -> Scenario:
    data = copy.deepcopy(BASE)
    data["others"] = list(others)
    if not noise:
        data["car"] |= {"speed_noise": 0.0, "acceleration_noise": 0.0, "start_gap_range": 0.0}
    data |= changes
    return scenario_from_dict(data)


class Rolls:
    """A car that never brakes, and keeps what it is shown."""

    def __init__(self) -> None:
        self.seen: list[Scene] = []

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self.seen = []

    def command(self, car: CarState, scene: Scene) -> float:
        self.seen.append(scene)
        return 0.0


def played(scenario: Scenario, controller: Any = None, number: int = 0) -> EpisodeLog:
    episode = EpisodeSpec(scenario, Mode.REPLAY, 0, number, multiplier=0.0, safe_trajectory=ASIDE)
    return run_episode(episode, controller, ReplayAdversary(ASIDE))


def test_where_they_are() -> None:
    scenario = scenario_with(STANDING, WALKING, LEADING)
    standing, walking, leading = scenario.others_at(5)
    assert standing == (0.5, 10.0, 0.0, 0.0, 0.0)
    assert walking[:4] == pytest.approx((-3.0 + 2.0 * (1.5 - 0.6), 20.0, 2.0, 0.0))
    assert leading[:4] == pytest.approx((0.0, 5.0 + 4.0 * 1.5, 0.0, 4.0))
    assert leading.heading == pytest.approx(math.pi / 2.0)
    assert scenario.others_at(0)[2][2:4] == pytest.approx((0.0, 4.0))  # it comes as fast as it goes on
    assert scenario.others_at(10**6) == scenario.others_at(scenario.ticks)
    between = scenario_with(WALKING, control_period=0.1).others_at(5, 2)[0]
    assert between[:2] == pytest.approx((-3.0 + 2.0 * (1.7 - 0.6), 20.0))
    assert scenario_from_dict(scenario.as_dict()) == scenario


@pytest.mark.parametrize("other", [STANDING, LEADING], ids=["one who stands", "a car ahead"])
def test_the_car_hits_them_when_the_two_meet(other: dict[str, Any]) -> None:
    """Uniform motions: the time of the contact is a quotient."""
    scenario = scenario_with(other, noise=False)
    log = played(scenario)
    speed = scenario.car.start_speed
    if other is STANDING:
        gap, closing = 10.0 - 0.25 + scenario.car.start_gap, speed  # its centre is beside the car's middle
    else:
        gap, closing = 5.0 - 2.0 + scenario.car.start_gap, speed - 4.0
    assert log.outcome == Outcome.COLLISION
    assert log.impact_time == pytest.approx(gap / closing, abs=1e-9)
    assert log.impact_speed == pytest.approx(speed)
    assert log.hit
    assert touches(log)[0] is None  # not the adversary
    assert recompute(log).deviation <= ROUNDING
    assert not implausible(log)


def test_a_controller_sees_everybody_if_it_asks_for_the_scene() -> None:
    scenario, car = scenario_with(WALKING), Rolls()
    assert takes_scene(car)
    played(scenario, car)
    for tick, scene in enumerate(car.seen):
        assert isinstance(scene, Scene)
        assert scene.adversary[:2] == (-6.0, 0.0)
        assert scene.others == scenario.others_at(tick)
    with_an_adversary_alone = load_scenario("crossing")
    played(with_an_adversary_alone, car)
    assert car.seen[0].others == ()


def test_who_stands_is_in_the_adversarys_way() -> None:
    beside = STANDING | {"way": [{"time": 0.0, "x": -2.5, "y": 0.0}]}
    scenario = scenario_with(beside)
    across = Trajectory(np.column_stack([-3.5 + 0.75 * np.arange(8), np.zeros(8)]), 0.3)
    episode = EpisodeSpec(scenario, Mode.KAMIKAZE, 0, 0, safe_trajectory=across, simulations=50)
    assert episode.outcome(2, RoadUserState(-2.3, 0.0, 2.5, 0.0), collided=False) == Outcome.MISSED
    moving = scenario_with(WALKING)
    assert len(moving.rectangles) == 0


def test_another_simulator_has_to_place_them() -> None:
    from skd_sim.simulators.simulator import NamedSimulator

    simulator = NamedSimulator()
    simulator._simulator, simulator._name = object(), "elsewhere"  # type: ignore[assignment]
    episode = EpisodeSpec(scenario_with(STANDING), Mode.REPLAY, 0, 0, safe_trajectory=ASIDE, simulator="elsewhere")
    with pytest.raises(UsageError, match=r"has others, which simulator 'elsewhere' does not place"):
        simulator.reset(episode)
