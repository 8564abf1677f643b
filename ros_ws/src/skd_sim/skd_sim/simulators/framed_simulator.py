"""A simulator behind `Simulator` that reports car and adversary several times within each tick, as CARLA does.

The counterpart of `World`: there the motion is computed, here it is watched. Contact is looked for between frames as in
the world, so that both mean the same by it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, Protocol

import numpy as np

from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.simulator import Frame
from skd_sim.world.dynamics.basic import Command, CommandLimits, as_pair
from skd_sim.world.episode import EpisodeSpec
from skd_sim.world.state import AdversaryState, CarState, RoadUserState
from skd_sim.world.world import Contact, first_contact_of, make_world

States = tuple[CarState, AdversaryState]


class FrameSource(Protocol):
    """Another simulator, stepped frame by frame; each method may raise `SimulatorError`.

    With a method `touching()` it says whether, by shapes of its own, the car touches a road user at a frame's end.

    Attributes:
        frame_step: time between frames, s.
        limits: least and greatest acceleration that its car can be commanded.
    """

    frame_step: float
    limits: CommandLimits

    def prepare(self, scenario: Scenario) -> None:
        """Take the scenario of the next episode before both are placed; raise `UsageError` if it cannot be shown."""

    def show(self, others: Sequence[RoadUserState]) -> None:
        """Put the others of the scenario, in its order, where they are at the next frame's end, or at the start."""

    def place(self, car: CarState, adversary: AdversaryState) -> States:
        """Put car and adversary at the start, and return their states as they really are then."""

    def control(self, acceleration: float, velocity: tuple[float, float]) -> None:
        """Command car (acceleration within the limits, m/s²) and adversary (velocity, m/s) from the next frame on."""

    def advance(self) -> States:
        """Advance by one frame and return the states at its end."""


class FramedSimulator:
    """Counts frames into control periods and ticks, and finds the first contact; see `Simulator`.

    Attributes:
        clipped: how many commands of this episode were beyond what the car can do.
        own_contact: time of the first contact by the source's own shapes (s), at a frame's end and of the speed that
            counts as a collision; nan without one, None where the source knows of none.
    """

    places_others: Final = True
    """Whether the others of a scenario are there; see `Simulator`."""

    def __init__(self, source: FrameSource) -> None:
        """Take the simulator that gives the frames."""
        self._source = source
        self._touching: Callable[[], bool] | None = getattr(source, "touching", None)
        self.clipped = 0
        self.own_contact: float | None = None

    def reset(self, episode: EpisodeSpec) -> Frame:
        """Draw the start as the world does, and place car and adversary there.

        Raises:
            UsageError: a control period is not a whole number of frames, or the road has curves.
        """
        scenario = episode.scenario
        if not scenario.road.straight:
            raise UsageError(
                f"scenario {scenario.name} has a curved road, which another simulator does not know yet; take a "
                "straight road, or SKD's own world"
            )
        self._frames = _frames_per_period(scenario, self._source.frame_step)
        self._episode = episode
        self.clipped = 0
        self.own_contact = None if self._touching is None else math.nan
        world = make_world(episode)
        self._source.prepare(scenario)
        self._source.show(scenario.others_at(0))
        self._now = Frame(0, *self._source.place(world.car, world.adversary))
        self._origin = self._now.adversary
        return self._now

    def step(self, command: Command, velocity: tuple[float, float]) -> Frame:
        """Watch the frames of one control period.

        A tick ends early at a contact: what the simulator does to an adversary that has been hit is no part of its
        trajectory, which ends where its own command would have taken it by the end of the tick.
        """
        acceleration, steering = as_pair(command)
        if steering:
            raise UsageError("the controller steers, which cars of another simulator cannot yet; take SKD's own world")
        possible = self._source.limits.clip(acceleration)
        self.clipped += possible != acceleration
        self._source.control(possible, velocity)
        scenario = self._episode.scenario
        _, car, adversary, *_ = self._now
        period, contact = self._now.period + 1, None
        for frame in range((period - 1) * self._frames, period * self._frames):
            now = car, adversary
            self._source.show(self._others(frame + 1))
            car, adversary = self._source.advance()
            self._note_own_contact(frame + 1, car.speed)
            touched = self._touch(frame, now, (car, adversary))
            if touched is not None:
                contact = Contact((frame + touched.fraction) / self._whole, touched.speed)
                x, y = (
                    self._origin.x + scenario.time_step * velocity[0],
                    self._origin.y + scenario.time_step * velocity[1],
                )
                adversary = AdversaryState(x, y, *velocity, adversary.heading)
                break
        if contact is None and period < scenario.control_periods:
            self._now = Frame(self._now.tick, car, adversary, period=period)
            return self._now
        tick = self._now.tick + 1
        outcome = self._episode.outcome(tick, adversary, collided=contact is not None)
        self._now = Frame(tick, car, adversary, contact, outcome)
        self._origin = adversary
        return self._now

    def _note_own_contact(self, frames: int, speed: float) -> None:
        """Take note of the source's own contact so many frames after the tick, the first one that counts."""
        if self._touching is None or self.own_contact is None or not math.isnan(self.own_contact):
            return
        if speed >= self._episode.scenario.collision.minimum_impact_speed and self._touching():
            self.own_contact = (self._now.tick + frames / self._whole) * self._episode.scenario.time_step

    @property
    def _whole(self) -> int:
        """Number of frames in a tick."""
        return self._episode.scenario.control_periods * self._frames

    def _others(self, frame: int) -> tuple[RoadUserState, ...]:
        """Return where the others are at the begin of a frame of the running tick."""
        scenario, tick = self._episode.scenario, self._now.tick
        before, after = scenario.others_at(tick), scenario.others_at(tick + 1)
        passed = scenario.time_step * frame / self._whole
        return tuple(one.moved(then, passed) for one, then in zip(before, after, strict=True))

    def _touch(self, frame: int, now: States, then: States) -> Contact | None:
        """Return the first contact within a frame that counts: its fraction of the frame and the car's speed."""
        (before, adversary), (after, adversary_then) = now, then
        here, there = (adversary, *self._others(frame)), (adversary_then, *self._others(frame + 1))
        moves = [(one[:2], end[:2], end[2:4], end.heading) for one, end in zip(here, there, strict=True)]
        contact = first_contact_of(self._episode.scenario, np.array([before, after]), moves)
        return contact if contact.fraction <= 1.0 else None


def _frames_per_period(scenario: Scenario, frame_step: float) -> int:
    duration, time_step = scenario.control_duration, scenario.time_step
    frames = round(duration / frame_step)
    if frames < 1 or abs(frames * frame_step - duration) > 1e-9:
        of = "time_step" if scenario.control_periods == 1 else f"time_step {time_step:g} s and its control_period"
        raise UsageError(
            f"frame_step {frame_step:g} s must divide the scenario's {of} {duration:g} s; "
            f"set it to {duration / max(1, frames):g} here and in the simulator"
        )
    return frames
