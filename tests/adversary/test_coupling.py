from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from similaritymeasures import frechet_dist
from skd_adversary.crossing.path import first_row, next_row

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
def test_last_entry_is_the_discrete_frechet_distance_to_each_prefix(
    path: list[tuple[float, float]], psi: list[tuple[float, float]]
) -> None:
    phi, walked = np.array(path), np.array(psi)
    for count, state in enumerate(_rows(phi, walked), start=1):
        assert (state[:BEGIN] == 7.0).all()
        for j in range(len(phi)):
            expected = frechet_dist(phi[: j + 1], walked[:count])
            assert math.sqrt(state[BEGIN + j]) == pytest.approx(expected, abs=1e-9)
