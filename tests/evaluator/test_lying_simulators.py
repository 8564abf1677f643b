"""Simulators of users, right ones and such as break the contract."""

import math
import os
import random
from dataclasses import replace

import numpy as np
import pytest
from common import refused
from skd_evaluator import AssessmentError, assess, run_episode
from skd_sim import AdversaryState, Trajectory, load_scenario
from skd_sim.controllers.basic import BasicController
from skd_sim.options.car_and_adversary import SIMULATORS
from skd_sim.simulators.simulator import Frame, SimulatorError, WorldSimulator
from skd_sim.world.episode import AbortKind, EpisodeLog, EpisodeSpec, Mode, Outcome, kind_of

CROSSING = load_scenario("crossing")
STEP = CROSSING.time_step
QUIET = replace(CROSSING, car=replace(CROSSING.car, speed_noise=0.0, acceleration_noise=0.0, start_gap_range=0.0))
TINY = {
    "safe_count": 2, "kamikaze_count": 1, "collision_runs": 4, "simulations": 20, "workers": 1, "behaviour": "none",
    "objective": "deviation",
}  # fmt: skip


class Named(WorldSimulator):
    """SKD's own world by another name."""

    repeats_itself = True


class NanSpeed(Named):
    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        frame = super().step(acceleration, velocity)
        return frame._replace(car=frame.car._replace(speed=math.nan))


class Forgetful(Named):
    """Does not repeat itself, though it says so."""

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        return super().step(acceleration + random.uniform(-3.0, 3.0), velocity)


class Stays(Named):
    """Its pedestrian does not obey."""

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        return super().step(acceleration, (0.0, 0.0))


class Jumps(Named):
    """Its car is thirty metres further on from the second tick on."""

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        frame = super().step(acceleration, velocity)
        return frame if frame.tick < 2 else frame._replace(car=frame.car._replace(y=frame.car.y + 30.0))


class Raises(Named):
    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        raise ValueError("boom")


class Gone(Named):
    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        frame = super().step(acceleration, velocity)
        if frame.tick == 2:
            raise SimulatorError(AbortKind.NO_ANSWER, "it is gone")
        return frame


class Skips(Named):
    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        frame = super().step(acceleration, velocity)
        return frame._replace(tick=frame.tick + 1)


class Endless(Named):
    """Its pedestrian stands still, and no tick is the last one."""

    def reset(self, episode: EpisodeSpec) -> Frame:
        self._now = super().reset(episode)
        return self._now

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        x, y = self._now.adversary.x + STEP * velocity[0], self._now.adversary.y + STEP * velocity[1]
        self._now = Frame(self._now.tick + 1, self._now.car, AdversaryState(x, y, *velocity))
        return self._now

    clipped = 0  # type: ignore[assignment]


class Dies(Named):
    """Ends its process in the second tick of some episodes."""

    def reset(self, episode: EpisodeSpec) -> Frame:
        self._mortal = episode.mode == Mode.REPLAY and episode.episode_id % 2 == 0
        return super().reset(episode)

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        frame = super().step(acceleration, velocity)
        if self._mortal and frame.tick == 2:
            os._exit(7)
        return frame


@pytest.fixture(autouse=True)
def simulators(monkeypatch: pytest.MonkeyPatch) -> None:
    for one in (Named, NanSpeed, Forgetful, Stays, Jumps, Raises, Gone, Skips, Endless, Dies):
        monkeypatch.setitem(SIMULATORS.own, one.__name__.lower(), f"{__name__}:{one.__name__}")


def crossed(simulator: str, multiplier: float = 1.0) -> EpisodeLog:
    """Run an episode of a pedestrian who crosses at 1.4 m/s."""
    ticks = np.arange(30)
    x = -3.0 + 1.4 * STEP * ticks
    phi = Trajectory(np.column_stack([x, np.zeros(30)]), STEP)
    episode = EpisodeSpec(
        QUIET, Mode.REPLAY, 3, 2 << 30, safe_trajectory=phi, multiplier=multiplier, simulator=simulator
    )  # fmt: skip
    return run_episode(episode, BasicController(multiplier))


def test_the_world_by_another_name_is_the_world():
    """What is honest passes to the last bit, also where the car hits."""
    outcomes = set()
    for multiplier in (0.0, 2.0):
        there, here = crossed("named", multiplier), crossed("world", multiplier)
        assert there.outcome == here.outcome
        np.testing.assert_array_equal(there.car, here.car)
        np.testing.assert_array_equal(there.adversary, here.adversary)
        outcomes.add(there.outcome)
    assert outcomes == {Outcome.COLLISION, Outcome.ARRIVED}


@pytest.mark.parametrize(
    ("simulator", "kind", "what"),
    [
        ("nanspeed", AbortKind.NOT_FINITE, "speed of the car is nan in tick 1"),
        ("stays", AbortKind.REFUTED, "in tick 1 the adversary goes 0.42 m beside its commanded way"),
        ("jumps", AbortKind.REFUTED, "gave what cannot have happened: the car goes 32"),
        ("endless", AbortKind.REFUTED, ""),
    ],
)
def test_an_episode_that_cannot_be_is_aborted(simulator: str, kind: AbortKind, what: str):
    log = crossed(simulator)
    assert log.outcome == Outcome.ABORTED
    assert kind_of(log.reason) == kind
    assert log.reason.startswith(f"{kind}: simulator {simulator}")
    assert what in log.reason
    assert "\n" not in log.reason


@pytest.mark.parametrize(
    ("simulator", "line"),
    [
        ("raises", "step failed with ValueError: boom (tests/evaluator/test_lying_simulators.py, line "),
        ("skips", "step must return the frame of tick 1, got that of tick 2"),
    ],
)
def test_what_is_no_answer_ends_the_assessment_in_one_line(simulator: str, line: str):
    with refused(f"simulator {simulator}: {line}", error=AssessmentError):
        crossed(simulator)


def test_who_says_that_it_repeats_itself_has_to():
    random.seed(5)
    found = assess("basic", simulator="forgetful", margin_limit=64, **TINY)
    begin = "not credible: simulator forgetful, or controller basic, does not repeat itself"
    assert any(one.startswith(begin) for one in found.warnings)
    assert found.margins is not None


def test_one_that_ends_its_process_aborts_its_episodes_by_name():
    """With one worker as well: it is a process of its own."""
    with pytest.warns(UserWarning, match="not credible: 2 of 6 episodes were aborted, more than --max-aborted 5 %"):
        found = assess("basic", simulator="dies", margin_limit=0, **TINY)
    assert len(found.reasons) == 2
    for one in found.reasons:
        assert kind_of(one) == AbortKind.ENDED
        assert "exit code 7" in one
        assert "simulator dies" in one
    allowed = assess("basic", simulator="dies", margin_limit=0, max_aborted=100.0, **TINY)
    assert not any("more than --max-aborted" in one for one in allowed.warnings)


def test_one_that_fails_aborts_the_episode() -> None:
    log = crossed("gone")
    assert (log.outcome, log.reason) == (Outcome.ABORTED, "no answer: it is gone")
    assert math.isnan(log.impact_time)
