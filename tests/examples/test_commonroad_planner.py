"""CommonRoad's reactive planner as a car: it brakes and starts again, and keeps nothing but what the car keeps."""

import numpy as np
import pytest
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim.controllers.controller import Controller
from skd_sim.errors import UsageError
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, CarState, Trajectory

pytest.importorskip("commonroad_rp", reason="it is not installed: examples/commonroad_planner/README.md")

from commonroad_planner import FULL_BRAKE, ReactivePlannerCar

CROSSING = load_scenario("crossing")
RNG = np.random.default_rng(0)
NOBODY = AdversaryState(500.0, 0.0, 0.0, 0.0)


def ready() -> ReactivePlannerCar:
    car = ReactivePlannerCar()
    assert isinstance(car, Controller)
    car.reset(CROSSING, RNG)
    return car


def at(y: float, speed: float) -> CarState:
    return CarState(0.0, y, HEADING_NORTH, speed)


def test_on_a_free_road_it_keeps_the_speed_that_it_starts_with():
    assert abs(ready().command(at(-16.0, CROSSING.car.start_speed), NOBODY)) < 0.1


def test_it_brakes_for_who_will_be_in_its_way_and_not_for_who_will_be_gone():
    driving = at(-16.0, CROSSING.car.start_speed)
    assert ready().command(driving, AdversaryState(0.0, 0.0, 0.0, 0.0)) < -0.5
    assert ready().command(driving, AdversaryState(1.2, 0.0, 2.5, 0.0)) > -0.3


def test_it_stops_before_who_stands_and_drives_on_when_they_are_gone():
    car, y, speed = ready(), -16.0, CROSSING.car.start_speed
    for place in [AdversaryState(0.0, 0.0, 0.0, 0.0)] * 15 + [NOBODY] * 3:
        command = car.command(at(y, speed), place)
        after = max(0.0, speed + CROSSING.time_step * command)
        y, speed = y + 0.5 * CROSSING.time_step * (speed + after), after
        if place is not NOBODY:
            assert y + CROSSING.car.front < -0.25 + 0.02  # it plans up to contact, and its accelerations are no steps
            stopped = speed
    assert stopped < 0.05
    assert speed > 0.3


def test_one_that_steers_passes_who_stands_at_the_edge_of_its_lane():
    phi = Trajectory(np.tile([0.75, 0.0], (16, 1)), 0.3)
    log = run_episode(EpisodeSpec(CROSSING, Mode.REPLAY, 0, 0, phi, controller="commonroad_planner:SteeringPlannerCar"))
    assert log.outcome != Outcome.COLLISION
    assert log.car[-1, 1] > 5.0
    assert -0.85 < log.car[:, 0].min() < -0.2


def test_where_no_plan_is_free_it_brakes_fully():
    assert ready().command(at(-3.5, 8.0), AdversaryState(0.0, 0.0, 0.0, 0.0)) == -FULL_BRAKE


def test_answers_do_not_depend_on_what_other_cars_were_asked():
    """The planner is one for all cars of a process; cars that are asked by turns answer as each does alone."""
    first, second = AdversaryState(-1.5, 0.0, 1.25, 0.0), AdversaryState(0.0, 1.0, 0.0, 0.0)
    alone = []
    for way in ((first, second), (first, first)):
        car = ready()
        alone.append([car.command(at(-12.0 + step, 7.0), place) for step, place in enumerate(way)])
    cars = ready(), ready()
    assert [car.command(at(-12.0, 7.0), first) for car in cars] == [alone[0][0]] * 2
    together = [car.command(at(-11.0, 7.0), place) for car, place in zip(cars, (second, first), strict=True)]
    assert together == [alone[0][1], alone[1][1]]


@pytest.mark.parametrize(("name", "says"), [("right_turn", "has curves"), ("ccrs", "predicts a disc.*is a car")])
def test_what_it_cannot_drive_is_refused(name, says):
    with pytest.raises(UsageError, match=says):
        ReactivePlannerCar().reset(load_scenario(name), RNG)
