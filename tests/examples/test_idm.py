"""Example controllers: the Intelligent Driver Model, and a car that evades."""

import math
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cars import idm as treiber
from common import run_skd
from highway_env.vehicle.behavior import IDMVehicle
from highway_idm import HighwayIdm, HighwayMobil, road_with, vehicle
from hypothesis import assume, given
from hypothesis import strategies as st
from skd_evaluator.assessment.episode_figures import ROAD_EDGE, collision_partner, lane_left
from skd_evaluator.assessment.plausibility import examine
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.bags.read import read_bags
from skd_sim.controllers.controller import Controller, with_control_period
from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import AdversaryModel
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, CarState, Scene, Trajectory

CROSSING = load_scenario("crossing")
DESIRED = CROSSING.car.start_speed
REACH = 0.5 * CROSSING.road.lane_width + 1.0  # of highway-env's Road.neighbour_vehicles: the lane and a metre beside it
RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def car() -> HighwayIdm:
    made = HighwayIdm()
    assert isinstance(made, Controller)
    made.reset(CROSSING, RNG)
    return made


def asked(car: HighwayIdm, ahead: float, left: float, speed: float = DESIRED, walking: float = 0.0) -> float:
    """What the car at (0, −20) commands for an adversary so far (m) ahead of its centre, walking (m/s) North."""
    return car.command(CarState(0.0, -20.0, HEADING_NORTH, speed), AdversaryState(-left, ahead - 20.0, 0.0, walking))


@given(
    speed=st.floats(0.0, 15.0), distance=st.floats(0.5, 80.0), left=st.floats(-1.0, 1.0), walking=st.floats(-3.0, 3.0)
)
def test_the_law_is_that_of_the_paper_when_it_has_its_constants(car, speed, distance, left, walking):
    ours = {
        "ACC_MAX": math.inf,
        "COMFORT_ACC_MAX": treiber.PUBLISHED.acceleration,
        "COMFORT_ACC_MIN": -treiber.PUBLISHED.braking,
        "DISTANCE_WANTED": treiber.PUBLISHED.standing_gap,
        "TIME_WANTED": treiber.PUBLISHED.headway,
        "DELTA": 4.0,
    }
    approach = speed - walking
    desired_gap = ours["DISTANCE_WANTED"] + speed * treiber.PUBLISHED.headway
    desired_gap += speed * approach / (2.0 * math.sqrt(treiber.PUBLISHED.acceleration * treiber.PUBLISHED.braking))
    assume(desired_gap >= 0.0)  # below, of who runs away, the paper's takes 0 and highway-env squares it
    with pytest.MonkeyPatch.context() as patch:
        for name, value in ours.items():
            patch.setattr(IDMVehicle, name, value)
        command = asked(car, distance, left, speed, walking)
    expected = treiber.idm_acceleration(speed, DESIRED, distance, approach)
    assert command == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_it_follows_who_is_ahead_on_the_lane_or_a_metre_beside_it(car, side):
    free = asked(car, 15.0, 50.0)
    assert free == pytest.approx(0.0, abs=1e-12)  # it drives at the speed that it wants
    assert asked(car, 15.0, side * (REACH - 1e-6)) < -1.0
    assert asked(car, 15.0, side * (REACH + 1e-6)) == free
    assert asked(car, -15.0, 0.0) == free


def test_in_an_episode_it_stops_before_who_stands_on_the_lane():
    scenario = with_control_period(replace(CROSSING, horizon=6.0), HighwayIdm.control_period, "highway_idm")
    standing = Trajectory(np.tile([-1.0, 4.0], (21, 1)), scenario.time_step, "standing")
    log = run_episode(EpisodeSpec(scenario, Mode.REPLAY, 0, 0, safe_trajectory=standing), HighwayIdm())
    assert log.outcome != Outcome.COLLISION
    assert log.car[-1, 3] < 0.5
    assert log.car[-1, 1] < 4.0 - scenario.car.front


def test_it_changes_lanes_as_in_the_simulation_of_highway_env():
    scenario, driver, user = load_scenario("oncoming_lane"), HighwayMobil(), AdversaryState(1.0, 0.0, 0.0, 0.0)
    driver.reset(scenario, RNG)
    road = road_with(scenario, [-1, 0])
    ego = IDMVehicle(road, np.array([0.0, -60.0]), HEADING_NORTH, DESIRED, None, DESIRED)
    road.vehicles = [ego, vehicle(road, user)]
    for _ in range(200):
        car = CarState(*ego.position.tolist(), ego.heading, ego.speed)
        acceleration, curvature = driver.command(car, Scene(car, user))
        road.act()
        assert acceleration == ego.action["acceleration"]
        assert math.atan(ego.LENGTH * curvature) == pytest.approx(ego.action["steering"], abs=1e-12)
        road.step(driver.control_period)
    assert ego.position[0] == pytest.approx(-3.5, abs=0.01)


def test_a_road_with_curves_is_refused():
    with pytest.raises(UsageError, match="straight roads only; that of scenario right_turn has curves"):
        HighwayIdm().reset(load_scenario("right_turn"), RNG)


FOLDER = Path(__file__).resolve().parents[2] / "examples" / "evasive"


def met(scenario: str, car: str) -> EpisodeLog:
    """Run a car beside somebody who walks across at 2 m/s."""
    phi = Trajectory(np.column_stack([np.minimum(-7.0 + 0.6 * np.arange(22), 5.0), np.zeros(22)]), 0.3)
    clocked = replace(load_scenario(scenario), control_period=0.05)
    generic = AdversaryModel.GENERIC
    car = f"{FOLDER}/{car}"
    return run_episode(EpisodeSpec(clocked, Mode.REPLAY, 0, 0, phi, controller=car, adversary_model=generic))


@pytest.mark.parametrize(
    ("scenario", "car", "partner"),
    [
        ("oncoming_lane", "evasive.py:Brakes", None),
        ("oncoming_lane", "evasive.py:BrakesToOtherLane", None),
        ("oncoming_traffic", "evasive.py:Brakes", None),
        ("oncoming_traffic", "evasive.py:BrakesToOtherLane", 0),  # the car that comes
        ("curve", "evasive.py:OtherLane", ROAD_EDGE),  # it takes every road for a straight one
        ("parked_car", "evasive.py:Brakes", 0),
        ("parked_car", "../idm/highway_idm.py:HighwayMobil", ROAD_EDGE),  # it wants wheels that turn at once
    ],
)
def test_what_becomes_of_a_car_that_evades(scenario: str, car: str, partner: int | None) -> None:
    log = met(scenario, car)
    assert collision_partner(log) == partner
    assert (lane_left(log) > 0.5) == (not car.endswith("Brakes"))
    assert examine(log).ours


def test_the_node_steers_by_ackermann_commands(tmp_path: Path) -> None:
    node = shlex.join([sys.executable, str(FOLDER / "evasive_node.py")])
    code = run_skd(
        "episode", "--mode", "replay", "--scenario", "oncoming_lane", "-p", "control_period:=0.1", "--controller",
        "external", "-p", "command_type:=ackermann", "-p", "command_topic:=/drive", "--controller-command", node,
        "--out", tmp_path / "out",
    )  # fmt: skip
    assert code == 0
    (found,) = read_bags([tmp_path / "out"]).episodes
    assert found.log.outcome != Outcome.ABORTED
    assert found.log.car[:, 0].min() < -2.5  # it was in the other lane
    assert examine(found.log).ours
