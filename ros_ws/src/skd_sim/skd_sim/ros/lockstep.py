"""The rules of an episode in lockstep and in real time: whose command is awaited, without ROS and without a clock.

A simulator's node hands in what arrives, with the time where it matters, and does what comes back: `ControlStep`,
`Start`, `Repeat` or `End`. In lockstep a control period is over when the command of the car with its stamp is there,
and at a tick, which is the first period of several or the only one, that of the adversary, too; in real time commands
of the episode are held, and the node goes on by itself from `Start` on.

A car that only follows `/clock` answers when it likes. Lockstep *with a quiet time* waits for it as well, but not for
long: a control period is over when the car has said something since its state was published, or when the quiet time is
over; the last command is held.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.simulator import Frame
from skd_sim.world.episode import NANOSECONDS, AbortKind, CommandAges, Outcome, abort_reason, period_stamp, stamp_fault


class Senders:
    """What is known of those who may send one kind of command; here a part of this process, which is always there."""

    def count(self) -> int:
        """Return how many there are, the dead of the last seconds among them; called often, so it has to be cheap."""
        return 1

    def crowd(self) -> str | None:
        """Return, in words, which nodes they are where several live; none where at most one does."""
        return None

    def diagnosis(self) -> str:
        """Return, in words, why nothing comes, and what mends it; empty where it is not known."""
        return ""


class CommandSource:
    """One kind of command: which node sends it, what was answered to which tick, and what was of no use.

    Attributes:
        who: name of the sender, for messages.
        topic: topic on which its commands are published.
        senders: what the middleware knows of those that publish there.
        command: command for the coming step; None until it has come.
        answers: what was answered in this episode, by stamp, ns.
        has_answered: whether it has ever answered a tick with its stamp.
    """

    def __init__(self, who: str, topic: str, senders: Senders) -> None:
        """Begin without any command and without any sender."""
        self.who, self.topic, self.senders = who, topic, senders
        self.has_answered = False
        self.begin()

    def begin(self) -> None:
        """Forget the last episode."""
        self.command: tuple[float, ...] | None = None
        self.answers: dict[int, tuple[float, ...]] = {}
        self.go_on()

    def go_on(self) -> None:
        """Forget what was of no use: a control period is over."""
        self._ignored = self._newest = 0

    def ignore(self, stamp: int) -> None:
        """Take note of a command that is for no tick that is awaited."""
        self._ignored += 1
        self._newest = max(self._newest, stamp)

    def note(self, stamp: int, answer: tuple[float, ...]) -> None:
        """Take note of the first answer with a stamp (ns)."""
        self.answers[stamp] = answer
        self.has_answered = True

    def contradiction(self, stamp: int, answer: tuple[float, ...], start: int) -> str | None:
        """Return what is wrong with a second answer to a tick, if anything.

        Of two different answers it would be chance which one counts. The state of tick 0 is repeated, and so its answer
        may be repeated, too.

        Args:
            stamp: stamp of the tick, ns.
            answer: command that answers the tick.
            start: stamp of tick 0, ns.
        """
        same = self.answers[stamp] == answer
        if same and stamp == start:
            return None
        what = "the same command" if same else "different commands"
        said = f"{self.who} ({self.topic}) gave {what} at {_seconds(stamp - start)} of the episode"
        remedy = "Publish once per stamp: wait until both odometries have the same stamp"
        return self.crowd() or abort_reason(AbortKind.ANSWERED_TWICE, f"{said}. {remedy}")

    def crowd(self) -> str | None:
        """Return which senders there are where they are several, as a reason; none where there is one at most."""
        crowd = self.senders.crowd()
        return None if crowd is None else abort_reason(AbortKind.SECOND_SENDER, crowd)

    def silence(self, awaited: int, limit: float, tick: int, slowest: float) -> str:
        """Return why there is no answer to a tick, as a reason.

        Args:
            awaited: stamp of the tick for which a command is missing, ns.
            limit: how long the command was waited for, s of wall time.
            tick: number of that tick.
            slowest: longest time that an answer took in this episode, s; 0: not known.
        """
        silent = f"{self.who} ({self.topic}) stayed silent for {limit:g} s at tick {tick}"
        if self._ignored:
            return abort_reason(
                AbortKind.WRONG_STAMP,
                f"{silent}: its commands carry other stamps ({self._ignored} came; newest {_seconds(self._newest)}, "
                f"awaited {_seconds(awaited)}); stamps {stamp_fault(self._newest, awaited)}",
            )
        if not self.senders.count():
            return abort_reason(AbortKind.NOT_STARTED, f"{silent}: {self.senders.diagnosis()}")
        how = f"; it has answered {len(self.answers)} times before, and hangs" if self.answers else ""
        if not self.answers and tick == 0 and slowest == 0.0 and (known := self.senders.diagnosis()):
            how = f". {known}"
        if len(self.answers) == 1:  # the first state is repeated, so that it is not known how long its answer took
            how = f"; it has answered once: it hangs, or is too slow for -p command_timeout:={limit:g}"
        if slowest > _SLOW * limit:
            how = f"; its answers took up to {slowest:.2g} s, it is too slow for -p command_timeout:={limit:g}"
        return abort_reason(AbortKind.NO_ANSWER, f"{silent}{how}")


_SLOW = 0.3  # of the limit


def _seconds(stamp: int) -> str:
    return f"{stamp / NANOSECONDS:.3f} s"


REPEAT_PERIOD = 0.2
"""s of wall time between repetitions of tick 0, which a node that joins late has missed."""

LEAD = 900_000_000
_LEAD_STEP = 100_000_000
"""ns of simulation time by which the clock is behind tick 0 at first where commands are held, and its step.

A node with a timer speaks when the clock has moved, and may have nothing to say until it has seen a state: with each
repetition of tick 0 the clock comes nearer. Episodes are a second apart, so that it never runs backwards.
"""


class ControlStep(NamedTuple):
    """The simulator is to hold these commands for one control period; its frame is handed in next.

    Attributes:
        drive: what the car under test commanded: an acceleration (m/s²), or a speed target (m/s).
        velocity: velocity of the adversary, (East, North), m/s.
        limit: greatest change of speed that a speed target allows, m/s²; with 0 any is allowed.
        steering: a steering angle (rad), or a yaw rate (rad/s), to the left.
    """

    drive: float
    velocity: tuple[float, float]
    limit: float = 0.0
    steering: float = 0.0


@dataclass(frozen=True)
class Start:
    """In real time only: car and adversary have each sent a command, and the control periods may begin."""


@dataclass(frozen=True)
class Repeat:
    """The state of tick 0 is to be published once more."""


class End(NamedTuple):
    """The episode is over.

    Attributes:
        outcome: how the episode ended.
        frame: frame at the end of the episode.
        stamp: stamp of that frame, ns.
        reason: why the episode was aborted, beginning with a kind of `skd_sim.world.episode`; empty if it was not.
    """

    outcome: Outcome
    frame: Frame
    stamp: int
    reason: str


Action = ControlStep | Start | Repeat | End


class WaitLimits(NamedTuple):
    """How long a command may be waited for, s of wall time: in general, and at tick 0, while nodes start."""

    command: float
    startup: float


class Lockstep:
    """The state of one episode after another; idle before `begin` and after an `End`.

    After a `ControlStep` its frame, or what failed, has to be handed in before anything else.

    Attributes:
        ages: ages of the car's commands in this episode.
        lead: how far the clock is to be behind the state that is published now, ns.
    """

    def __init__(
        self,
        car: CommandSource,
        adversary: CommandSource,
        limits: WaitLimits,
        *,
        real_time: bool = False,
        quiet_time: float = 0.0,
    ) -> None:
        """Wait for an episode.

        Args:
            car: the source of the car's commands.
            adversary: the source of the adversary's commands.
            limits: how long commands are waited for.
            real_time: whether commands are held, instead of waiting for those of each tick.
            quiet_time: how long a car that follows the clock is waited for, s of wall time; 0: one that answers each
                state is, as long as its limit says.
        """
        self.ages = CommandAges(waited_for=not real_time)
        self._car, self._adversary = car, adversary
        self._limits = limits
        self._real_time = real_time
        self._quiet_time = quiet_time
        self._frame: Frame | None = None

    @property
    def stamp(self) -> int:
        """Stamp of the frame now, ns."""
        assert self._frame is not None
        return frame_stamp(self._start, self._frame, self._scenario)

    def begin(self, start: int, scenario: Scenario, frame: Frame, now: float) -> End | None:
        """Begin an episode; if one is still running, leave it without a message.

        Args:
            start: stamp of tick 0, ns.
            scenario: scenario that gives the time step and the control periods.
            frame: frame of tick 0.
            now: time on the monotonic clock, s.
        """
        self._start, self._scenario = start, scenario
        self._car.begin()
        self._adversary.begin()
        self._began = False
        self._velocity: tuple[float, float] | None = None  # of the tick that is under way
        self._frame = frame
        self._progress = self._published = now
        self.lead = LEAD if self._quiet_time or self._real_time else 0
        self._spoken = False  # the car has, since the state now was published
        self._by_stamp = True  # the car's last command had one
        self.ages.begin()
        self.ages.publish(start, now)
        return self.fail(self._crowd())

    def stop(self) -> None:
        """Leave the running episode without a message."""
        self._frame = None

    def drive(
        self, stamp: int | None, command: float, limit: float = 0.0, steering: float = 0.0, *, now: float = math.nan
    ) -> Action | None:
        """Take a command of the car.

        Args:
            stamp: stamp that the command carries, ns; a message without one is for the running tick.
            command: acceleration (m/s²) or speed target (m/s).
            limit: greatest change of speed that a speed target allows, m/s²; with 0 any is allowed.
            steering: a steering angle (rad), or a yaw rate (rad/s), to the left.
            now: time on the monotonic clock, s; without it the command's age is not known.
        """
        answer = (command, limit, steering) if limit or steering else (command,)
        if self._quiet_time:
            return self._hear(stamp, answer, now)
        return self._answer(self._car, stamp, answer, now)

    def walk(self, stamp: int, velocity: tuple[float, float], *, now: float = math.nan) -> Action | None:
        """Take a command of the adversary, (East, North), m/s, with its stamp, ns, at a monotonic time, s."""
        return self._answer(self._adversary, stamp, velocity, now)

    def go_on(self, now: float = math.nan) -> ControlStep | None:
        """Return the commands that are held at a monotonic time (s); real time only."""
        return self._take(now) if self._frame is not None and self._began else None

    def quiet(self, now: float = math.nan) -> ControlStep | None:
        """Take note that the quiet time since the last state is over, at a monotonic time (s)."""
        if self._frame is None or self._car.command is None:
            return None
        self._spoken = True
        return None if self._waits_for(self._adversary) else self._take(now)

    def advance(self, frame: Frame, now: float) -> End | None:
        """Take the frame of a `ControlStep`, at a monotonic time (s); it is to be published before an `End`."""
        self._frame = frame
        self._progress = self._published = now
        self._car.go_on()
        self._adversary.go_on()
        self.lead = 0
        self.ages.publish(self.stamp, now)
        if frame.period == 0:
            self._velocity = None
        if frame.outcome == Outcome.RUNNING:
            return None
        return self.fail(self._crowd()) or self._end(frame.outcome, "")

    def fail(self, reason: str | None) -> End | None:
        """Abort the running episode, if there are one and a reason."""
        return self._end(Outcome.ABORTED, reason) if self._frame is not None and reason is not None else None

    def watch(self, now: float) -> Repeat | End | None:
        """End the episode if a sender is silent, gone or one too many; called now and then (monotonic time, s)."""
        frame = self._frame
        if frame is None:
            return None
        # Where commands are held, only a source that is gone altogether can be noticed.
        held = self._began or (self._quiet_time and self._car.command is not None)
        sources = (self._car, self._adversary) if self._began else (self._car,)
        gone = [f"{one.who} (publisher of {one.topic}) is gone" for one in sources if held and one.senders.count() == 0]
        problem = self._crowd() or (abort_reason(AbortKind.ENDED, gone[0]) if gone else None)
        if problem is not None or self._began:
            return self.fail(problem)
        limit = self._limits.startup if self._at_start else self._limits.command
        if now - self._progress > limit:
            silent = (source for source in (self._car, self._adversary) if self._waits_for(source))
            slowest = max(self.ages.ages, default=0.0)
            reasons = [
                source.silence(self.stamp, limit, frame.tick, slowest if source is self._car else 0.0)
                for source in silent
            ]
            return self.fail(" and ".join(reasons))
        settles = self._quiet_time and self._car.command is not None and not self._waits_for(self._adversary)
        if self._at_start and not settles and now - self._published > REPEAT_PERIOD:
            self._published = now
            self._spoken &= self._by_stamp
            self.ages.publish(self.stamp, now)
            if self._car.senders.count():
                self.lead = max(0, self.lead - _LEAD_STEP)
            return Repeat()
        return None

    @property
    def _at_start(self) -> bool:
        return self._frame is not None and self._frame.tick == self._frame.period == 0

    def _hear(self, stamp: int | None, answer: tuple[float, ...], now: float) -> Action | None:
        """Take a command of a car that follows the clock."""
        if self._frame is None:
            return None
        if not stamp:
            stamp = None
        elif stamp < self._start - LEAD:
            self._car.ignore(stamp)
            return None
        if not all(map(math.isfinite, answer)):
            return self._not_finite(self._car, answer)
        first = self._car.command is None
        self._car.command = answer
        self.ages.come(stamp, now)
        # One that comes too late for its state is good for the next one, but does not answer it. Without a stamp it may
        # be of the episode before, or one of several answers to tick 0, which is repeated: there the last one counts.
        self._by_stamp = stamp is not None
        self._spoken |= not self._at_start if stamp is None else first or stamp >= self.stamp
        return None if self._waits_for(self._car) or self._waits_for(self._adversary) else self._take(now)

    def _not_finite(self, source: CommandSource, answer: tuple[float, ...]) -> End | None:
        return self.fail(abort_reason(AbortKind.NOT_FINITE, f"{source.who} commanded {', '.join(map(str, answer))}"))

    def _answer(self, source: CommandSource, stamp: int | None, answer: tuple[float, ...], now: float) -> Action | None:
        if self._frame is None:
            return None
        if self._real_time and stamp == 0:
            stamp = None  # which says nothing
        if stamp is not None and not self._real_time and self._start <= stamp <= self.stamp:
            if stamp in source.answers:
                return self.fail(source.contradiction(stamp, answer, self._start))
            source.note(stamp, answer)
        if stamp is not None and not self._wants(stamp):
            if stamp >= self._start or not source.has_answered:  # else it is late, of the episode before
                source.ignore(stamp)
            return None
        if not all(map(math.isfinite, answer)):
            return self._not_finite(source, answer)
        source.command = answer
        if source is self._car:
            self.ages.come(stamp, now)
        if self._began or self._waits_for(self._car) or self._waits_for(self._adversary):
            return None
        if self._real_time:
            self._began = True
            return Start()
        return self._take(now)

    def _wants(self, stamp: int) -> bool:
        """Whether a command is for the running tick: lockstep takes no other, real time takes any of this episode."""
        if self._real_time:
            return stamp >= (self._start if self._began else self._start - LEAD)
        return stamp == self.stamp

    def _waits_for(self, source: CommandSource) -> bool:
        """Whether the running control period still needs a command of some source."""
        if self._quiet_time and source is self._car:
            return not self._spoken
        return source.command is None and (source is self._car or self._velocity is None)

    def _take(self, now: float) -> ControlStep:
        drive = self._car.command
        assert drive is not None
        self.ages.use(now)
        if self._velocity is None:
            velocity = self._adversary.command
            assert velocity is not None
            self._velocity = velocity[0], velocity[1]
        if not self._real_time:
            self._adversary.command = None
            if not self._quiet_time:
                self._car.command = None
        self._spoken = False
        return ControlStep(drive[0], self._velocity, *drive[1:])

    def _crowd(self) -> str | None:
        """Return where more than one node sends one kind of command; for now and then, not for each tick."""
        return self._car.crowd() or self._adversary.crowd()

    def _end(self, outcome: Outcome, reason: str) -> End:
        assert self._frame is not None
        end = End(outcome, self._frame, self.stamp, reason)
        self._frame = None
        return end


def frame_stamp(start: int, frame: Frame, scenario: Scenario) -> int:
    """Return the stamp (ns) of a frame of an episode that starts at `start` (ns)."""
    return period_stamp(start, frame.tick, frame.period, scenario.control_periods, scenario.time_step)
