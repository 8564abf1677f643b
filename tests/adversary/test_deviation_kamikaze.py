"""Kamikazes that deviate as little as they can, by deviation or Fréchet distance."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import played
from recorded_cars import a_car
from similaritymeasures import frechet_dist
from skd_adversary.crossing.cars import FITTED_STATE_DIM, WAITING_REWARD, LearnedCar, known_basic_car, unknown_car
from skd_adversary.crossing.interfaces import CAR_S, CAR_SPEED, STATE_DIM
from skd_adversary.crossing.kamikaze import DEVIATION
from skd_adversary.crossing.model import compose
from skd_adversary.crossing.objectives import FRECHET, FRECHET_REWARDS, first_row, next_row
from skd_adversary.crossing.road_users import ACTION_COUNT, AS_PHI, EAST, STAY
from skd_adversary.pomdp.model import Pomdp
from skd_evaluator import deviation, run_episode
from skd_sim import EpisodeLog, EpisodeSpec, Mode, Outcome, Trajectory, load_scenario
from skd_sim.options.car_and_adversary import Objective

CROSSING = load_scenario("crossing")
BENT = np.array([(-3.5, 0.0), (-2.75, 0.0), (-2.2, 0.5), (-1.7, 0.6), (-0.9, 0.5), (0.1, 0.0), (0.9, -0.1), (2.4, 0.0)])
STRAIGHT = Trajectory(np.column_stack([np.arange(-3.5, 3.0, 0.75), np.zeros(9)]), CROSSING.time_step)
SLOW = Trajectory(np.column_stack([np.arange(-3.5, 3.0, 0.41), 0.1 * np.sin(np.arange(16))]), CROSSING.time_step)


def a_model(limit: float | None = None, *, known: bool = True, fitted: bool = False) -> Pomdp:
    car = known_basic_car(0.75) if known else unknown_car()
    start = (float(BENT[0, 0]), float(BENT[0, 1]))
    predicted = LearnedCar(a_car(), car) if fitted else car
    return compose(CROSSING, DEVIATION, predicted, start=start, gap=13.0, path=BENT, maximum_distance=limit)


def a_kamikaze(path: Trajectory, number: int, **fields: object) -> EpisodeSpec:
    fields = {"objective": Objective.DEVIATION, "simulations": 200, **fields}
    return EpisodeSpec(CROSSING, Mode.KAMIKAZE, 5, number, safe_trajectory=path, **fields)  # type: ignore[arg-type]


def strayed(log: EpisodeLog) -> float:
    """The deviation of an episode's ψ, by the measure."""
    phi = log.episode.safe_trajectory
    return deviation(phi.positions, log.trajectory.positions, log.impact_time / log.episode.scenario.time_step)


def by_hand(walked: np.ndarray, share: float) -> float:
    """The greatest distance from BENT at 200 times of each tick, of which the last is a share of one."""
    ticks = np.arange(len(walked) - 1)
    own = (ticks[:, None] + np.linspace(0.0, 1.0, 200)).ravel()
    times = own.copy()
    times[-200:] = ticks[-1] + share * (own[-200:] - ticks[-1])
    here = [np.interp(own, np.arange(len(walked)), walked[:, axis]) for axis in range(2)]
    there = [np.interp(times, np.arange(len(BENT)), BENT[:, axis]) for axis in range(2)]
    return float(np.hypot(*(np.array(here) - np.array(there))).max())


@pytest.mark.parametrize("limit", [None, 1.0])
@pytest.mark.parametrize(("known", "fitted"), [(True, False), (False, False), (True, True)])
def test_return_of_a_collision_is_its_reward_less_the_deviation(limit: float | None, known: bool, fitted: bool):
    """Play the model with the default policy and with random actions; measure ψ at many times of each tick."""
    model, rng = a_model(limit, known=known, fitted=fitted), np.random.default_rng(1)
    collisions = beyond = walked_into = 0
    for episode in range(60):
        walked, earned, terminal, contact, impact = played(model, rng, ACTION_COUNT + 1, by_policy=bool(episode % 2))
        spent = WAITING_REWARD * max(0, len(walked) - len(BENT))
        distance = by_hand(walked, min(1.0, contact))
        if contact <= 1.0 and distance <= (limit or math.inf) and not CROSSING.collision.is_hit(impact):
            walked_into += 1
            assert terminal
            assert earned == pytest.approx(spent, abs=1e-12)
        elif contact <= 1.0 and distance <= (limit or math.inf):
            collisions += 1
            gained = spent + CROSSING.eta_max
            assert earned == pytest.approx(gained - distance, abs=0.02)  # what 1/200 of a tick changes
            assert earned == pytest.approx(gained - deviation(BENT, walked, len(walked) - 2 + contact), abs=1e-9)
        else:
            beyond += distance > (limit or math.inf)
            assert earned <= spent + 1e-12
    assert collisions > 10
    assert known or limit is not None or walked_into > 0
    assert limit is None or beyond > 10


@pytest.mark.parametrize("fitted", [False, True])
def test_as_phi_takes_the_steps_of_phi_and_then_none(fitted: bool) -> None:
    model = a_model(fitted=fitted)
    p, rng = model.parameters, np.random.default_rng(2)
    row = FITTED_STATE_DIM if fitted else STATE_DIM
    state, after = np.empty(model.state_dim), np.empty(model.state_dim)
    model.initial(p, state, rng)
    for tick in range(len(BENT) + 2):
        state[CAR_S], state[CAR_SPEED] = -200.0, 0.0  # out of the way
        _, terminal = model.step(p, state, AS_PHI, after, rng)
        np.testing.assert_allclose(after[:2], BENT[min(tick + 1, len(BENT) - 1)], rtol=0.0, atol=1e-12)
        assert math.sqrt(after[row]) < 1e-12
        state, after = after, state
        if terminal:
            break
    assert tick >= 6  # until beyond the path's edge


@pytest.mark.parametrize("path", [STRAIGHT, SLOW], ids=["straight", "slow"])
def test_who_is_hit_along_phi_does_not_leave_it(path: Trajectory) -> None:
    """A car that never brakes, seen without noise, and a φ that it hits in the middle of its way through the strip."""
    gap = float(25 / 3 * 0.3 * np.argmin(np.abs(path.positions[:, 0])))
    car = replace(CROSSING.car, start_gap=gap, start_gap_range=0.01)
    scenario = replace(CROSSING, adversary=replace(CROSSING.adversary, position_noise=1e-3), car=car)
    for number in range(3):
        log = run_episode(replace(a_kamikaze(path, number, multiplier=0.0), scenario=scenario))
        assert log.outcome == Outcome.COLLISION
        assert strayed(log) < 1e-9


@pytest.mark.parametrize("limit", [0.05, 0.4, 0.9])
def test_the_budget_is_hard(limit: float) -> None:
    """Who strays further does so in one tick, in which the car could have been met before, and then goes on as φ."""
    found = []
    for number in range(30):
        log = run_episode(a_kamikaze(STRAIGHT, number, multiplier=0.625, maximum_distance=limit))
        assert log.outcome in (Outcome.COLLISION, Outcome.MISSED, Outcome.TIMEOUT)
        phi = STRAIGHT.positions[np.minimum(np.arange(len(log.adversary)), len(STRAIGHT) - 1)]
        apart = np.hypot(*(log.adversary - phi).T)
        beyond = np.flatnonzero(apart > limit)
        if len(beyond) and beyond[0] + 1 < len(apart):  # from then on as φ
            steps = [np.diff(places[beyond[0] :], axis=0) for places in (log.adversary, phi)]
            np.testing.assert_allclose(*steps, atol=1e-12)
        elif log.outcome == Outcome.COLLISION and strayed(log) <= limit:
            found.append(strayed(log))
    assert found


def test_no_displacement_is_offered_twice() -> None:
    """φ goes East at the pedestrian's own speed first: EAST is as φ; after its end, STAY is."""
    model = a_model()
    state = np.empty(model.state_dim)
    model.initial(model.parameters, state, np.random.default_rng(3))
    for tick, same in ((0, EAST), (1, None), (len(BENT), STAY)):
        state[STATE_DIM + 1] = tick
        offered = {action for action in range(ACTION_COUNT + 1) if model.legal(model.parameters, state, action)}
        assert offered == set(range(ACTION_COUNT + 1)) - {same}
    strict = a_model(0.1)
    state[STATE_DIM] = 0.02  # m², beyond 0.1 m
    assert [a for a in range(ACTION_COUNT + 1) if strict.legal(strict.parameters, state, a)] == [AS_PHI]


BENT_FRECHET = np.array(
    [(-3.5, 0.0), (-2.75, 0.0), (-2.2, 0.5), (-1.4, 0.5), (-0.7, 0.5), (0.1, 0.0), (0.9, 0.0), (2.4, 0.0)]
)
LIMITS = (None, 1.8, 1.5)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("limit", LIMITS)
def test_return_of_a_collision_is_its_reward_less_the_frechet_distance(limit: float | None, known: bool) -> None:
    """Play the model with the default policy and with random actions; measure ψ with another library."""
    car, start = known_basic_car(0.75) if known else unknown_car(), tuple(BENT_FRECHET[0].tolist())
    model = compose(CROSSING, FRECHET, car, start=start, gap=13.0, path=BENT_FRECHET, maximum_distance=limit)
    rng = np.random.default_rng(1)
    collisions = beyond = 0
    for episode in range(300):
        walked, earned, terminal, contact, _ = played(model, rng, ACTION_COUNT, by_policy=bool(episode % 2))
        spent = FRECHET_REWARDS["step_reward"] * (len(walked) - 1)
        distance = frechet_dist(BENT_FRECHET, walked)
        if terminal and contact <= 1.0 and distance <= (limit or np.inf):
            collisions += 1
            assert earned == pytest.approx(spent + FRECHET_REWARDS["collision_reward"] - distance, abs=1e-9)
        else:
            beyond += contact <= 1.0
            assert earned == pytest.approx(spent, abs=1e-9)
    assert collisions > 20
    assert limit is None or beyond > 0


coordinate = st.floats(-20.0, 20.0)
curve = st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=12)
BEGIN = 3  # the row lies somewhere within a state


def _rows(path: np.ndarray, psi: np.ndarray) -> list[np.ndarray]:
    state = np.full(BEGIN + len(path), 7.0)
    first_row(*psi[0], path, state, BEGIN)
    rows = [state.copy()]
    for point in psi[1:]:
        after = np.full_like(state, 7.0)
        least = next_row(*point, path, state, after, BEGIN)
        assert least == after[BEGIN:].min()
        state = after
        rows.append(state.copy())
    return rows


@given(path=curve, psi=curve)
def test_last_entry_is_the_discrete_frechet_distance_to_each_prefix(path, psi):
    phi, walked = np.array(path), np.array(psi)
    for count, state in enumerate(_rows(phi, walked), start=1):
        assert (state[:BEGIN] == 7.0).all()
        for j in range(len(phi)):
            expected = frechet_dist(phi[: j + 1], walked[:count])
            assert math.sqrt(state[BEGIN + j]) == pytest.approx(expected, abs=1e-9)
