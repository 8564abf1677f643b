"""A recorded trial, driven again in the simulator: its controller sees what the recording shows, and its car obeys.

The controller is asked with car and road user as they were recorded, so that its commands are those of the trial
whatever the simulated car does. A car that decides by what it sees would otherwise decide otherwise after the first
small difference, and late parts of a trial would say nothing of brake and road.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.simulator import Frame, WorldSimulator
from skd_sim.world.episode import Episode, Mode, Outcome
from skd_sim.world.state import CarState, Trajectory

from skd_evaluator.assessment.run.runner import run_episode
from skd_evaluator.errors import AssessmentError
from skd_evaluator.metrics.surrogate.scene import Scene

_OFF_SPEED = 0.08
"""Share by which a trial's first speed may differ from the scenario's: beyond, it was another test."""
_NO_CONTACT = 60.0  # m/s: nobody ends a run, so that the whole recording can be compared


@dataclass(frozen=True, eq=False)
class Recorded:
    """A physical trial at the simulator's times.

    Attributes:
        phi: name of its φ.
        other: positions of the road user at ticks, n × 2, m.
        car: states of the car at control periods, from the first tick to the last: x, y (m), heading (rad), speed.
        where: file and line, for messages.
    """

    phi: str
    other: FloatArray
    car: FloatArray
    where: str


@dataclass(frozen=True)
class Drive:
    """A trial that is to be driven again.

    Attributes:
        trial: as it was recorded.
        scenario: the simulated world.
        controller: of the car.
        multiplier: of the basic car.
    """

    trial: Recorded
    scenario: Scenario
    controller: str
    multiplier: float


class ShownRecording:
    """SKD's own world, whose car goes by itself while its controller is shown the recorded one."""

    places_others: Final = True

    def __init__(self, states: FloatArray) -> None:
        """Take the recorded states of the car, at control periods."""
        self._states, self._inner = states, WorldSimulator()
        self.places: list[tuple[float, float]] = []

    def reset(self, episode: Episode) -> Frame:
        """Begin where the recording begins, at its speed."""
        frame = self._inner.reset(episode)
        world, self._periods = self._inner.world, episode.scenario.control_periods
        begin = CarState(*map(float, self._states[0]))
        world.car = begin
        world.dynamics.reset(begin)
        self.places = [begin[:2]]
        return frame._replace(car=begin)

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        """Advance the world by one control period."""
        frame = self._inner.step(acceleration, velocity)
        if frame.period == 0:
            self.places.append(frame.car[:2])
        number = min(frame.tick * self._periods + frame.period, len(self._states) - 1)
        return frame._replace(car=CarState(*map(float, self._states[number])))

    @property
    def clipped(self) -> int:
        """How many commands asked more of the car than it can do."""
        return self._inner.clipped


def recorded(scenario: Scenario, scene: Scene, phi: str, where: str) -> Recorded:
    """Return a trial at the simulator's times, until the end of its φ or the contact.

    Raises:
        UsageError: it is shorter than three ticks, or the car began at another speed than in the scenario.
    """
    ticks = int(scene.times[-1] / scenario.time_step + 1e-6)
    if ticks < 2:
        raise UsageError(f"{where}: the trial lasts {scene.times[-1]:.1f} s, too short to calibrate with")
    speed, wanted = float(scene.car[0, 3]), scenario.car.start_speed
    if abs(speed - wanted) > _OFF_SPEED * wanted:
        raise UsageError(
            f"{where}: the car begins at {speed:.2f} m/s, and in the simulation at {wanted:.2f}: simulate the speed "
            "of the trials (--set car.start_speed=…)"
        )
    times = scenario.time_step * np.arange(ticks + 1)
    places = np.column_stack([np.interp(times, scene.times, column) for column in scene.other.T])
    periods = scenario.control_duration * np.arange(ticks * scenario.control_periods + 1)
    states = np.column_stack([np.interp(periods, scene.times, column) for column in scene.car.T])
    return Recorded(phi, places, states, where)


def off_by(drive: Drive) -> FloatArray:
    """Return how far the recorded car is ahead of the simulated one along the road, at each tick, m.

    Raises:
        AssessmentError: the episode was aborted.
    """
    trial, scenario = drive.trial, drive.scenario
    car = replace(
        scenario.car, start_gap_range=0.0, meet_safe_trajectory=False, speed_noise=0.0, acceleration_noise=0.0
    )
    collision = replace(scenario.collision, minimum_impact_speed=_NO_CONTACT)
    episode = Episode(
        replace(scenario, car=car, collision=collision),
        Mode.REPLAY,
        0,
        0,
        Trajectory(trial.other, scenario.time_step, trial.phi),
        public=scenario,
        controller=drive.controller,
        multiplier=drive.multiplier,
    )
    shown = ShownRecording(trial.car)
    log = run_episode(episode, simulator=shown)
    if log.outcome == Outcome.ABORTED:
        raise AssessmentError(f"{trial.where}: the trial could not be driven again: {log.reason}")
    line = scenario.road.line
    simulated = right_and_along(line, np.array(shown.places))[:, 1]
    seen = right_and_along(line, np.ascontiguousarray(trial.car[:: scenario.control_periods, :2]))[:, 1]
    count = min(len(simulated), len(seen))
    return np.asarray(seen[:count] - simulated[:count])
