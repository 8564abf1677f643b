"""One episode: its specification, its random draws, how it ends or is aborted, the log of it, and its time stamps.

`SeedSequence(campaign_seed, spawn_key=(episode_id, role))` makes an episode's draws independent of the number of
workers and of the order in which episodes run. There is no global random state.
"""

from __future__ import annotations

import hashlib
import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import NamedTuple

import numpy as np

from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import check_adversary_model
from skd_sim.options.options import EpisodeOptions
from skd_sim.scenario.ending import Ending
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, FloatArray, Pair, Trajectory


class Role(IntEnum):
    """Who draws. Values are part of the reproducibility contract: never renumber."""

    CAR = 0
    START = 1
    SENSOR = 2
    PLANNER = 3
    CONTROLLER = 4
    SCAN = 5
    PROBE = 6
    ORDER = 9
    WALKER = 10
    RISK = 11


def generator(campaign_seed: int, episode_id: int, role: Role, *part: int) -> np.random.Generator:
    """Return the generator of one role in one episode, or of a numbered part of it, such as a tick."""
    sequence = np.random.SeedSequence(campaign_seed, spawn_key=(episode_id, int(role), *part))
    return np.random.Generator(np.random.PCG64(sequence))


def controller_seed(campaign_seed: int, episode_id: int) -> bytes:
    """Return the seed of what a controller under test draws: a SHA-256 digest from which neither number can be read.

    The id says whether the adversary is a kamikaze.
    """
    return hashlib.sha256(f"{campaign_seed} {episode_id} {int(Role.CONTROLLER)}".encode()).digest()


def controller_generator(seed: bytes) -> np.random.Generator:
    """Return the generator that a controller under test is handed, of a `controller_seed`."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(int.from_bytes(seed))))


class Mode(IntEnum):
    """What the adversary does. Values are those of skd_msgs/Episode."""

    SAFE = 0
    KAMIKAZE = 1
    REPLAY = 2


class Outcome(IntEnum):
    """How an episode ended. Values are those of skd_msgs/EpisodeResult."""

    RUNNING = 0
    COLLISION = 1
    ARRIVED = 2
    MISSED = 3
    TIMEOUT = 4
    ABORTED = 5


@dataclass(frozen=True, eq=False)
class EpisodeSpec(EpisodeOptions):
    """Specification: with the same one, every runner gives the same trajectory to the last bit.

    Attributes:
        scenario: fixed description of the test.
        mode: what the adversary does.
        seed: seed of the campaign.
        episode_id: number of the episode within the campaign, ≥ 0; with the seed it determines every random draw.
        safe_trajectory: φ; none in safe mode.
        public: the scenario that the controller gets, where this one is a variant of it that differs in how the car
            starts or in its noise, as of a probe or a static test: a controller may take its cruising speed from it.
            None: the same.

    Its options are those of `EpisodeOptions`, each of which is described there. A car model is the JSON text of
    `skd_adversary.car_models.car_model_file`; `frechet` and `deviation` plan for the maximum distance.
    """

    scenario: Scenario
    mode: Mode
    seed: int
    episode_id: int
    safe_trajectory: Trajectory | None = None
    public: Scenario | None = None

    def __post_init__(self) -> None:
        if self.mode != Mode.SAFE and self.safe_trajectory is None:
            raise ValueError(f"an episode in mode {self.mode.name} needs a safe trajectory")
        if self.seed < 0 or self.episode_id < 0:
            raise ValueError("seed and episode_id must not be negative")
        if self.maximum_distance is not None and not 0.0 < self.maximum_distance < math.inf:
            raise UsageError(f"maximum_distance must be a positive finite number (m), got {self.maximum_distance:g}")
        object.__setattr__(
            self, "adversary_model", self.resolved_adversary_model
        )  # an episode says what it was planned with
        check_adversary_model(self.resolved_adversary_model, self.car, model=bool(self.car_model))

    @property
    def public_scenario(self) -> Scenario:
        """The scenario that the controller gets: the same in all episodes of an assessment."""
        return self.scenario if self.public is None else self.public

    @property
    def start(self) -> Pair:
        """Where the adversary starts, (x, y) in m: the first point of φ, else the scenario's start."""
        if self.safe_trajectory is None:
            return self.scenario.adversary.start_x, self.scenario.adversary.start_y
        x, y = self.safe_trajectory.positions[0]
        return float(x), float(y)

    @property
    def start_gap(self) -> float:
        """Front bumper to the crossing line before the episode's draw, m."""
        car = self.scenario.car
        if not car.meet_safe_trajectory or self.safe_trajectory is None:
            return car.start_gap
        return car.start_speed * self.scenario.end.entry_time(self.safe_trajectory)

    @property
    def end(self) -> Ending:
        """When a kamikaze is over: beyond what the car can reach, too."""
        return self.scenario.end_if_steered if self.steers else self.scenario.end

    def outcome(self, tick: int, adversary: AdversaryState, *, collided: bool) -> Outcome:
        """Return how the episode stands after `tick` steps.

        Kamikaze episodes also end beyond the car's path, from where no action leads back, and they and safe ones in an
        obstacle; a replay ends with φ.
        """
        if collided:
            return Outcome.COLLISION
        if self.mode == Mode.SAFE and self.scenario.end.arrived(adversary.x, adversary.y):
            return Outcome.ARRIVED
        if self.mode == Mode.KAMIKAZE and self.end.missed(adversary.x, adversary.y):
            return Outcome.MISSED
        if self.mode != Mode.REPLAY and self.scenario.ran_into_obstacle(adversary):
            return Outcome.MISSED
        if self.mode == Mode.REPLAY and self.safe_trajectory and tick >= len(self.safe_trajectory) - 1:
            return Outcome.ARRIVED
        return Outcome.TIMEOUT if tick >= self.scenario.ticks else Outcome.RUNNING


class Timing(NamedTuple):
    """How punctual an episode was, in wall time; not known for episodes in process and old recordings.

    Attributes:
        ages: age of the command that each control period used, s.
        held: number of control periods for which no new command had come.
        delay: how late the latest control period of real time came, s.
    """

    ages: tuple[float, ...] = ()
    held: int = 0
    delay: float = 0.0


UNTIMED = Timing()
"""Of an episode of which nothing is known."""


@dataclass(frozen=True, eq=False)
class EpisodeLog:
    """What happened.

    Attributes:
        episode: specification of the episode.
        outcome: how it ended.
        adversary: n × 2 positions at ticks 0 … n − 1, m.
        car: n × 4: `CarState` at the same ticks: reference point (x, y), m, heading, rad, and speed, m/s.
        impact_time: s since the start, at the first contact; nan without a collision.
        impact_speed: speed of the car at the first contact, m/s; nan without a collision.
        depletions: how often the adversary's belief had to be redrawn.
        reason: why it was aborted, else empty; begins with a kind of `skd_sim.world.episode`.
        clipped: how many commands were beyond what the car can do.
        timing: how old the commands were; known of the graph only.
        belief: n × 4, what a planning adversary believed of the car when it decided at each tick: mean and standard
            deviation of the path coordinate of its reference point, m, and of its speed, m/s; nan at the last tick, at
            which nothing is decided. None where nothing was believed, or it is not known: the graph's adversary keeps
            it to itself.
        own_contact: time since the start of the first contact by the simulator's own shapes, s; nan without one. None
            where the simulator has no shapes of its own, or did not say; SKD's geometry alone counts.
        commands: k × 2: acceleration (m/s²) and steering angle (rad) that were commanded in each control period; None
            where they are not known.
        strayed: greatest distance (m) between the adversary and where its commands would have taken it, of another
            simulator in process; 0 of SKD's own world, which takes it there, and where it is not known.
    """

    episode: EpisodeSpec
    outcome: Outcome
    adversary: FloatArray
    car: FloatArray
    impact_time: float = float("nan")
    impact_speed: float = float("nan")
    depletions: int = 0
    reason: str = field(default="")
    clipped: int = 0
    timing: Timing = UNTIMED
    belief: FloatArray | None = None
    own_contact: float | None = None
    strayed: float = 0.0
    commands: FloatArray | None = None

    @property
    def hit(self) -> bool:
        """Whether it ended in a hit by the moving car: a collision at `collision.hit_speed` or more."""
        return self.outcome == Outcome.COLLISION and self.episode.scenario.collision.is_hit(self.impact_speed)

    @property
    def trajectory(self) -> Trajectory:
        """The adversary's positions as a trajectory: ψ of a kamikaze that succeeded, φ of a safe one.

        ψ ends where car and adversary touch: its last point is the place of the first contact, within the last tick.
        """
        positions, step = self.adversary, self.episode.scenario.time_step
        if self.outcome == Outcome.COLLISION:
            positions = until_contact(positions, self.impact_time / step)
        return Trajectory(positions, step)


def until_contact(positions: FloatArray, duration: float) -> FloatArray:
    """Return positions at ticks, n × d with n ≥ 2, the last of them moved back to the time of the contact, in ticks."""
    moved = positions.copy()
    moved[-1] = positions[-2] + (duration - (len(positions) - 2)) * (positions[-1] - positions[-2])
    return moved


class AbortKind(StrEnum):
    """Kind of fault. A reason is a kind, a colon and what is known of it."""

    NO_ANSWER = "no answer"  # who has to answer was silent for too long
    LOST = "messages lost"  # on the way
    NOT_STARTED = "not started"  # it never was there
    ENDED = "process ended"  # by itself, or killed
    NOT_FINITE = "not a finite number"
    WRONG_STAMP = "wrong stamp"  # an answer to another tick
    SECOND_SENDER = "second sender"  # more than one who answers
    ANSWERED_TWICE = "answered twice"  # by one sender
    REFUTED = "refuted"  # by where car and adversary were
    SLIPPED = "pacing slipped"  # the simulator did not keep real time
    FAILED = "failed"  # it said so itself
    OTHER = "other"


def abort_reason(kind: AbortKind, what: str) -> str:
    """Return the reason of an aborted episode, in one line."""
    return f"{kind}: {' '.join(what.split())}"


def kind_of(reason: str) -> AbortKind:
    """Return the kind of a reason; `OTHER` if it names none."""
    head = reason.partition(":")[0]
    return AbortKind(head) if head in frozenset(AbortKind) else AbortKind.OTHER


def counted_reasons(reasons: Iterable[str]) -> dict[str, dict[str, int | str]]:
    """Return kind → how often, and the first reason of that kind; the most frequent first."""
    all_reasons = list(reasons)
    counts = Counter(map(kind_of, all_reasons))
    first = {kind_of(reason): reason for reason in reversed(all_reasons)}
    return {str(kind): {"count": count, "first": first[kind]} for kind, count in counts.most_common()}


def counts_in_words(reasons: Iterable[str]) -> str:
    """Return in a few words how many reasons there are of each kind, the most frequent first."""
    return ", ".join(f"{one['count']} {kind}" for kind, one in counted_reasons(reasons).items())


# --- time stamps of ticks, and how old a car's commands are when the car is moved by them
# The age of a command at use is the wall time from the publication of the state that its stamp names to the moment at
# which the simulator moves the car by it: how old the world is that the decision was made on. Stamps between two states
# name the earlier one. A command without a stamp, or with one of another clock, is as old as its arrival. Who waits for
# the command, as lockstep does, uses it when it comes, so there the age is the time in which the car answers.

NANOSECONDS = 1_000_000_000
WALL_CLOCK = 1_000_000_000 * NANOSECONDS
"""Stamps after this one, in September 2001, are not of a simulation that begins at 0."""


def tick_stamp(start: int, tick: int, time_step: float) -> int:
    """Return the stamp (ns) of a tick of an episode that starts at `start` (ns), at `time_step` (s)."""
    return start + round(tick * time_step * NANOSECONDS)


def period_stamp(start: int, tick: int, period: int, periods: int, time_step: float) -> int:
    """Return the stamp (ns) of control period `period` of a tick that has `periods`; that of period 0 is the tick's."""
    return start + round((tick + period / periods) * time_step * NANOSECONDS)


def period_of(stamp: int, start: int, time_step: float, periods: int = 1) -> tuple[int, int] | None:
    """Return the tick and the control period in it that have exactly this stamp (ns), or none."""
    tick, period = divmod(round((stamp - start) * periods / (time_step * NANOSECONDS)), periods)
    return (tick, period) if tick >= 0 and period_stamp(start, tick, period, periods, time_step) == stamp else None


def next_start(end: int) -> int:
    """Return the start (ns) of the episode after one that ended at `end` (ns): a whole second, at least one later.

    Simulation time never runs backwards, so stamps are unique in a campaign.
    """
    return (-(-end // NANOSECONDS) + 1) * NANOSECONDS


def stamp_fault(stamp: int, expected: int) -> str:
    """Return what is wrong with the stamp (ns) of an answer to the state of another (ns), and what would help."""
    behind = (expected - stamp) / NANOSECONDS
    if stamp == 0:
        return f"are not set: copy the odometry's stamp, or {_ANY_STAMP}"
    if stamp > WALL_CLOCK:
        return f"are of the wall clock: set use_sim_time:=true, copy the odometry's stamp, or {_ANY_STAMP}"
    how = f"lag by {behind:.3g} s" if behind > 0.0 else f"are {-behind:.3g} s ahead"
    return f"{how}: copy the odometry's stamp, or, of a node with a timer, use_sim_time:=true and {_ANY_STAMP}"


_ANY_STAMP = "-p quiet_time:=0.1, or --pacing real_time"


class CommandAges:
    """The ages in one episode after another.

    Attributes:
        ages: age of the command in each control period so far, s.
        held: number of control periods for which no command had come since the one before; they use the last command
            again.
    """

    def __init__(self, *, waited_for: bool) -> None:
        """Know nothing yet; `waited_for`: a command is used when it comes, not when it is time."""
        self._waited_for = waited_for
        self.begin()

    def begin(self) -> None:
        """Forget the last episode."""
        self.ages: list[float] = []
        self.held = 0
        self._stamps: list[int] = []
        self._published: list[float] = []
        self._source = self._came = math.nan
        self._fresh = False

    def publish(self, stamp: int, now: float) -> None:
        """Take note of a state with a stamp (ns), published at a monotonic time (s); one may be repeated."""
        if self._stamps and self._stamps[-1] == stamp:
            self._published[-1] = now
        else:
            self._stamps.append(stamp)
            self._published.append(now)

    def come(self, stamp: int | None, now: float) -> None:
        """Take note of a command that counts, with its stamp (ns) if it has one, at a monotonic time (s)."""
        self._came, self._fresh = now, True
        place = 0 if stamp is None or stamp > self._stamps[-1] else bisect_right(self._stamps, stamp)
        if place:
            self._source = self._published[place - 1]
        else:
            self._source = self._published[-1] if self._waited_for else now

    def use(self, now: float) -> None:
        """Take note of a control period that begins, at a monotonic time (s), with the last command that came."""
        self.held += not self._fresh
        self.ages.append((self._came if self._fresh and self._waited_for else now) - self._source)
        self._fresh = False


class Schedule:
    """When the control periods of real time are due: every so often from the start on.

    Attributes:
        period: wall time, s.
        worst: how much later than due the latest of them came, s.
    """

    def __init__(self, start: float, period: float) -> None:
        """Begin.

        Args:
            start: monotonic time, s; the first one is due a period later.
            period: wall time, s.
        """
        self.period = period
        self._due = start + period
        self.worst = 0.0

    def late(self, now: float) -> float:
        """Take note of a control period that begins at a monotonic time (s), and return how late it is, s.

        One that comes more than a period late takes the place of those that it has missed, as timers have it.
        """
        late = now - self._due
        self.worst = max(self.worst, late)
        self._due += self.period * (1 + max(0, math.floor(late / self.period)))
        return late
