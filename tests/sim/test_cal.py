from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from skd_sim.controllers.cal import FEATURES, CalController, CalState, HazardNetwork
from skd_sim.controllers.protocol import SensingController
from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.sensors import PlanarLaser
from skd_sim.world.state import AdversaryState, CarState
from skd_sim.world.world import World

CROSSING = replace(load_scenario("crossing"), control_period=CalController.control_period)
QUIET = replace(CROSSING, car=replace(CROSSING.car, speed_noise=0.0, acceleration_noise=0.0))
RNG = np.random.default_rng(0)
GONE = AdversaryState(-30.0, -30.0, 0.0, 0.0)


def answering(logit: float) -> HazardNetwork:
    """A network that gives the same answer for every object."""
    zeros = np.zeros((FEATURES, 1)), np.zeros(1), np.zeros((1, 1)), np.zeros(1), np.zeros((1, 1))
    return HazardNetwork(*zeros, np.array([logit]))


def drive(controller, scenario, adversary, ticks, gap):
    """Run a car against an adversary that keeps its velocity, to the end or to a collision."""
    world = World(
        scenario,
        adversary_start=adversary[:2],
        gap=gap,
        start_rng=np.random.default_rng(1),
        car_rng=np.random.default_rng(2),
    )
    laser = PlanarLaser(scenario, 0, 0)
    controller.reset(scenario, RNG)
    states = [world.car]
    for _ in range(ticks * scenario.control_periods):
        if isinstance(controller, SensingController):
            controller.sense(laser.scan(world.car, world.adversary, world.tick, world.period))
        assert world.step(controller.command(world.car, world.adversary), adversary[2:]) is None
        if world.period == 0:
            states.append(world.car)
    return states


def test_it_cruises_at_thirty_kilometres_per_hour():
    car = replace(QUIET.car, start_speed=0.0)
    for start_speed in (0.0, 25.0 / 3.0, 10.0):
        scenario = replace(QUIET, car=replace(car, start_speed=start_speed))
        states = drive(CalController(), scenario, GONE, 200, 400.0)
        assert states[-1].speed * 3.6 == pytest.approx(30.0, abs=0.5)


def test_it_brakes_fully_above_ninety_per_cent_and_not_below():
    for probability, state, braking in ((0.901, CalState.HAZARD_STOP, True), (0.899, CalState.CRUISING, False)):
        controller = CalController(answering(float(np.log(probability / (1.0 - probability)))))
        controller.reset(CROSSING, RNG)
        car = CarState(0.0, -15.0, HEADING_NORTH, 25.0 / 3.0)
        adversary = AdversaryState(0.0, 0.0, 0.0, 0.0)
        controller.sense(PlanarLaser(CROSSING, 0, 0).scan(car, adversary, 0))
        command = controller.command(car, adversary)
        assert controller.state == state
        assert controller.probability == pytest.approx(probability)
        assert (command == -CROSSING.car.deceleration) == braking


def test_it_stops_before_an_adversary_who_stands_in_the_lane():
    states = drive(CalController(), QUIET, AdversaryState(0.0, 0.0, 0.0, 0.0), 40, 25.0)
    assert states[-1].speed == 0.0
    gap = -states[-1].y - QUIET.car.front - QUIET.adversary.radius
    assert 0.3 < gap < 5.0


def test_it_brakes_for_one_who_has_just_come_into_view_until_it_sees_that_he_stands():
    for gap, braking in ((11.0, True), (25.0, False)):
        states = drive(CalController(), QUIET, AdversaryState(-3.0, 0.0, 0.0, 0.0), 2, gap)
        first, second = np.diff([state.speed for state in states]) / QUIET.time_step
        assert (first == pytest.approx(-QUIET.car.deceleration)) == braking
        assert second > -0.5


def test_scans_are_needed():
    with pytest.raises(UsageError, match="needs a laser scan"):
        CalController().reset(replace(CROSSING, sensor=None), RNG)
    controller = CalController()
    controller.reset(CROSSING, RNG)
    with pytest.raises(ValueError, match="no scan for this moment"):
        controller.command(CarState(0.0, -10.0, HEADING_NORTH, 5.0), GONE)


def test_it_decides_twenty_times_a_second():
    """Within a tick it begins to brake when the hazard is there, and not with the tick."""
    assert CalController.control_period == CarUnderTest("cal").control_period == 0.05
    assert CROSSING.control_periods == 6
    begins = set()
    for gap in np.arange(16.0, 20.0, 0.5):
        controller = CalController()
        controller.reset(QUIET, RNG)
        world = World(
            QUIET,
            adversary_start=(0.0, 0.0),
            gap=float(gap),
            start_rng=np.random.default_rng(1),
            car_rng=np.random.default_rng(2),
        )
        laser = PlanarLaser(QUIET, 0, 0)
        while controller.state == CalState.CRUISING and world.tick < 10:
            begun = world.period
            controller.sense(laser.scan(world.car, world.adversary, world.tick, world.period))
            world.step(controller.command(world.car, world.adversary), (0.0, 0.0))
        assert controller.state == CalState.HAZARD_STOP
        begins.add(begun)
    assert len(begins) > 1
