"""One episode: its specification, its random draws, how it ends or is aborted, and the log of what happened.

`SeedSequence(campaign_seed, spawn_key=(episode_id, role))` makes an episode's draws independent of the number of
workers and of the order in which episodes run. There is no global random state.
"""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum

import numpy as np

from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import check_adversary_model
from skd_sim.options.options import EpisodeOptions
from skd_sim.scenario.ending import Ending
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import AdversaryState, FloatArray, Pair, Trajectory
from skd_sim.world.timing import UNTIMED, Timing


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
    SECOND_SENDER = "second sender"  # more than one answer, or more than one who answers
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
