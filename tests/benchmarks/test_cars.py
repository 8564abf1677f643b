"""The cars by which figures are judged: enough of them, each alike every time it runs, and what their laws say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from cars.catalogue import CARS, available
from cars.collision_time import time_to_collision
from cars.encroachment import time_between
from cars.idm import IntelligentDriver, WatchfulDriver
from cars.planner import plan_cost
from cars.required_brake import RequiredDecelerationBrake
from cars.slows import SlowsNearAnybody
from cars.triggers import MARGIN, EarlyTrigger, LateTrigger, MiddleTrigger
from cars.view import Eyes, View
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim.controllers.loading import make_controller
from skd_sim.controllers.protocol import Controller
from skd_sim.scenario.road import HEADING_NORTH
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import AdversaryState, CarState, Trajectory

CROSSING = load_scenario("crossing")
EYES = Eyes(CROSSING)
HERE, MISSING = available()
FRONT, RADIUS = CROSSING.car.front, CROSSING.adversary.radius
HESITANT = Trajectory(
    np.column_stack([[-3.5, -2.75, -2.0, -1.6, -1.6, -1.6, -0.85, -0.1, 0.65, 1.4, 2.15], np.zeros(11)]),
    0.3,
    "hesitant",
)


def law(kind):
    """Return a controller at the start of an episode."""
    made = kind()
    assert isinstance(made, Controller)
    made.reset(CROSSING, np.random.default_rng(0))
    return made


def command(made, ahead: float, left: float, speed: float, velocity: tuple[float, float] = (0.0, 0.0)) -> float:
    """Return what a controller commands for somebody `ahead` of the front and `left` of the axis, both from his centre.

    The velocity is (to the left, ahead), m/s.
    """
    state = CarState(0.0, 0.0, HEADING_NORTH, speed)
    return float(made.command(state, AdversaryState(-left, ahead + FRONT, -velocity[0], velocity[1])))


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


@given(st.floats(0.0, 40.0), st.floats(-6.0, 6.0), st.floats(2.0, 8.0))
def test_who_slows_near_anybody_wants_a_speed_in_proportion(ahead, left, speed):
    car = law(SlowsNearAnybody)
    distance = math.hypot(max(0.0, ahead - RADIUS), max(0.0, abs(left) - EYES.reach))
    wanted = min(25.0 / 3.0, max(2.0, 0.6 * distance))
    assert command(car, ahead, left, speed) == pytest.approx(min(1.5, max(-4.0, wanted - speed)))
    assert command(car, -6.0, 0.0, speed) == pytest.approx(min(1.5, 25.0 / 3.0 - speed))


def test_idm_brakes_for_who_is_on_the_lane_ahead_and_for_nobody_else():
    plain, watchful = law(IntelligentDriver), law(WatchfulDriver)
    assert command(plain, 6.0, 0.0, 8.0) == -CROSSING.car.deceleration
    for left, ahead in ((2.0, 6.0), (0.0, -9.0)):
        assert command(plain, ahead, left, 8.0) > 0.0
    assert command(watchful, 6.0, 2.0, 8.0) < -CROSSING.car.deceleration
    assert command(watchful, 6.0, 3.0, 8.0) > 0.0


@given(st.floats(1.5, 30.0), st.floats(0.5, 9.0))
def test_the_graded_brake_asks_for_what_it_takes_and_a_fifth_more(gap, speed):
    car = law(RequiredDecelerationBrake)
    required = speed * speed / (2.0 * max(0.1, gap - 1.0))
    assume(abs(required - 2.0) > 1e-6)
    expected = -min(7.0, 1.2 * required) if required > 2.0 else min(1.5, max(-1.5, 25.0 / 3.0 - speed))
    assert command(car, gap + RADIUS, 0.5, speed) == pytest.approx(expected)
    assert command(car, gap + RADIUS, 3.0, speed, (+1.0, 0.0)) == pytest.approx(min(1.5, max(-1.5, 25.0 / 3.0 - speed)))


@given(st.floats(0.0, 30.0), st.floats(-6.0, 6.0), st.floats(1.0, 10.0), st.floats(-3.5, 3.5))
@settings(deadline=None)
def test_the_time_between_two_is_what_one_finds_by_looking_at_many_moments(gap, left, speed, leftwards):
    assume(abs(leftwards) > 0.2)
    times = np.arange(0.0, 60.0, 0.01)
    adversary = np.abs(left + leftwards * times) <= EYES.reach
    car = (gap - speed * times <= 0.0) & (gap + 2.0 * RADIUS + EYES.length - speed * times >= 0.0)
    found = time_between(View(gap, left, speed, leftwards), EYES, speed)
    if not adversary.any():
        assert found == math.inf or abs(left) > EYES.reach - 0.05
        return
    here, there = times[adversary], times[car]
    assert found == pytest.approx(max(there[0] - here[-1], here[0] - there[-1]), abs=0.03)


def test_a_plan_costs_what_its_integral_says_and_fears_whom_it_meets():
    """Constant braking of 2 m/s² from 8 m/s for one second in small steps: ∫ (2t)² + 0.3·2² dt = 4/3 + 1.2."""
    shape = (EYES.reach, EYES.radius, EYES.length)
    rest = (8.0, 8.0, -2.0, -2.0, shape, 0.001, 1000, 10.0, 0.0, 100.0)
    assert plan_cost(100.0, 0.0, 0.0, 0.0, *rest) == pytest.approx(4.0 / 3.0 + 1.2, rel=0.01)
    assert plan_cost(5.0, 0.0, 0.0, 0.0, *rest) > 100.0  # seven metres are driven in that time
    assert plan_cost(7.5, 0.0, 0.0, 0.0, *rest) < 10.0
    assert plan_cost(5.0, 3.0, 0.0, 0.0, *rest) < 10.0
    assert plan_cost(5.0, 3.0, 0.0, -3.0, *rest) > 100.0


SCENARIO = load_scenario("cut_in")
BRAKES = ((EarlyTrigger, 2.0), (MiddleTrigger, 1.2), (LateTrigger, 0.6))
NORTH = math.pi / 2.0
SPEED = 10.0  # m/s


def braked(kind: type[MiddleTrigger], gap: float, aside: float = 0.0, speed: float = 0.0, across: float = 0.0) -> bool:
    """Whether a new car at (0, 0) brakes for a car whose rear is so far (m) ahead of its front, and so far aside."""
    car = kind()
    car.reset(SCENARIO, np.random.default_rng(0))
    other = AdversaryState(aside, 2.25 + gap + 2.25, across, speed, NORTH)
    return car.command(CarState(0.0, 0.0, NORTH, SPEED), other) == -SCENARIO.car.deceleration


@pytest.mark.parametrize(("kind", "time"), BRAKES)
@pytest.mark.parametrize("speed", [0.0, 4.0])
def test_each_brakes_from_its_time_to_collision_on(kind: type[MiddleTrigger], time: float, speed: float) -> None:
    gap = time * (SPEED - speed)
    assert braked(kind, gap - 1e-6, speed=speed)
    assert not braked(kind, gap + 1e-6, speed=speed)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_only_whoever_is_on_its_strip_or_will_be_counts(side: float) -> None:
    edge = 0.9 + 0.9 + MARGIN
    assert braked(LateTrigger, 3.0, aside=side * (edge - 1e-6))
    assert not braked(LateTrigger, 3.0, aside=side * (edge + 1e-6))
    comes = -side * 3.0  # m/s, for 0.3 s until the front is there
    assert braked(LateTrigger, 3.0, aside=side * (edge + 0.9 - 1e-6), across=comes)
    assert not braked(LateTrigger, 3.0, aside=side * (edge + 0.9 + 1e-6), across=comes)
    assert not braked(LateTrigger, 3.0, speed=SPEED)  # it drives away
