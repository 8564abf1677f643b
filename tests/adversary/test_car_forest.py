"""Cars that no law explains, learned by a forest of what they did."""

import math
from collections import namedtuple
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from recorded_cars import logs_of
from skd_adversary.car_models import car_model_file
from skd_adversary.car_models.fit import learn_car
from skd_adversary.car_models.forest import FEATURES, GRID, LEAST_DONORS, TREES, Trees, described, grow, leaf_of
from skd_adversary.car_models.observations import Observations
from skd_adversary.crossing import cars
from skd_adversary.crossing.interfaces import CAR_S, CAR_SPEED, STATE_DIM
from skd_adversary.crossing.model import CURVED, STRAIGHT, compose
from skd_adversary.crossing.objectives import objective_named
from skd_adversary.crossing.road_users import road_user_named
from skd_sim import AdversaryState, CarState, Scenario, UsageError, load_scenario
from skd_sim.controllers.basic import BasicController
from skd_sim.controllers.controller import user_controller
from skd_sim.options.car_and_adversary import Objective
from skd_sim.scenario.road import beside_road, road_pose
from skd_sim.world.contact import to_car_frame


class GradedCar:
    """A car that brakes the harder the nearer a road user is, and speeds up again: no family knows such a law."""

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self._front = scenario.car.front

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        gap = adversary.y - car.y - self._front
        if gap < -5.0 or abs(adversary.x - car.x) > 3.0:
            return 0.8 * (8.0 - car.speed)
        return -min(7.0, 40.0 / max(1.0, gap + 2.0)) if gap < 25.0 else 0.0


@pytest.fixture(scope="module")
def logs() -> Observations:
    return logs_of(GradedCar(), 96)


@pytest.fixture(scope="module")
def learned(logs: Observations) -> car_model_file.FittedCar:
    return learn_car(logs, folds=2)


def test_its_leaves_are_those_of_scikit_learn(logs: Observations) -> None:
    """The same forest grown here: every tick lies among the donors that share its leaf there, and no others do."""
    from sklearn.ensemble import RandomForestRegressor

    features, change = described(logs)
    whole = np.ceil(features * GRID - 0.5).astype(np.float32)
    theirs = RandomForestRegressor(TREES, min_samples_leaf=LEAST_DONORS, random_state=3).fit(whole, change)
    trees = grow(logs, seed=3).trees
    assert len(trees.roots) == TREES
    for number in (0, 17, TREES - 1):
        leaves = theirs.estimators_[number].apply(whole)
        for row in range(0, len(change), 97):
            node = leaf_of(trees.nodes, trees.roots[number], features[row])
            first, count = int(trees.nodes[node, 1]), int(trees.nodes[node, 2])
            same = change[leaves == leaves[row]]
            np.testing.assert_allclose(np.sort(trees.donors[first : first + count, 0]), np.sort(same), atol=1e-6)


def test_no_law_explains_this_car_and_the_forest_predicts_it(learned: car_model_file.FittedCar) -> None:
    assert learned.forest is not None
    law, forest = learned.predictions
    assert (law.model, forest.model) == ("law", "forest")
    assert forest.score < 0.8 * law.score
    # 1.63/√n is the 1 % point of a calibrated model; 0.03 beyond it is what few logs may cost.
    assert forest.statistic < 1.63 / np.sqrt(forest.ticks) + 0.03
    assert forest.near_statistic < 1.63 / np.sqrt(forest.near_ticks) + 0.03
    assert law.statistic > 2.0 * forest.statistic


def test_the_law_stays_where_the_car_has_one() -> None:
    car = learn_car(logs_of(BasicController(), 96), folds=2)
    assert car.forest is None
    assert [one.model for one in car.predictions] == ["law", "forest"]


@pytest.mark.parametrize("name", ["crossing", "right_turn"])
def test_a_step_does_what_donors_did(name: str, learned: car_model_file.FittedCar) -> None:
    """Many steps from one state: the shares of changes of speed are those that the donors' leaves have."""
    scenario = load_scenario(name)
    path = np.array([(-3.0, 0.0), (0.0, 0.0), (3.0, 0.0)])
    prediction = cars.LearnedCar(learned, cars.unknown_car())
    objective, user = objective_named(Objective.DEVIATION), road_user_named(scenario.adversary.kind)
    model = compose(scenario, objective, prediction, start=(-3.0, 0.0), gap=10.0, path=path, road_user=user)
    assert prediction.kernels.own_dim == cars.FOREST_STATE_DIM - STATE_DIM
    p, rng = model.parameters, np.random.default_rng(5)
    state, after = np.zeros(model.state_dim), np.empty(model.state_dim)
    model.initial(p, state, rng)
    state[CAR_S], state[CAR_SPEED] = -12.0, 6.0
    state[cars.SIDEWAYS], state[cars.RECEDING], state[cars.CHANGE], state[cars.CHANGE_BEFORE] = 2.5, 0.0, -0.4, -0.3
    changes = []
    for _ in range(4000):
        model.step(p, state, 2, after, rng)
        changes.append(after[CAR_SPEED] - state[CAR_SPEED])
        assert after[CAR_S] >= state[CAR_S]
        assert after[CAR_SPEED] >= 0.0
        assert after[cars.CHANGE_BEFORE] == state[cars.CHANGE]
        assert after[cars.TREE] == state[cars.TREE]
    if name != "crossing":
        assert np.std(changes) > 0.01
        return
    gap, arrival = 12.0 - scenario.car.front, (12.0 - scenario.car.front) / 6.0
    there = -3.0 + 2.5 * arrival
    features = np.array([gap, -3.0, 2.5, 0.0, 2.5, 0.0, 6.0, -0.4, -0.3, arrival, there, 6.0, arrival, there])
    trees = learned.forest.trees
    donors = []
    for root in trees.roots:
        node = leaf_of(trees.nodes, root, features)
        first, count = int(trees.nodes[node, 1]), int(trees.nodes[node, 2])
        donors.append(trees.donors[first : first + count, 0])
    for limit in (-1.5, -1.0, -0.6, -0.3, 0.0):
        expected = np.mean([np.mean(one <= limit) for one in donors])
        assert abs(np.mean(np.array(changes) <= limit + 1e-9) - expected) < 4.0 * 0.5 / np.sqrt(4000)


def test_file_beside_the_yaml_belongs_to_it(learned: car_model_file.FittedCar, tmp_path: Path) -> None:
    car_model_file.write_car_model(tmp_path / "car_model.yaml", learned)
    assert car_model_file.read_car_model(tmp_path) == learned
    text = car_model_file.car_model_text(learned)
    assert replace(car_model_file.fitted_car(text), families=learned.families) == learned
    assert len(text) < 1_000_000
    beside = tmp_path / "car_model.forest"
    assert (tmp_path / "car_model.yaml").stat().st_size < 20_000
    content = beside.read_bytes()
    beside.write_bytes(content[:-1])
    with pytest.raises(UsageError, match="its SHA-256 differs"):
        car_model_file.read_car_model(tmp_path)
    beside.unlink()
    with pytest.raises(UsageError, match="cannot be read"):
        car_model_file.read_car_model(tmp_path)


SCENARIOS = {name: load_scenario(name) for name in ("cbtafs", "cptans", "right_turn")}
Parameters = namedtuple("Parameters", ("line", "straight_from", "chord", "rear", "radius"))


def left_behind(scenario: Scenario, x: float, y: float, car_s: float) -> bool:
    """Return what the model says of a place and a car, m."""
    own = Parameters(**CURVED.parameters(scenario), rear=scenario.car.rear, radius=scenario.adversary.reach)
    return bool(CURVED.left_behind(own, x, y, car_s))


def box(scenario: Scenario, car_s: float) -> shapely.Polygon:
    """Return the footprint of a car at a path coordinate, m."""
    x, y, heading = road_pose(scenario.road.line, car_s)
    car, cos, sin = scenario.car, math.cos(heading), math.sin(heading)
    corners = [(car.front, 1.0), (car.front, -1.0), (-car.rear, -1.0), (-car.rear, 1.0)]
    return shapely.Polygon(
        [
            (x + cos * ahead - side * sin * car.half_width, y + sin * ahead + side * cos * car.half_width)
            for ahead, side in corners
        ]
    )


@settings(max_examples=50)
@given(
    name=st.sampled_from(tuple(SCENARIOS)),
    car_s=st.floats(-20.0, 20.0),
    x=st.floats(-25.0, 25.0),
    y=st.floats(-25.0, 25.0),
    direction=st.floats(-math.pi, math.pi),
)
def test_who_is_left_behind_is_not_met_again(name: str, car_s: float, x: float, y: float, direction: float) -> None:
    """No road user as fast as the car, or slower, meets it again on any straight line."""
    scenario = SCENARIOS[name]
    assume(left_behind(scenario, x, y, car_s))
    reach = scenario.adversary.reach
    for way in np.linspace(0.0, 20.0, 21):
        here = shapely.Point(x + way * math.cos(direction), y + way * math.sin(direction))
        assert box(scenario, car_s + way).distance(here) >= reach - 1e-9


class ChangesLanes:
    """Brakes a little and steers to the left where a road user is less than 15 m ahead."""

    steers_by = "curvature"

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self._aside = False

    def command(self, car: CarState, adversary: AdversaryState) -> tuple[float, float]:
        self._aside |= 0.0 < adversary.y - car.y < 15.0
        heading = 0.2 * min(1.0, max(-1.0, car.x + 3.0)) if self._aside else 0.0
        return -0.5, 0.3 * (heading - (car.heading - np.pi / 2.0))


def test_of_a_car_that_evades_the_forest_says_where_it_goes_and_points() -> None:
    data = logs_of(user_controller(ChangesLanes(), "changes lanes"), 96)
    learned = learn_car(data)
    assert learned.forest.evades
    trees, (features, found) = learned.forest.trees, described(data)
    assert features.shape[1] == len(FEATURES)
    donors = np.array([_mean_donor(trees, one) for one in features[::5]])
    for column in (1, 2):
        values = found[::5, column]
        assert np.std(donors[:, column + 1] - values) < 0.3 * values.std()
    assert cars.LearnedCar(learned, cars.unknown_car()).sensor is cars.POSE
    assert car_model_file.fitted_car(car_model_file.car_model_text(learned)).forest == learned.forest
    straight = learn_car(logs_of(GradedCar(), 24))
    assert straight.forest is None or not straight.forest.evades


def _mean_donor(trees: Trees, features: np.ndarray) -> np.ndarray:
    node = leaf_of(trees.nodes, trees.roots[0], features)
    first, count = int(trees.nodes[node, 1]), int(trees.nodes[node, 2])
    return np.asarray(trees.donors[first : first + count].mean(axis=0))


class OnRoad(NamedTuple):
    """Parameters of a road's kernels."""

    line: np.ndarray


@pytest.mark.parametrize("name", ["crossing", "right_turn"])
def test_what_a_car_beside_its_line_meets_is_what_it_would_meet_on_it(name: str) -> None:
    """Seen from the car a point stays where it is when both are moved."""
    road, rng = load_scenario(name).road, np.random.default_rng(3)
    kernels = STRAIGHT if road.straight else CURVED
    parameters = OnRoad(road.line)
    for _ in range(50):
        s, offset, turned, x, y = (float(rng.uniform(-1.0, 1.0)) * by for by in (15.0, 4.0, 0.5, 8.0, 8.0))
        line_x, line_y, heading = road_pose(road.line, s)
        car = line_x + offset * np.sin(heading), line_y - offset * np.cos(heading), heading - turned
        moved = kernels.to_middle(parameters, x, y, s, (offset, turned))
        assert to_car_frame(*moved, line_x, line_y, heading) == pytest.approx(to_car_frame(x, y, *car))
    assert kernels.to_middle(parameters, x, y, s, (0.0, 0.0)) == (x, y)


@pytest.mark.parametrize("name", ["crossing", "right_turn"])
def test_the_pose_that_is_seen_is_the_cars_with_noise(name: str) -> None:
    scenario, rng = load_scenario(name), np.random.default_rng(4)
    x, y, heading = road_pose(scenario.road.line, -10.0)
    car = CarState(x + 2.0 * np.sin(heading), y - 2.0 * np.cos(heading), heading - 0.3, 8.0)
    own = beside_road(scenario.road.line, np.array([[-3.0, 1.0]]))[0]
    seen = np.array([cars.POSE.sense(scenario, (own[0], own[1]), car, rng) for _ in range(4000)])
    assert seen.mean(axis=0) == pytest.approx([-11.0, 5.0, 0.3], abs=0.06)
    assert seen.std(axis=0) == pytest.approx([1.0, 1.0, 0.1], rel=0.1)
