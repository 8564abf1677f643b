"""What holds for every measure of pairs, in moved and scaled worlds and any order; and what becomes of no numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skd_evaluator.metrics.clustered import clustered_mean
from skd_evaluator.metrics.deviation import deviation_pairs
from skd_evaluator.metrics.measures import Measured, Pair, load_measures, pair_of
from skd_evaluator.metrics.skd import frechet_distances, prefix_distances
from skd_evaluator.metrics.statistics import mean, normal_interval, sample_variance
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import Trajectory

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


# --- values that are none

NUMBERS = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=6)
NONE = st.sampled_from([math.nan, math.inf, -math.inf])


@given(NUMBERS, NONE, st.integers(0, 6))
@settings(max_examples=30)
def test_a_mean_of_what_is_none_is_refused(numbers, none, place):
    numbers = [*numbers[:place], none, *numbers[place:]]
    for figure in (mean, sample_variance, normal_interval):
        with pytest.raises(ValueError, match="must be finite"):
            figure(numbers)
    with pytest.raises(ValueError, match="finite"):
        clustered_mean([[1.0], numbers], 0.95)


@given(NUMBERS, st.integers(0, 5), st.randoms(use_true_random=False))
@settings(max_examples=30)
def test_a_measure_without_a_value_counts_as_undefined_and_not_into_the_mean(numbers, more, draw):
    every = [*numbers, *([math.nan] * more)]
    draw.shuffle(every)
    figures = Measured(WARPED, (np.array(every),), 0.95).as_dict()
    assert figures["mean"] == mean(numbers)
    assert (figures["pairs"], figures["undefined"]) == (len(numbers), more)
    assert Measured(WARPED, (np.full(more, math.nan),), 0.95).as_dict()["mean"] is None
