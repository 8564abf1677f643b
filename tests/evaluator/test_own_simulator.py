"""A simulator of a user's own, in process: two methods and a count are enough."""

from __future__ import annotations

import math

import numpy as np
import pytest
from skd_evaluator.assessment.run.episodes import run_episode
from skd_sim.scenario.scenario import load_scenario
from skd_sim.simulators.simulator import Frame, SimulatorError, WorldSimulator
from skd_sim.world.episode import AbortKind, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, CarState
from skd_sim.world.world import Contact

EPISODE = EpisodeSpec(load_scenario("crossing"), Mode.SAFE, 3, 1, simulations=40)


class Scripted:
    """The car stands still; the adversary goes where it is told, and is hit in the third tick."""

    clipped = 7

    def __init__(self) -> None:
        self.told: list[tuple[float, tuple[float, float]]] = []

    def reset(self, episode: EpisodeSpec) -> Frame:
        self._adversary = AdversaryState(*episode.start, 0.0, 0.0)
        return Frame(0, CarState(0.0, -20.0, math.pi / 2, 5.0), self._adversary)

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        self.told.append((acceleration, velocity))
        tick = len(self.told)
        x, y = self._adversary.x + 0.3 * velocity[0], self._adversary.y + 0.3 * velocity[1]
        self._adversary = AdversaryState(x, y, *velocity)
        hit = tick == 3
        contact, outcome = (Contact(0.5, 4.0), Outcome.COLLISION) if hit else (None, Outcome.RUNNING)
        return Frame(tick, CarState(0.0, -20.0, math.pi / 2, 5.0), self._adversary, contact, outcome)


class Failing(WorldSimulator):
    """The world, until it is gone in the second tick."""

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        frame = super().step(acceleration, velocity)
        if frame.tick == 2:
            raise SimulatorError(AbortKind.NO_ANSWER, "it is gone")
        return frame


def test_the_log_is_what_the_simulator_says() -> None:
    simulator = Scripted()
    log = run_episode(EPISODE, simulator=simulator)
    assert log.outcome == Outcome.COLLISION
    steps = np.array([velocity for _, velocity in simulator.told])
    walked = np.array(EPISODE.start) + 0.3 * np.cumsum(np.vstack([(0.0, 0.0), steps]), axis=0)
    np.testing.assert_allclose(log.adversary, walked, atol=1e-12)
    assert log.car.tolist() == [[0.0, -20.0, math.pi / 2, 5.0]] * 4
    assert (log.impact_time, log.impact_speed) == (pytest.approx(2.5 * 0.3), 4.0)
    assert log.clipped == 7


def test_one_that_fails_aborts_the_episode() -> None:
    log = run_episode(EPISODE, simulator=Failing())
    assert (log.outcome, log.reason) == (Outcome.ABORTED, "no answer: it is gone")
    assert math.isnan(log.impact_time)
    assert run_episode(EPISODE).outcome != Outcome.ABORTED
