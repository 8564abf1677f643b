"""The crossing as a POMDP, composed of its parts, and the adversary that plans in it."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from skd_adversary import ParticleBelief, Planner, PlannerOptions, Pomdp
from skd_adversary.adversary import PlanningAdversary, make_adversary
from skd_adversary.crossing.cars import BASIC_KERNELS, CarModel, known_basic_car, unknown_car
from skd_adversary.crossing.interfaces import (
    ADVERSARY_X,
    ADVERSARY_Y,
    CAR_S,
    CAR_SPEED,
    ROW,
    STATE_DIM,
    TRIGGER,
    ObjectiveModel,
    move,
    template,
    velocity,
)
from skd_adversary.crossing.model import CURVED, STRAIGHT, compose, transition_parts
from skd_adversary.crossing.objectives import PAPER, objective_named, polyline_distance, polyline_segments
from skd_adversary.crossing.road_users import ACTION_COUNT, EAST, PEDESTRIAN, STAY, action_velocity, road_user_named
from skd_sim import CarState, EpisodeSpec, Mode, Scenario, Trajectory, kernel, load_scenario
from skd_sim.controllers.basic import BasicController
from skd_sim.options.car_and_adversary import OBJECTIVES
from skd_sim.scenario.road import road_position
from skd_sim.world.state import FloatArray
from skd_sim.world.world import World

CROSSING = load_scenario("crossing")


def _scenario(speed_noise: float, acceleration_noise: float) -> Scenario:
    car = replace(CROSSING.car, speed_noise=speed_noise, acceleration_noise=acceleration_noise)
    return replace(CROSSING, car=car)


def _model(scenario: Scenario, car_model: CarModel) -> Pomdp:
    adversary, user = scenario.adversary, road_user_named(scenario.adversary.kind)
    start = adversary.start_x, adversary.start_y
    return compose(scenario, PAPER, car_model, start=start, gap=scenario.car.start_gap, road_user=user)


def _step(model: Pomdp, state: np.ndarray, action: int, after: np.ndarray, rng: np.random.Generator) -> bool:
    """One transition of an adversary beside a basic car on the straight lane; whether the two touch."""
    move = transition_parts(BASIC_KERNELS, PEDESTRIAN.kernels, STRAIGHT)["move"]
    velocity = action_velocity(action, model.parameters.adversary_speed)
    return bool(move(model.parameters, state, *velocity, after, rng) <= 1.0)


def _state_of(world: World, trigger: float) -> np.ndarray:
    car_s, _ = road_position(world.scenario.road.line, world.car.x, world.car.y)
    return np.array([world.adversary.x, world.adversary.y, car_s, world.car.speed, trigger])


@pytest.mark.parametrize(
    ("name", "multiplier", "odds"),
    [
        ("crossing", 0.5, (0.1, 0.1, 0.5, 0.1, 0.1, 0.1)),
        ("crossing", 1.0, (0.1, 0.1, 0.5, 0.1, 0.1, 0.1)),
        ("crossing", 1.15, (0.1, 0.1, 0.5, 0.1, 0.1, 0.1)),
        ("right_turn", 0.5, (0.1, 0.1, 0.5, 0.1, 0.1, 0.1)),
        ("right_turn", 0.5, (0.0, 0.1, 0.2, 0.0, 0.6, 0.1)),  # into the curve
        ("cyclist", 0.5, (0.2, 0.1, 0.1, 0.2, 0.2, 0.1, 0.1)),
    ],
)
def test_transition_without_noise_is_the_world(name: str, multiplier: float, odds: tuple[float, ...]) -> None:
    """Random walks: same positions, same speed and same collision at every tick."""
    scenario = load_scenario(name)
    scenario = replace(scenario, car=replace(scenario.car, speed_noise=0.0, acceleration_noise=0.0))
    model = _model(scenario, known_basic_car(multiplier))
    parameters = model.parameters
    road = STRAIGHT if scenario.road.straight else CURVED
    parts = transition_parts(BASIC_KERNELS, road_user_named(scenario.adversary.kind).kernels, road)
    near = 1e-12 if scenario.road.straight else 1e-9  # m: what path coordinates there and back may round
    choose = np.random.default_rng(1)
    collisions = 0
    for episode in range(200):
        start, car = np.random.default_rng([2, episode]), np.random.default_rng(0)
        world = World(scenario, gap=scenario.car.start_gap, start_rng=start, car_rng=car)
        controller = BasicController(multiplier)
        controller.reset(scenario, np.random.default_rng(0))
        state, after = np.empty(model.state_dim), np.empty(model.state_dim)
        model.initial(parameters, state, np.random.default_rng(0))
        state[:STATE_DIM] = _state_of(world, parameters.trigger_high)
        for _ in range(12):
            action = int(choose.choice(len(odds), p=odds))
            velocity = parts["velocity"](parameters, state, action)
            hit = parts["move"](parameters, state, *velocity, after, choose) <= 1.0
            contact = world.step(controller.command(world.car, world.adversary), velocity)
            assert hit == (contact is not None)
            seen = _state_of(world, parameters.trigger_high)
            np.testing.assert_allclose(after[:STATE_DIM], seen, rtol=1e-12, atol=near)
            if hit:
                collisions += 1
                break
            state[:] = after
    assert 20 < collisions < 200  # both kinds of episode were seen


@pytest.mark.parametrize("car_y", [-20.0, -8.0])
def test_transition_is_the_world_in_distribution(car_y: float) -> None:
    """Speed and place of the car after one tick: coasting, and braking (acceleration noise off in both)."""
    scenario = _scenario(0.05, 0.0)
    model = _model(scenario, known_basic_car(1.0))
    parameters = model.parameters
    n = 5000
    start = np.array([-3.5, 0.0, car_y, scenario.car.start_speed, parameters.trigger_high])
    rng = np.random.default_rng(3)
    predicted, after = np.empty((n, 2)), np.empty(5)
    truth = np.empty((n, 2))
    gap = -car_y - scenario.car.front
    flat = replace(scenario, car=replace(scenario.car, start_gap_range=0.0))
    controller = BasicController(1.0)
    controller.reset(flat, rng)
    for i in range(n):
        _step(model, start, EAST, after, rng)
        predicted[i] = after[CAR_S], after[CAR_SPEED]
        world = World(flat, adversary_start=(-3.5, 0.0), gap=gap, start_rng=rng, car_rng=rng)
        world.step(controller.command(world.car, world.adversary), (2.5, 0.0))
        truth[i] = world.car.y, world.car.speed
    for column in range(2):
        assert stats.ks_2samp(predicted[:, column], truth[:, column]).pvalue > 1e-3


# In micrometres: shapely's distance to a segment of 1e-180 m is infinite.
coordinate = st.integers(-(10**7), 10**7).map(lambda micrometres: 1e-6 * micrometres)
point = st.tuples(coordinate, coordinate)


@given(at=point, path=st.lists(point, min_size=1, max_size=8))
def test_polyline_distance(at: tuple[float, float], path: list[tuple[float, float]]) -> None:
    line = shapely.LineString(path) if len(path) > 1 else shapely.Point(path[0])
    distance = polyline_distance(*at, polyline_segments(np.array(path)))
    assert distance == pytest.approx(line.distance(shapely.Point(at)), abs=1e-9)


STATES = np.array([[-3.5, 0.0, -15.0, 8.0, 9.9], [-1.0, 0.5, -6.0, 5.0, 9.9], [0.5, -1.0, 2.0, 3.0, 9.9]])


@pytest.mark.parametrize(("sensor", "seen"), [("position", -7.1), ("distance", 6.0)])
def test_likelihoods_are_gaussian_up_to_a_factor(sensor: str, seen: float) -> None:
    """Of the position, the East component has the same density whatever the car does: the model goes without it."""
    scenario = replace(CROSSING, adversary=replace(CROSSING.adversary, position_noise=0.7, distance_noise=0.7))
    model = _model(scenario, known_basic_car(1.0) if sensor == "position" else unknown_car())
    got = [model.likelihood(model.parameters, state, 0, np.array([seen])) for state in STATES]
    north, east = STATES[:, CAR_S] - STATES[:, ADVERSARY_Y], STATES[:, ADVERSARY_X]
    expected = stats.norm.pdf(seen, north if sensor == "position" else np.hypot(east, north), 0.7)
    np.testing.assert_allclose(got, math.sqrt(2.0 * math.pi) * 0.7 * expected, rtol=1e-10)


@pytest.mark.parametrize("state", STATES)
def test_reinvigoration_keeps_the_adversary_and_agrees_with_the_observation(state: np.ndarray) -> None:
    by_position = _model(CROSSING, CarModel(0.25, 1.5, observes_position=True))
    by_distance = _model(CROSSING, unknown_car())
    parameters = by_distance.parameters
    rng = np.random.default_rng(7)
    redrawn = np.empty(STATE_DIM)
    n = 2000
    relative, distance = np.empty(n), np.empty(n)
    far = 12.0
    for i in range(n):
        by_position.reinvigorate(by_position.parameters, state, np.array([-far]), redrawn, rng)
        assert (redrawn[:2] == state[:2]).all()
        assert 0.0 <= redrawn[CAR_SPEED] <= CROSSING.car.start_speed
        assert parameters.trigger_low <= redrawn[TRIGGER] <= parameters.trigger_high
        relative[i] = redrawn[CAR_S] - state[ADVERSARY_Y]
        by_distance.reinvigorate(by_distance.parameters, state, np.array([far]), redrawn, rng)
        assert (redrawn[:2] == state[:2]).all()
        # On the side where the car was believed.
        assert (redrawn[CAR_S] <= state[ADVERSARY_Y]) == (state[CAR_S] <= state[ADVERSARY_Y])
        distance[i] = math.hypot(state[ADVERSARY_X], redrawn[CAR_S] - state[ADVERSARY_Y])
    assert stats.kstest(relative + far, "norm").pvalue > 1e-3
    assert stats.kstest(distance - far, "norm").pvalue > 1e-3


@template
def _begin(parameters: Any, state: FloatArray) -> None:
    state[ROW] = 0.0


@template
def _step_composition(parameters, state, action, next_state, rng):
    vx, vy = velocity(parameters, state, action)
    move(parameters, state, vx, vy, next_state, rng)
    next_state[ROW] = state[ROW] + 1.0
    return -abs(next_state[ADVERSARY_X] - parameters.wanted_x), next_state[ROW] >= 6.0


@kernel(inline=True)
def _go(parameters: Any, state: FloatArray, rng: np.random.Generator) -> int:
    return EAST if state[ADVERSARY_X] < parameters.wanted_x - 0.1 else STAY


WAIT = ObjectiveModel(
    "wait",
    1.0,
    PlannerOptions(simulations=1000, exploration=1.0, particles=300),
    lambda _scenario, _path: {"wanted_x": -2.0},
    step=_step_composition,
    rollout_action=_go,
    begin=_begin,
    own_dim=lambda _points: 1,
)


def test_an_objective_of_ones_own() -> None:
    model = compose(CROSSING, WAIT, unknown_car(), start=(-3.5, 0.0), gap=30.0)
    assert (model.state_dim, model.action_count) == (STATE_DIM + 1, ACTION_COUNT)
    rng = np.random.default_rng(0)
    belief, planner = ParticleBelief(model, 100, rng), Planner(model, replace(WAIT.options, simulations=4000), rng)
    x = []
    for _ in range(5):
        action = planner.plan(belief)
        belief.predict(action)
        assert (belief.particles[:, ADVERSARY_X] == belief.particles[0, ADVERSARY_X]).all()
        x.append(belief.particles[0, ADVERSARY_X])
    assert x == pytest.approx([-2.75, -2.0, -2.0, -2.0, -2.0])
    assert (belief.particles[:, STATE_DIM] == 5.0).all()


def test_two_parts_with_a_parameter_of_one_name_are_refused() -> None:
    twice = replace(WAIT, parameters=lambda scenario, path: {"radius": 1.0})
    with pytest.raises(ValueError, match="wait: two parts of the model have a parameter radius"):
        compose(CROSSING, twice, unknown_car(), start=(-3.5, 0.0), gap=30.0)


def test_objectives_are_found_by_name() -> None:
    for name in OBJECTIVES.own:
        assert objective_named(name).name == name


ACROSS = Trajectory(np.column_stack([np.arange(-3.5, 3.0, 0.75), np.zeros(9)]), CROSSING.time_step)
DRAWS = 4000


def adversary(scenario: Scenario, controller: str) -> PlanningAdversary:
    episode = EpisodeSpec(scenario, Mode.KAMIKAZE, 3, 1, controller=controller, safe_trajectory=ACROSS, simulations=1)
    return make_adversary(episode)


@pytest.mark.parametrize(
    ("controller", "truth"), [("basic", -12.0), ("carla", float(np.hypot(3.5, 12.0)))], ids=["position", "distance"]
)
@pytest.mark.parametrize("noise", [0.25, 1.0])
def test_what_is_seen_is_the_truth_and_the_noise_that_the_scenario_says(controller, truth, noise):
    """Of n normal draws mean and deviation are within 4.5 standard errors: σ/√n and σ/√2n."""
    mine = (noise, 7.0) if controller == "basic" else (7.0, noise)  # the other sensor's must not be taken
    position, distance = mine
    noisy = replace(CROSSING.adversary, position_noise=position, distance_noise=distance)
    sees = adversary(replace(CROSSING, adversary=noisy), controller)
    seen = np.array([sees._sense(CarState(0.0, -12.0, np.pi / 2, 8.0))[0] for _ in range(DRAWS)])
    assert seen.mean() == pytest.approx(truth, abs=4.5 * noise / np.sqrt(DRAWS))
    assert seen.std() == pytest.approx(noise, rel=4.5 / np.sqrt(2 * DRAWS))
    assert abs(np.corrcoef(seen[1:], seen[:-1])[0, 1]) < 4.5 / np.sqrt(DRAWS)
