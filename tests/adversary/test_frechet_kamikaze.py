"""The kamikaze of least Fréchet distance, and the coupling's row in its state."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import played
from similaritymeasures import frechet_dist
from skd_adversary.crossing.cars import known_basic_car, unknown_car
from skd_adversary.crossing.model import compose
from skd_adversary.crossing.objectives import FRECHET, FRECHET_REWARDS
from skd_adversary.crossing.path import first_row, next_row
from skd_adversary.crossing.road_users import ACTION_COUNT
from skd_adversary.pomdp.model import Pomdp
from skd_sim.scenario.scenario import load_scenario

CROSSING = load_scenario("crossing")
BENT = np.array([(-3.5, 0.0), (-2.75, 0.0), (-2.2, 0.5), (-1.4, 0.5), (-0.7, 0.5), (0.1, 0.0), (0.9, 0.0), (2.4, 0.0)])
LIMITS = (None, 1.8, 1.5)


def _model(limit: float | None = None, *, known: bool = True) -> Pomdp:
    car = known_basic_car(0.75) if known else unknown_car()
    start = (float(BENT[0, 0]), float(BENT[0, 1]))
    return compose(CROSSING, FRECHET, car, start=start, gap=13.0, path=BENT, maximum_distance=limit)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("limit", LIMITS)
def test_return_of_a_collision_is_its_reward_less_the_frechet_distance(limit: float | None, known: bool) -> None:
    """Play the model with the default policy and with random actions; measure ψ with another library."""
    model, rng = _model(limit, known=known), np.random.default_rng(1)
    collisions = beyond = 0
    for episode in range(300):
        walked, earned, terminal, contact, _ = played(model, rng, ACTION_COUNT, by_policy=bool(episode % 2))
        spent = FRECHET_REWARDS["step_reward"] * (len(walked) - 1)
        distance = frechet_dist(BENT, walked)
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
