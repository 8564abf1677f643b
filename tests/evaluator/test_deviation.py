"""Deviation and distances: by hand, and their properties."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skd_evaluator.metrics.clustered import GroupedMean
from skd_evaluator.metrics.deviation import deviation, deviation_pairs, mean_deviation
from skd_evaluator.metrics.frechet import discrete_frechet
from skd_evaluator.metrics.measures import Measured, Pair, load_measures, pair_of
from skd_evaluator.metrics.skd import frechet_distances, prefix_distances
from skd_evaluator.metrics.statistics import mean
from skd_sim import EpisodeLog, EpisodeSpec, Mode, Outcome, Trajectory, load_scenario
from test_frechet import curves

Curves = tuple[np.ndarray, np.ndarray, float]


def psis_of(dimension: int) -> st.SearchStrategy[tuple[np.ndarray, float]]:
    def timed(psi: np.ndarray) -> st.SearchStrategy[tuple[np.ndarray, float]]:
        shares = st.integers(0 if len(psi) == 1 else 1, 64).map(lambda k: k / 64.0)
        return shares.map(lambda share: (psi, 0.0 if len(psi) == 1 else len(psi) - 2 + share))

    return curves(dimension).flatmap(timed)


def pairs(dimension: int = 2) -> st.SearchStrategy[Curves]:
    return st.tuples(curves(dimension), psis_of(dimension)).map(lambda pair: (pair[0], *pair[1]))


def walked(phi: np.ndarray, duration: float, count: int) -> np.ndarray:
    """Return ψ of somebody who walks φ up to a contact."""
    times = np.array([*range(count - 1), duration])
    return np.column_stack([np.interp(times, np.arange(len(phi)), column) for column in phi.T])


@pytest.mark.parametrize(
    ("psi", "duration", "expected"),
    [
        ([[0, 0], [0, 0], [0, 0]], 2.0, 2.0),  # stands, while φ goes on
        ([[0, 0], [0, 0], [0, 0]], 1.25, 1.25),  # but only until the contact
        ([[0, 0], [1, 3], [1.5, 4]], 1.5, 4.0),  # a way aside
        ([[0, 0], [1, 4], [1.5, 3]], 1.5, 4.0),  # and back again: the farthest counts
        ([[0, 0], [2, 0], [4, 0], [6, 0], [7, 0]], 3.5, 4.0),  # twice as fast; φ stands at 3 from tick 3 on
        ([[0, 2]], 0.0, 2.0),  # touched where it starts
        ([[0, 0], [0.25, 0]], 0.25, 0.0),
    ],
)
def test_pairs_whose_deviation_is_plain(psi: list[list[float]], duration: float, expected: float) -> None:
    phi = [[0, 0], [1, 0], [2, 0], [3, 0]]
    assert deviation(phi, psi, duration) == expected
    assert deviation_pairs(phi, [psi], [duration]) == [expected]


@given(curves(2, shortest=2), st.integers(2, 20), st.integers(1, 64), st.data())
def test_it_is_0_exactly_where_psi_walks_phi(phi: np.ndarray, count: int, share: int, data: st.DataObject) -> None:
    duration = count - 2 + share / 64.0
    psi = walked(phi, duration, count)
    assert deviation(phi, psi, duration) == 0.0
    row, axis = data.draw(st.integers(0, count - 1)), data.draw(st.integers(0, 1))
    psi[row, axis] += 1 / 64
    assert deviation(phi, psi, duration) == 1 / 64


@given(pairs())
def test_no_coupling_of_the_places_is_worse_than_that_of_the_times(pair: Curves) -> None:
    phi, psi, duration = pair
    assert discrete_frechet(walked(phi, duration, len(psi)), psi) <= deviation(phi, psi, duration) + 1e-12


@given(st.integers(1, 4).flatmap(lambda d: st.tuples(curves(d), st.lists(psis_of(d), max_size=6))))
def test_a_batch_has_the_bits_of_singles(case: tuple[np.ndarray, list[tuple[np.ndarray, float]]]) -> None:
    phi, psis = case
    phi = phi * math.pi  # off the grid, so that roundings differ where operations do
    batch = deviation_pairs(phi, [psi for psi, _ in psis], [duration for _, duration in psis])
    assert batch.tolist() == [deviation(phi, psi, duration) for psi, duration in psis]


def of(distances: list[list[float]], failed: list[int], eta_max: float = 5.0) -> tuple[GroupedMean, GroupedMean]:
    trials = [np.array([*hits, *[np.inf] * missed]) for hits, missed in zip(distances, failed, strict=True)]
    return mean_deviation(trials, eta_max=eta_max)


def test_failed_trials_and_far_ones_count_as_eta_max() -> None:
    every, hits = of([[0.5, 7.0], [1.5]], [1, 0])
    assert every.values.tolist() == [0.5, 5.0, 5.0, 1.5]
    assert (every.mean, every.means) == (3.0, [3.5, 1.5])
    assert (hits.mean, hits.means) == (3.0, [3.75, 1.5])  # (0.5 + 7 + 1.5) / 3: what was needed
    half = 1.959963984540054 * np.std([0.5, 5.0, 5.0, 1.5], ddof=1) / 2.0
    assert every.plain_interval == pytest.approx((3.0 - half, 3.0 + half))


def test_without_a_trial_there_is_no_figure() -> None:
    for part in (*of([[], []], [0, 0]), *mean_deviation([], eta_max=5.0)):
        assert (part.mean, part.plain_interval, part.interval) == (None, None, None)


CROSSING = load_scenario("crossing")
STEP = CROSSING.time_step
WARPED = load_measures()["warped"]
MEASURES = {
    "frechet": lambda phi, pairs: frechet_distances(phi, [one.psi for one in pairs]),
    "prefix": lambda phi, pairs: prefix_distances(phi, [one.psi for one in pairs]),
    "deviation": lambda phi, pairs: deviation_pairs(
        phi.positions, [one.psi.positions for one in pairs], [one.duration for one in pairs]
    ),
    "warped": WARPED.of,
}
"""Distances between two trajectories."""
PLACES = st.integers(-40, 40).map(lambda count: count / 8)
"""On a grid of eighths, where sums and doubles are exact."""
WALKS = st.integers(2, 9).flatmap(lambda ticks: hnp.arrays(np.float64, (ticks, 2), elements=PLACES))

World = tuple[Trajectory, list[Pair]]


def world(phi: np.ndarray, walks: Sequence[np.ndarray], shares: Sequence[float]) -> World:
    """φ and the pairs of it: each walk ends in a contact within its last tick."""
    safe = Trajectory(phi, STEP, "φ")
    pairs = []
    for number, (walk, share) in enumerate(zip(walks, shares, strict=True)):
        spec = EpisodeSpec(CROSSING, Mode.KAMIKAZE, 0, number, safe_trajectory=safe)
        time = (len(walk) - 2 + share) * STEP
        car = np.zeros((len(walk), 4))
        pairs.append(pair_of(EpisodeLog(spec, Outcome.COLLISION, walk, car, time, 3.0)))
    return safe, pairs


@st.composite
def worlds(draw: st.DrawFn) -> tuple[np.ndarray, list[np.ndarray], list[float]]:
    walks = draw(st.lists(WALKS, min_size=1, max_size=4))
    shares = [draw(st.integers(1, 8)) / 8 for _ in walks]
    return draw(WALKS), walks, shares


def values(name: str, one: World) -> np.ndarray:
    return np.asarray(MEASURES[name](*one), np.float64)


@pytest.mark.parametrize("name", MEASURES)
@given(worlds(), st.floats(-math.pi, math.pi), st.booleans(), st.tuples(PLACES, PLACES))
@settings(max_examples=15)
def test_rigid_motion_of_the_world_changes_nothing(name, drawn, angle, mirrored, shift):
    phi, walks, shares = drawn
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    if mirrored:
        turn = turn @ np.diag([-1.0, 1.0])

    def moved(path: np.ndarray) -> np.ndarray:
        return path @ turn.T + shift

    before = values(name, world(phi, walks, shares))
    after = values(name, world(moved(phi), [moved(one) for one in walks], shares))
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-9)


NUMBERS = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=6)


@given(NUMBERS, st.integers(0, 5), st.randoms(use_true_random=False))
@settings(max_examples=30)
def test_a_measure_without_a_value_counts_as_undefined_and_not_into_the_mean(numbers, more, draw):
    every = [*numbers, *([math.nan] * more)]
    draw.shuffle(every)
    figures = Measured(WARPED, (np.array(every),), 0.95).as_dict()
    assert figures["mean"] == mean(numbers)
    assert (figures["pairs"], figures["undefined"]) == (len(numbers), more)
    assert Measured(WARPED, (np.full(more, math.nan),), 0.95).as_dict()["mean"] is None
