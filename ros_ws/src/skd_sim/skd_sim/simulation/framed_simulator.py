"""A simulator behind `Simulator` that reports car and adversary several times within each tick, as CARLA does.

The counterpart of `World`: there the motion is computed, here it is watched. Contact is looked for between frames as in
the world, so that both mean the same by it.
"""

from __future__ import annotations

from typing import Protocol

from skd_sim.dynamics.limits import CommandLimits
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode.episode import Episode
from skd_sim.errors import UsageError
from skd_sim.geometry.contact import first_contact, to_car_frame
from skd_sim.simulation.simulator import Frame
from skd_sim.simulation.world import Contact, make_world
from skd_sim.state import AdversaryState, CarState

States = tuple[CarState, AdversaryState]


class FrameSource(Protocol):
    """Somebody else's simulator, stepped frame by frame; each method may raise `SimulatorError`.

    Attributes:
        frame_step: time between frames, s.
        limits: of what its car can be commanded.
    """

    frame_step: float
    limits: CommandLimits

    def place(self, car: CarState, adversary: AdversaryState) -> States:
        """Put both at the start, and return where they really are then."""

    def control(self, acceleration: float, velocity: tuple[float, float]) -> None:
        """Command both, from the next frame on: acceleration within the limits (m/s²), velocity (m/s)."""

    def advance(self) -> States:
        """Advance by one frame and return the states at its end."""


class FramedSimulator:
    """Counts frames into control periods and ticks, and finds the first contact; see `Simulator`."""

    def __init__(self, source: FrameSource) -> None:
        """Take the source of the frames."""
        self._source = source
        self.clipped = 0

    def reset(self, episode: Episode) -> Frame:
        """Draw the start as the world does, and place both there.

        Raises:
            UsageError: a control period is not a whole number of frames, the road has curves, or the adversary is a
                box.
        """
        scenario = episode.scenario
        if not scenario.road.straight or scenario.adversary.is_box:
            raise UsageError(
                f"scenario {scenario.name} has a curved road, or an adversary that is a box, which another simulator "
                "cannot be told yet; take a straight road and a disc, or SKD's own world"
            )
        self._frames = _frames_per_period(scenario, self._source.frame_step)
        self._episode = episode
        self.clipped = 0
        world = make_world(episode)
        self._now = Frame(0, *self._source.place(world.car, world.adversary))
        self._origin = self._now.adversary
        return self._now

    def step(self, acceleration: float, velocity: tuple[float, float]) -> Frame:
        """Watch the frames of one control period.

        A tick ends early at a contact: what the simulator does to an adversary that has been hit is no part of its
        trajectory, which ends where its own command would have taken it by the end of the tick.
        """
        possible = self._source.limits.clip(acceleration)
        self.clipped += possible != acceleration
        self._source.control(possible, velocity)
        scenario = self._episode.scenario
        _, car, adversary, *_ = self._now
        period, contact = self._now.period + 1, None
        for frame in range((period - 1) * self._frames, period * self._frames):
            car_before, before = car, adversary
            car, adversary = self._source.advance()
            touched = self._touch(car_before, before, car, adversary)
            if touched is not None and touched.speed >= scenario.collision.minimum_impact_speed:
                whole = scenario.control_periods * self._frames
                contact = Contact((frame + touched.fraction) / whole, touched.speed)
                x, y = (
                    self._origin.x + scenario.time_step * velocity[0],
                    self._origin.y + scenario.time_step * velocity[1],
                )
                adversary = AdversaryState(x, y, *velocity)
                break
        if contact is None and period < scenario.control_periods:
            self._now = Frame(self._now.tick, car, adversary, period=period)
            return self._now
        tick = self._now.tick + 1
        outcome = self._episode.outcome(tick, adversary, collided=contact is not None)
        self._now = Frame(tick, car, adversary, contact, outcome)
        self._origin = adversary
        return self._now

    def _touch(
        self, car_before: CarState, before: AdversaryState, car: CarState, adversary: AdversaryState
    ) -> Contact | None:
        """Return the first contact within a frame: its fraction of the frame and the car's speed."""
        footprint, radius = self._episode.scenario.car, self._episode.scenario.adversary.reach
        fraction = first_contact(
            *to_car_frame(before.x, before.y, car_before.x, car_before.y, car_before.heading),
            *to_car_frame(adversary.x, adversary.y, car.x, car.y, car.heading),
            footprint.front,
            footprint.rear,
            footprint.half_width,
            radius,
        )
        return (
            Contact(fraction, car_before.speed + fraction * (car.speed - car_before.speed)) if fraction <= 1.0 else None
        )


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
