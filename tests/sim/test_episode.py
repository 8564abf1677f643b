from __future__ import annotations

import math

import numpy as np
import pytest
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, Trajectory

CROSSING = load_scenario("crossing")  # path edge 1.15 m
MEETING = load_scenario("citr_crossing")  # path edge 0.85 m


def _along(*x: float, time_step: float = 0.3) -> Trajectory:
    return Trajectory(np.column_stack([x, np.zeros(len(x))]), time_step, "walk")


@pytest.mark.parametrize(
    ("x", "expected"),
    [
        ((-3.15, -2.15, -1.15, 0.0), 2.0),
        ((-3.15, -0.15), 2.0 / 3.0),
        ((3.15, 0.15), 2.0 / 3.0),
        ((-1.0, 0.0, 2.0), 0.0),
        ((-5.0, 5.0), 3.85 / 10.0),
        ((5.0, -5.0), 3.85 / 10.0),
        ((-5.0, -3.0, -5.0, -3.0, 1.0), 3.0 + 1.85 / 4.0),
    ],
)
def test_entry_time_in_steps(x: tuple[float, ...], expected: float) -> None:
    assert CROSSING.end.entry_time(_along(*x)) == pytest.approx(0.3 * expected, abs=1e-12)


def _episode(mode: Mode, scenario: Scenario = CROSSING, phi: Trajectory | None = None) -> EpisodeSpec:
    return EpisodeSpec(scenario, mode, seed=0, episode_id=0, safe_trajectory=phi)


def test_start_and_gap() -> None:
    adversary, car = CROSSING.adversary, CROSSING.car
    assert _episode(Mode.SAFE).start == (adversary.start_x, adversary.start_y)
    phi = Trajectory(np.array([[-4.0, 1.0], [1.0, 1.0]]), 0.3)
    assert _episode(Mode.REPLAY, CROSSING, phi).start == (-4.0, 1.0)
    assert _episode(Mode.REPLAY, CROSSING, phi).start_gap == car.start_gap
    expected = MEETING.car.start_speed * 0.3 * (4.0 - 0.85) / 5.0
    assert _episode(Mode.REPLAY, MEETING, phi).start_gap == pytest.approx(expected)
    assert _episode(Mode.SAFE, MEETING).start_gap == MEETING.car.start_gap


PHI = _along(-3.0, -1.0, 1.0, 3.0)
LAST = CROSSING.ticks


@pytest.mark.parametrize(
    ("mode", "tick", "x", "collided", "expected"),
    [
        (Mode.SAFE, 1, -3.5, False, Outcome.RUNNING),
        (Mode.SAFE, 9, 1.99, False, Outcome.RUNNING),
        (Mode.SAFE, 9, 2.0, False, Outcome.ARRIVED),
        (Mode.SAFE, 9, 2.0, True, Outcome.COLLISION),
        (Mode.SAFE, LAST - 1, 0.0, False, Outcome.RUNNING),
        (Mode.SAFE, LAST, 0.0, False, Outcome.TIMEOUT),
        (Mode.SAFE, LAST, 2.0, False, Outcome.ARRIVED),
        (Mode.KAMIKAZE, 5, 1.15, False, Outcome.RUNNING),
        (Mode.KAMIKAZE, 5, 1.16, False, Outcome.MISSED),
        (Mode.KAMIKAZE, 5, 1.16, True, Outcome.COLLISION),
        (Mode.KAMIKAZE, LAST, 0.0, False, Outcome.TIMEOUT),
        (Mode.REPLAY, 2, 1.0, False, Outcome.RUNNING),
        (Mode.REPLAY, 3, 3.0, False, Outcome.ARRIVED),
        (Mode.REPLAY, 3, 3.0, True, Outcome.COLLISION),
    ],
)
def test_outcomes(mode: Mode, tick: int, x: float, collided: bool, expected: Outcome) -> None:
    episode = _episode(mode, CROSSING, None if mode == Mode.SAFE else PHI)
    assert episode.outcome(tick, AdversaryState(x, 0.0, 0.0, 0.0), collided=collided) == expected


def test_the_adversary_is_at_the_end_where_the_two_touch() -> None:
    """Contact after half of the second tick: half way between its ends."""
    car = np.array([[0.0, y, math.pi / 2, 8.0] for y in (-16.0, -14.0, -11.0)])
    walk = np.array([[-2.0, 0.0], [-1.0, 0.0], [0.0, -1.0]])
    log = EpisodeLog(_episode(Mode.SAFE), Outcome.COLLISION, walk, car, 1.5 * CROSSING.time_step, 8.0)
    np.testing.assert_allclose(log.trajectory.positions[-1], [-0.5, -0.5])
