"""The cars by which figures are judged: enough of them, each alike every time it runs, and what their laws say."""

import math

import numpy as np
import pytest
from cars.catalogue import CARS, available
from cars.collision_time import time_to_collision
from cars.view import Eyes, View
from hypothesis import assume, given
from hypothesis import strategies as st
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim import EpisodeSpec, Mode, Trajectory, load_scenario
from skd_sim.controllers.controller import make_controller

CROSSING = load_scenario("crossing")
EYES = Eyes(CROSSING)
HERE, MISSING = available()
HESITANT = Trajectory(
    np.column_stack([[-3.5, -2.75, -2.0, -1.6, -1.6, -1.6, -0.85, -0.1, 0.65, 1.4, 2.15], np.zeros(11)]),
    0.3,
    "hesitant",
)


def test_there_are_twenty_cars_of_eight_families_each_with_a_label_of_its_own():
    assert len(CARS) >= 20
    assert len({car.family for car in CARS}) >= 8
    assert len({car.label for car in CARS}) == len(CARS)
    assert len({(car.controller, car.multiplier, car.scenario_name, car.friction) for car in CARS}) == len(CARS)
    assert len({car.controller for car in CARS if car.controller.startswith("cars.")}) >= 8
    assert all(line.startswith("vendor's example") for line in MISSING)  # it needs ROS 2's libraries


@pytest.mark.parametrize("car", HERE, ids=lambda car: car.label)
def test_a_car_forgets_an_episode_before_the_next(car):
    """The same controller, used for another episode in between, and a new one: to the bit."""

    def episode(number: int) -> EpisodeSpec:
        options = {"controller": car.controller, "multiplier": car.multiplier}
        return EpisodeSpec(car.scenario, Mode.REPLAY, 0, number, HESITANT, **options)

    used = make_controller(car.controller, car.multiplier)
    first, _, again = (run_episode(episode(number), used) for number in (7, 8, 7))
    anew = run_episode(episode(7))
    for log in (again, anew):
        np.testing.assert_array_equal(log.car, first.car)
        np.testing.assert_array_equal(log.adversary, first.adversary)
        assert (log.outcome, log.clipped) == (first.outcome, 0)
    assert np.ptp(first.car[:, 3]) > 0.5 or car.family == "basic"  # it does something


@given(st.floats(0.5, 30.0), st.floats(-6.0, 6.0), st.floats(1.0, 10.0), st.floats(-3.0, 3.0))
def test_the_time_to_collision_is_that_of_two_uniform_motions(gap, left, speed, leftwards):
    after = gap / speed
    place = left + leftwards * after
    assume(abs(abs(place) - EYES.reach - 0.2) > 1e-6)
    found = time_to_collision(View(gap, left, speed, leftwards), EYES)
    assert found == (pytest.approx(after) if abs(place) < EYES.reach + 0.2 else math.inf)
