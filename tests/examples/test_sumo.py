"""SUMO's drivers: against SUMO's own loop, whom they see, where they stop, and whether they keep apart."""

import math
from dataclasses import replace

import libsumo
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim import AdversaryState, CarState, EpisodeSpec, Mode, Outcome, Trajectory, UsageError, load_scenario
from skd_sim.controllers.controller import Controller, with_control_period
from skd_sim.scenario.road import HEADING_NORTH
from sumo_drivers import EGO, LANE, LANE_END, PERSON, STEP, Eidm, Idm, Krauss, SumoDriver

CROSSING = load_scenario("crossing")
CAR, RADIUS = CROSSING.car, 0.25
RNG = np.random.default_rng(0)
DRIVERS = (Krauss, Idm, Eidm)
MINIMUM_GAP = 2.5  # m; minGap of SUMO's passenger cars, by its documentation


def ready(kind: type[SumoDriver]) -> SumoDriver:
    driver = kind()
    assert isinstance(driver, Controller)
    driver.reset(CROSSING, RNG)
    return driver


def walk(rng: np.random.Generator, steps: int) -> list[AdversaryState]:
    """Somebody who crosses, stands, walks towards the car and away from it, as a kamikaze may."""
    x, y, found = rng.uniform(-2.5, 1.5), rng.uniform(-3.0, 3.0), []
    for step in range(steps):
        if step % 3 == 0:
            angle, speed = rng.uniform(-math.pi, math.pi), rng.choice([0.0, 1.25, 2.5])
        x, y = x + STEP * speed * math.cos(angle), y + STEP * speed * math.sin(angle)
        found.append(AdversaryState(x, y, speed * math.cos(angle), speed * math.sin(angle)))
    return found


def own_loop(kind: type[SumoDriver], places: list[AdversaryState]) -> tuple[list[CarState], list[float]]:
    """States of the car that SUMO moves by itself past somebody, and the speeds that it takes from them.

    The vehicle is put on the road and then left alone: only the person is told where to be.
    """
    ready(kind)
    libsumo.vehicle.moveTo(EGO, LANE, LANE_END - 13.0)
    libsumo.vehicle.setPreviousSpeed(EGO, CAR.start_speed)
    speed, states, speeds = CAR.start_speed, [], []
    for place in places:
        along = libsumo.vehicle.getLanePosition(EGO)
        states.append(CarState(0.0, along - LANE_END - CAR.front, HEADING_NORTH, speed))
        libsumo.person.moveToXY(PERSON, "road", place.x, place.y + RADIUS, angle=0.0, keepRoute=2)
        libsumo.simulationStep()
        speed = libsumo.vehicle.getSpeed(EGO)
        speeds.append(speed)
    return states, speeds


@pytest.mark.parametrize("kind", DRIVERS)
def test_decisions_are_those_of_sumos_own_loop(kind):
    braked = 0
    for seed in range(8):
        places = walk(np.random.default_rng(seed), 60)
        states, speeds = own_loop(kind, places)
        driver = ready(kind)
        decided = [one.speed + STEP * driver.command(one, other) for one, other in zip(states, places, strict=True)]
        assert decided == pytest.approx(speeds, abs=1e-9)
        braked += min(speeds) < 0.5 * CAR.start_speed
    assert braked >= 2  # else little was compared


@pytest.mark.parametrize("kind", DRIVERS)
@settings(max_examples=20)
@given(x=st.floats(-12.0, 12.0))
def test_it_sees_who_is_before_the_car_and_nobody_beside_its_way(kind, x):
    edge = 0.5 * CAR.width + RADIUS
    assume(abs(abs(x) - edge) > 1e-3)
    driver = ready(kind)
    for _ in range(3):  # SUMO shows a person a step late
        car = CarState(0.0, -12.0, HEADING_NORTH, CAR.start_speed)
        command = driver.command(car, AdversaryState(x, 0.0, 0.0, 0.0))
    assert (command < -1.0) == (abs(x) < edge)


@pytest.mark.parametrize("kind", DRIVERS)
def test_in_an_episode_it_stops_at_sumos_least_gap_before_who_stands_on_the_lane(kind):
    quiet = replace(CROSSING, horizon=12.0, car=replace(CAR, speed_noise=0.0, acceleration_noise=0.0))
    scenario = with_control_period(quiet, kind.control_period, "sumo")
    standing = Trajectory(np.tile([0.5, 6.0], (41, 1)), scenario.time_step, "standing")
    log = run_episode(EpisodeSpec(scenario, Mode.REPLAY, 0, 0, safe_trajectory=standing), kind())
    assert log.outcome != Outcome.COLLISION
    gap = 6.0 - RADIUS - (log.car[-1, 1] + scenario.car.front)
    assert log.car[-1, 3] < 0.1
    assert gap == pytest.approx(MINIMUM_GAP, abs=0.15)


@pytest.mark.parametrize("kind", DRIVERS)
def test_a_driver_answers_the_same_whatever_others_are_asked_in_between(kind):
    """In one simulation: drivers who are asked by turns answer as each does alone, to the last bit."""
    ways = [walk(np.random.default_rng(seed), 30) for seed in range(4)]
    ways = [ways[0][:12] + way[12:] for way in ways]
    seen = [own_loop(kind, way)[0] for way in ways]
    alone = []
    for way, states in zip(ways, seen, strict=True):
        driver = ready(kind)
        alone.append([driver.command(*one) for one in zip(states, way, strict=True)])
    drivers = [ready(kind) for _ in ways]
    for step in range(30):
        for number, one in enumerate(drivers):
            assert one.command(seen[number][step], ways[number][step]) == alone[number][step]


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("right_turn", "straight roads only; that of scenario right_turn has curves"),
        ("ccftap", "straight roads only|is a car"),
        ("ccrs", "puts a person on the lane, and the adversary of scenario ccrs is a car"),
    ],
)
def test_what_it_cannot_drive_is_refused(name, says):
    with pytest.raises(UsageError, match=says):
        Krauss().reset(load_scenario(name), RNG)
