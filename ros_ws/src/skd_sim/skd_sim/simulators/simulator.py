"""The interface of a simulator, SKD's own world behind it, and simulators by name, whose frames are checked.

A class with the two methods of `Simulator` and the count is enough. What no log shows is checked: that frames are
frames, finite and one after the other, and that the adversary goes where its commands send it.

`FramedSimulator` is for one that reports car and adversary several times within each tick, as CARLA does. It is the
counterpart of `World`: there the motion is computed, here it is watched. Contact is looked for between frames as in the
world, so that both mean the same by it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, NoReturn, Protocol, TypeVar, cast

import numpy as np

from skd_sim.controllers.controller import failed
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.inputs.yaml_file import short
from skd_sim.interruption import Interrupted
from skd_sim.options.car_and_adversary import SIMULATORS, is_own_world
from skd_sim.options.registry import reason_of
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.dynamics.basic import Command, CommandLimits, as_pair
from skd_sim.world.episode import AbortKind, EpisodeSpec, Outcome, abort_reason
from skd_sim.world.state import AdversaryState, CarState, Pair, RoadUserState, Scene
from skd_sim.world.world import Contact, World, first_contact_of, make_world


class Frame(NamedTuple):
    """How an episode stands at the end of a control period: the car is to decide, and at a tick the adversary, too.

    Attributes:
        tick: number of the tick; 0 is the start.
        car: state of the car under test.
        adversary: state of the adversary.
        contact: collision in the tick that has just ended, if there was one; its fraction is of the tick.
        outcome: outcome of the episode: `RUNNING` while there is something to decide, anything else only at a tick.
        period: number of control periods since the tick; 0 at the tick itself.
    """

    tick: int
    car: CarState
    adversary: AdversaryState
    contact: Contact | None = None
    outcome: Outcome = Outcome.RUNNING
    period: int = 0

    def scene(self, scenario: Scenario) -> Scene:
        """Return car and road users; where the others of the scenario are depends on the time alone."""
        return Scene(self.car, self.adversary, scenario.others_at(self.tick, self.period))

    def impact(self, time_step: float) -> Pair:
        """Return time since the start (s) and the car's speed (m/s) at the contact; nan where there is none."""
        if self.contact is None:
            return math.nan, math.nan
        return (self.tick - 1 + self.contact.fraction) * time_step, float(self.contact.speed)


class SimulatorError(Exception):
    """A simulator cannot go on with this episode, which is aborted; the next one may be better."""

    def __init__(self, kind: AbortKind, what: str) -> None:
        """Say what went wrong, and which kind of fault it is."""
        super().__init__(abort_reason(kind, what))


class Simulator(Protocol):
    """Runs one episode after another, a control period at a time on request; it may take as long as it needs."""

    @property
    def clipped(self) -> int:
        """How many commands of this episode were beyond what the car can do."""

    def reset(self, episode: EpisodeSpec) -> Frame:
        """Put car and adversary at the start, as `make_world` draws it, and return tick 0.

        Raises:
            UsageError: this simulator cannot run such an episode.
            SimulatorError: it fails.
        """

    def step(self, command: Command, velocity: Pair) -> Frame:
        """Hold both commands for one control period (`Scenario.control_periods` of a tick), and return its end.

        A contact is looked for along all of it, and ends the tick, where the adversary's velocity takes it.
        `EpisodeSpec.outcome` says how an episode stands at a tick.

        Args:
            command: of the car, finite: an acceleration, m/s², or one and a steering angle, rad; what the car cannot do
                is clipped and counted.
            velocity: velocity of the adversary, (East, North), m/s, finite; the same throughout a tick.

        Raises:
            SimulatorError: it fails.
        """


def require_others(simulator: object, name: str, episode: EpisodeSpec) -> None:
    """Refuse an episode whose scenario has others for a simulator, called `name`, that does not say it places them.

    Raises:
        UsageError: it is so.
    """
    if episode.scenario.others and not getattr(simulator, "places_others", False):
        raise UsageError(
            f"scenario {episode.scenario.name} has others, which simulator {name!r} does not place; take SKD's own "
            "world, or a simulator whose attribute places_others is true"
        )


class WorldSimulator:
    """SKD's own world; see `Simulator`.

    Attributes:
        world: world of the running episode, to be looked at and not to be changed.
    """

    places_others: Final = True
    """Whether the others of a scenario are there: of a simulator that does not say so, they are not."""

    def reset(self, episode: EpisodeSpec) -> Frame:
        """Make the world of an episode, with all that is drawn for it."""
        self._episode = episode
        self.world = make_world(episode)
        return Frame(0, self.world.car, self.world.adversary)

    def step(self, command: Command, velocity: Pair) -> Frame:
        """Advance the world by one control period."""
        world = self.world
        contact = world.step(command, velocity)
        if world.period:
            return Frame(world.tick, world.car, world.adversary, period=world.period)
        outcome = self._episode.outcome(world.tick, world.adversary, collided=contact is not None)
        return Frame(world.tick, world.car, world.adversary, contact, outcome)

    @property
    def clipped(self) -> int:
        """How many commands of this episode were beyond what the car can do."""
        return self.world.clipped


_Result = TypeVar("_Result")

DISOBEYED: Final = 0.05
"""m in a tick by which the adversary may be elsewhere than the velocities of this tick and the last one take it."""
STRAYED: Final = 1.0
"""m that it may be away from where it starts, and later from where all its commands would have taken it."""


class NamedSimulator:
    """The simulator that an episode names, kept from one episode to the next; see `Simulator`.

    Failures of any but SKD's own world name it, and its frames are checked.

    Attributes:
        strayed: greatest distance in this episode between the adversary and where its commands would have taken it, m;
            0 of SKD's own world.
    """

    places_others: Final = True
    """It asks the one that is named."""

    def __init__(self) -> None:
        """Wait for an episode."""
        self._name, self._is_own = "", False
        self._simulator: Simulator
        self.strayed = 0.0

    def reset(self, episode: EpisodeSpec) -> Frame:
        """Make the simulator if the episode names another one than the last did, and begin the episode.

        Raises:
            AssessmentError: it fails, or gives no frame of tick 0.
            SimulatorError: a state is not finite, or the adversary is not where it is to start.
        """
        if episode.simulator != self._name:
            self._simulator = make_simulator(episode.simulator)
            self._name, self._is_own = episode.simulator, is_own_world(episode.simulator)
        require_others(self._simulator, self._name, episode)
        self.strayed = 0.0
        if self._is_own:
            return self._simulator.reset(episode)
        self._step = episode.scenario.time_step
        self._ticks, self._periods = episode.scenario.ticks, episode.scenario.control_periods
        self._before = self._command = (0.0, 0.0)
        frame = self._frame("reset", self._call("reset", lambda: self._simulator.reset(episode)), (0, 0))
        self._now, self._place, self._aim = (0, 0), frame.adversary[:2], episode.start
        self.strayed = math.dist(self._place, self._aim)
        if self.strayed > STRAYED:
            self._abort(
                AbortKind.REFUTED, f"the adversary starts {self.strayed:.3g} m from where the specification has it"
            )
        return frame

    def step(self, command: Command, velocity: Pair) -> Frame:
        """Advance the simulator by one control period; see `Simulator.step`.

        Raises:
            AssessmentError: it fails, or gives no frame, or not the next one.
            SimulatorError: a state is not finite, or the adversary is not where its commands take it.
        """
        if self._is_own:
            return self._simulator.step(command, velocity)
        tick, period = self._now
        if period == 0:
            self._before, self._command = self._command, velocity
        answer = self._call("step", lambda: self._simulator.step(command, velocity))
        # A contact ends a tick before all of its control periods are over.
        ended = isinstance(answer, Frame) and answer.contact is not None and answer.period == 0
        following = (tick + 1, 0) if ended or period + 1 == self._periods else (tick, period + 1)
        frame = self._frame("step", answer, following)
        self._now = following
        if following[1] == 0:
            self._check_place(frame.adversary[:2], tick)
        if frame.tick >= self._ticks and frame.outcome == Outcome.RUNNING:  # it would never end
            self._abort(AbortKind.REFUTED, f"it goes on after tick {frame.tick}, which is the last one")
        return frame

    @property
    def world(self) -> World | None:
        """SKD's own world, if that is the simulator; see `WorldSimulator.world`."""
        return getattr(self._simulator, "world", None) if self._is_own else None

    @property
    def own_contact(self) -> float | None:
        """Time of the first contact by the simulator's own shapes (s), nan without one; None: it does not say."""
        return getattr(self._simulator, "own_contact", None)

    @property
    def clipped(self) -> int:
        """How many commands of this episode were beyond what the car can do."""
        return int(self._call("clipped", lambda: self._simulator.clipped))

    def _frame(self, method: str, answer: object, expected: tuple[int, int]) -> Frame:
        """Return what a method has answered as a frame of plain numbers; see `step` for what is raised."""
        if not isinstance(answer, Frame):
            self._fail(f"{method} must return a Frame, got {short(answer)}")
        car, adversary = CarState(*map(float, answer.car)), AdversaryState(*map(float, answer.adversary))
        frame = answer._replace(car=car, adversary=adversary)
        if (frame.tick, frame.period) != expected:
            found, needed = (_moment(*one, self._periods) for one in ((frame.tick, frame.period), expected))
            self._fail(f"{method} must return the frame of {needed}, got that of {found}")
        for whose, state in (("car", frame.car), ("adversary", frame.adversary)):
            for what, number in state._asdict().items():
                if not math.isfinite(number):
                    self._abort(AbortKind.NOT_FINITE, f"{what} of the {whose} is {number:g} in tick {frame.tick}")
        if frame.outcome == Outcome.ABORTED:
            self._abort(AbortKind.FAILED, f"it ended the episode as ABORTED in tick {frame.tick}")
        if frame.period and frame.outcome != Outcome.RUNNING:
            self._fail(f"{method} must not end an episode between two ticks, as {frame.outcome.name} does")
        return frame

    def _check_place(self, place: Pair, tick: int) -> None:
        """Refuse an adversary that is not where its commands take it, at once or by up to a tick later."""
        step, before, command = self._step, self._before, self._command
        moved = (place[0] - self._place[0], place[1] - self._place[1])
        late = (step * before[0], step * before[1])
        at_once = (step * command[0], step * command[1])
        start, self._aim = self._aim, (self._aim[0] + at_once[0], self._aim[1] + at_once[1])
        self._place = place
        off, away = _from_segment(moved, late, at_once), _from_segment(place, start, self._aim)
        self.strayed = max(self.strayed, math.dist(place, self._aim))
        if off > DISOBEYED:
            self._abort(AbortKind.REFUTED, f"in tick {tick} the adversary goes {off:.3g} m beside its commanded way")
        if away > STRAYED:
            self._abort(AbortKind.REFUTED, f"after tick {tick} the adversary is {away:.3g} m from its commanded place")

    def _call(self, method: str, call: Callable[[], _Result]) -> _Result:
        try:
            return call()
        except (UsageError, AssessmentError, SimulatorError, Interrupted):
            raise
        except BaseException as error:  # a user's code may raise anything
            raise failed(f"simulator {self._name}", method, error) from None

    def _fail(self, what: str) -> NoReturn:
        raise AssessmentError(f"simulator {self._name}: {what}") from None

    def _abort(self, kind: AbortKind, what: str) -> NoReturn:
        raise SimulatorError(kind, f"simulator {self._name}: {what}")


def _moment(tick: int, period: int, periods: int) -> str:
    return f"tick {tick}" if periods == 1 and period == 0 else f"tick {tick}, control period {period}"


def _from_segment(place: Pair, begin: Pair, end: Pair) -> float:
    """Return the distance of a place from the line between two others, m."""
    dx, dy = end[0] - begin[0], end[1] - begin[1]
    length = dx * dx + dy * dy
    share = 0.0 if length == 0.0 else ((place[0] - begin[0]) * dx + (place[1] - begin[1]) * dy) / length
    share = min(1.0, max(0.0, share))
    return math.dist(place, (begin[0] + share * dx, begin[1] + share * dy))


def make_simulator(name: str) -> Simulator:
    """Make the simulator of a name.

    Raises:
        UsageError: there is none, it cannot be made, or is none.
    """
    factory = SIMULATORS.find(name)
    try:
        found = factory()
    except UsageError:
        raise
    except Exception as error:
        raise UsageError(f"simulator {name!r} cannot be made: {reason_of(error)}") from None
    missing = [method for method in ("reset", "step") if not callable(getattr(found, method, None))]
    if missing:
        raise UsageError(f"simulator {name!r} needs the methods reset(episode) and step(command, velocity)")
    return cast("Simulator", found)


def repeats_itself(name: str) -> bool:
    """Return whether in a simulator the same commands lead to the same states: in SKD's world, and where one says so.

    Raises:
        UsageError: there is no such simulator, or it cannot be made.
    """
    return is_own_world(name) or bool(getattr(make_simulator(name), "repeats_itself", False))


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

    def control(self, acceleration: float, steering: float, velocity: Pair) -> None:
        """Command car and adversary from the next frame on.

        Args:
            acceleration: of the car, within the limits, m/s².
            steering: angle of its front wheels, within `STEERING_LIMIT`, rad to the left.
            velocity: of the adversary, m/s.
        """

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
        self._episode, self._steered = episode, False
        self.clipped = 0
        self.own_contact = None if self._touching is None else math.nan
        world = make_world(episode)
        self._source.prepare(scenario)
        self._source.show(scenario.others_at(0))
        self._now = Frame(0, *self._source.place(world.car, world.adversary))
        self._origin = self._now.adversary
        return self._now

    def step(self, command: Command, velocity: Pair) -> Frame:
        """Watch the frames of one control period.

        A tick ends early at a contact: what the simulator does to an adversary that has been hit is no part of its
        trajectory, which ends where its own command would have taken it by the end of the tick.
        """
        commanded = as_pair(command)
        possible = self._source.limits.possible(commanded)
        self.clipped += possible != commanded
        self._steered |= possible[1] != 0.0
        self._source.control(*possible, velocity)
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
        path = np.array([before, after])
        contact = first_contact_of(self._episode.scenario, path, moves, self._steered, 1.0, 0, 1)
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
