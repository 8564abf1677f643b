"""highway-env's car: its law against a second implementation, whom it follows, and whole episodes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from cars import idm as treiber
from highway_env.vehicle.behavior import IDMVehicle
from highway_idm import HighwayIdm
from hypothesis import assume, given
from hypothesis import strategies as st
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim.controllers.protocol import Controller, with_control_period
from skd_sim.errors import UsageError
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, CarState, Trajectory

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
        "DELTA": treiber.EXPONENT,
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


def test_a_road_with_curves_is_refused():
    with pytest.raises(UsageError, match="straight roads only; that of scenario right_turn has curves"):
        HighwayIdm().reset(load_scenario("right_turn"), RNG)
