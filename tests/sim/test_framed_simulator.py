"""An episode that is watched frame by frame means by a contact, a tick and an end what the world means by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from skd_sim.dynamics.limits import CommandLimits
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.episode.episode import Episode, Mode, Outcome
from skd_sim.errors import UsageError
from skd_sim.simulation.framed_simulator import FramedSimulator
from skd_sim.simulation.simulator import Frame, Simulator, WorldSimulator
from skd_sim.state import AdversaryState, CarState

FRAME = 0.05


class Uniform:
    """Frames of a car and an adversary that do what they are told, exactly."""

    limits = CommandLimits(-8.0, 4.0)

    def __init__(self, frame_step: float = FRAME) -> None:
        self.frame_step = frame_step
        self.commands: list[float] = []

    def place(self, car: CarState, adversary: AdversaryState) -> tuple[CarState, AdversaryState]:
        self._car, self._adversary = car, adversary
        return car, adversary

    def control(self, acceleration: float, velocity: tuple[float, float]) -> None:
        self.commands.append(acceleration)
        self._velocity = velocity

    def advance(self) -> tuple[CarState, AdversaryState]:
        car, adversary, (vx, vy), step = self._car, self._adversary, self._velocity, self.frame_step
        after = max(0.0, car.speed + step * self.commands[-1])
        self._car = car._replace(y=car.y + 0.5 * step * (car.speed + after), speed=after)
        self._adversary = AdversaryState(adversary.x + step * vx, adversary.y + step * vy, vx, vy)
        return self._car, self._adversary


def _scenario(gap: float) -> Scenario:
    """The crossing with a car that drives on without noise."""
    base = load_scenario("crossing")
    return replace(base, car=replace(base.car, speed_noise=0.0, acceleration_noise=0.0, start_gap=gap))


def _run(simulator: Simulator, episode: Episode, velocity: tuple[float, float], acceleration: float = 0.0) -> Frame:
    frame = simulator.reset(episode)
    while frame.outcome == Outcome.RUNNING:
        frame = simulator.step(acceleration, velocity)
    return frame


@pytest.mark.parametrize("period", [None, 0.15, 0.05])
@pytest.mark.parametrize("episode_id", range(12))
def test_same_end_as_in_the_world(episode_id: int, period: float | None) -> None:
    """Whether the car decides once a tick or every few frames."""
    rng = np.random.default_rng(episode_id)
    velocity = (rng.uniform(1.5, 2.5), rng.uniform(-0.5, 0.5))
    scenario = replace(_scenario(rng.uniform(8.0, 16.0)), control_period=period)
    episode = Episode(scenario, Mode.SAFE, 7, episode_id)
    there = _run(WorldSimulator(), episode, velocity)
    seen = _run(FramedSimulator(Uniform()), episode, velocity)
    assert (seen.outcome, seen.tick, seen.period) == (there.outcome, there.tick, 0)
    assert seen.adversary == pytest.approx(there.adversary, abs=1e-9)
    if there.contact is None:
        assert seen.contact is None
        assert seen.car == pytest.approx(there.car, abs=1e-9)
    else:
        assert seen.contact == pytest.approx(there.contact, abs=1e-9)
        assert seen.impact(0.3) == pytest.approx(there.impact(0.3), abs=1e-9)


def test_both_ends_occur() -> None:
    """What the comparison above rests on."""
    ends = {
        _run(FramedSimulator(Uniform()), Episode(_scenario(gap), Mode.SAFE, 7, 0), (2.5, 0.0)).outcome
        for gap in (9.0, 30.0)
    }
    assert ends == {Outcome.COLLISION, Outcome.ARRIVED}


def test_slow_impacts_do_not_count() -> None:
    scenario = _scenario(9.0)
    fast = replace(scenario, collision=replace(scenario.collision, minimum_impact_speed=20.0))
    for what, outcome in ((scenario, Outcome.COLLISION), (fast, Outcome.ARRIVED)):
        episode = Episode(what, Mode.SAFE, 7, 0)
        assert _run(FramedSimulator(Uniform()), episode, (2.5, 0.0)).outcome == outcome


def test_commands_beyond_its_limits_are_clipped_and_counted() -> None:
    source = Uniform()
    simulator = FramedSimulator(source)
    end = _run(simulator, Episode(_scenario(30.0), Mode.SAFE, 7, 0), (2.5, 0.0), -11.0)
    assert set(source.commands) == {-8.0}
    assert simulator.clipped == end.tick
    _run(simulator, Episode(_scenario(30.0), Mode.SAFE, 7, 1), (2.5, 0.0), -8.0)
    assert simulator.clipped == 0


@pytest.mark.parametrize("frame_step", [0.04, 0.07, 0.2, 0.7])
def test_a_tick_has_whole_frames(frame_step: float) -> None:
    with pytest.raises(UsageError, match=r"must divide the scenario's time_step 0\.3 s"):
        FramedSimulator(Uniform(frame_step)).reset(Episode(_scenario(13.0), Mode.SAFE, 0, 0))


def test_a_control_period_has_whole_frames() -> None:
    episode = Episode(replace(_scenario(13.0), control_period=0.02), Mode.SAFE, 0, 0)
    with pytest.raises(UsageError, match=r"must divide the scenario's time_step 0\.3 s and its control_period 0\.02 s"):
        FramedSimulator(Uniform()).reset(episode)
