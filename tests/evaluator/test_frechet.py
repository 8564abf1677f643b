import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skd_evaluator.metrics.frechet import discrete_frechet, discrete_frechet_pairs, warped_distance

GOOD = [[0.0, 0.0], [1.0, 1.0]]

# On a grid of 1/64 all sums and products below are exact: properties of the distance hold without tolerance.
GRID = st.integers(-640, 640).map(lambda k: k / 64.0)


def curves(dimension: int, shortest: int = 1) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float64, st.tuples(st.integers(shortest, 12), st.just(dimension)), elements=GRID)


def row_by_row(p: np.ndarray, q: np.ndarray) -> float:
    """The textbook recurrence over a full table."""
    squared = sum((p[:, None, c] - q[None, :, c]) ** 2 for c in range(p.shape[1]))
    above = [0.0, *[math.inf] * len(q)]
    for row in squared.tolist():
        below = [math.inf]
        for j, cell in enumerate(row):
            below.append(max(cell, min(above[j + 1], below[j], above[j])))
        above = below
    return float(np.sqrt(above[-1]))


def walk(rng: np.random.Generator, n: int, dimension: int = 2) -> np.ndarray:
    return np.cumsum(rng.normal(size=(n, dimension)), axis=0)


@pytest.mark.parametrize("dimension", [1, 2, 3, 5])
@pytest.mark.parametrize(("n", "m"), [(1, 1), (1, 7), (7, 1), (2, 3), (4, 4), (13, 40), (40, 13), (63, 65), (200, 33)])
def test_equals_textbook_recurrence_bit_for_bit(n, m, dimension):
    rng = np.random.default_rng([n, m, dimension])
    for _ in range(5):
        p, q = walk(rng, n, dimension), walk(rng, m, dimension)
        assert discrete_frechet(p, q) == row_by_row(p, q)


@pytest.mark.parametrize("n", [2, 5, 17, 40, 130])
def test_equals_shapely_for_curves_of_one_length(n):
    shapely = pytest.importorskip("shapely")
    rng = np.random.default_rng([1, n])
    for _ in range(20):
        p, q = walk(rng, n), walk(rng, n)
        # Without densification GEOS computes the discrete distance over vertices, diagonal step included.
        theirs = shapely.frechet_distance(shapely.LineString(p), shapely.LineString(q))
        assert discrete_frechet(p, q) == pytest.approx(theirs, rel=1e-14)


@settings(max_examples=200)
@given(st.integers(1, 4).flatmap(lambda d: st.tuples(*[curves(d)] * 3)), st.lists(GRID, min_size=4, max_size=4))
def test_is_a_pseudometric_that_ignores_translation(three, shift):
    p, q, r = three
    distance = discrete_frechet(p, q)
    assert discrete_frechet(p, p) == 0.0
    assert discrete_frechet(q, p) == distance
    assert discrete_frechet(p, r) <= (distance + discrete_frechet(q, r)) * (1 + 1e-15)
    move = np.array(shift[: p.shape[1]])
    assert discrete_frechet(p + move, q + move) == distance


def alike(rng: np.random.Generator, n: int, dimension: int, noise: float) -> np.ndarray:
    """Points along one path, at a speed of the curve's own: few cells of a table matter."""
    times = np.sort(rng.uniform(size=n))
    path = np.stack([np.sin((1.0 + 2.0 * c) * times + c) * 10.0 for c in range(dimension)], axis=1)
    return path + rng.normal(size=(n, dimension)) * noise


@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize(("n", "m"), [(5, 90), (40, 40), (64, 31), (150, 150), (120, 310)])
def test_leaving_cells_out_changes_no_bit(n, m, dimension):
    rng = np.random.default_rng([2, n, m, dimension])
    for noise in (0.0, 0.05, 1.0):
        reference = alike(rng, n, dimension, noise)
        others = [alike(rng, int(rng.integers(1, m + 1)), dimension, noise) for _ in range(9)]
        others += [alike(rng, m, dimension, noise), reference.copy(), reference + 0.1, reference[::-1].copy()]
        exact = [row_by_row(reference, other) for other in others]
        assert [discrete_frechet(reference, other) for other in others] == exact
        assert discrete_frechet_pairs(reference, others).tolist() == exact


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ([], "n × d"),
        (np.empty((0, 2)), "n × d"),
        (np.zeros((2, 2, 2)), "n × d"),
        ([[1.0, 2.0, 3.0]], "coordinates"),
        ([[0.0, math.nan]], "not finite"),
    ],
)
def test_bad_curves_are_refused_by_name(bad, message):
    with pytest.raises(ValueError, match=message):
        discrete_frechet(bad, GOOD)
    with pytest.raises(ValueError, match=message):
        discrete_frechet_pairs(bad, [GOOD])
    with pytest.raises(ValueError, match=r"others\[1\]"):
        discrete_frechet_pairs(GOOD, [GOOD, bad])


Coupling = tuple[tuple[int, int], ...]
CURVES = st.integers(1, 5).flatmap(lambda n: hnp.arrays(np.float64, (n, 2), elements=st.floats(-10.0, 10.0, width=32)))


def couplings(n: int, m: int) -> Iterator[Coupling]:
    """Every way from the first points to the last by steps in one, in the other or in both."""
    if (n, m) == (1, 1):
        yield ((0, 0),)
    for di, dj in ((1, 0), (0, 1), (1, 1)):
        if n - di >= 1 and m - dj >= 1:
            for before in couplings(n - di, m - dj):
                yield (*before, (n - 1, m - 1))


def by_definition(phi: np.ndarray, psi: np.ndarray) -> float:
    sums = []
    for coupling in couplings(len(phi), len(psi)):
        previous = (-1, -1)
        total = 0.0
        for i, j in coupling:
            weight = (i - previous[0]) + (j - previous[1])
            total += weight * float(np.linalg.norm(phi[i] - psi[j]))
            previous = (i, j)
        sums.append(total)
    return min(sums) / (len(phi) + len(psi))


@settings(max_examples=150)
@given(CURVES, CURVES)
def test_the_warped_distance_is_the_least_over_all_couplings(phi: np.ndarray, psi: np.ndarray):
    found = warped_distance(phi, psi)
    assert found == pytest.approx(by_definition(phi, psi), rel=1e-12, abs=1e-12)
    assert found == pytest.approx(warped_distance(psi, phi), rel=1e-12, abs=1e-12)
    assert warped_distance(phi, phi) == 0.0
