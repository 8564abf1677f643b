"""Crossings of which a risk is made: who walks, as which normals say, what became of it, and the cars that run them.

A crossing is a φ, a row of the walker's standard normals, and the draws of the car: a row of standard normals where all
that the car does is known, else the number by which an episode draws them. A model runs crossings and says how each
ended, with which side of the car the walker was touched, and by how much time the front of the moving car missed: 0
where it hit, and more than that where it did not.

Crossings run as whole episodes, compiled for the basic car, or side by side for policies of batches. All give the same
to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, Final, NamedTuple, Protocol, Self

import numpy as np
import numpy.typing as npt
from skd_sim.controllers.basic import basic_acceleration
from skd_sim.controllers.isolated import LostProcessError, isolated
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road import road_pose
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import sweep, to_car_frame
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, FloatArray, IntArray, Trajectory, next_speed, travelled

from skd_evaluator.assessment.context import Runner
from skd_evaluator.assessment.episode_figures import ADVERSARY, collision_partner
from skd_evaluator.assessment.plan import EpisodeGroup, Plan, episode_id
from skd_evaluator.assessment.run.episodes import answers_batches, replayed, why_not_batched
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.metrics.behaviour.model import normals_of, walk, walked
from skd_evaluator.metrics.contact_place import Pose, car_at_contact, goes_straight
from skd_evaluator.metrics.risks import Touch


class _Rows:
    """Arrays, or None, of which row k is of crossing k."""

    def _arrays(self) -> list[npt.NDArray[Any] | None]:
        return [getattr(self, one.name) for one in fields(self)]  # type: ignore[arg-type]

    def of(self, rows: IntArray) -> Self:
        """Return some of them."""
        return type(self)(*(None if one is None else one[rows] for one in self._arrays()))

    @classmethod
    def together(cls, parts: Sequence[Self]) -> Self:
        """Return several as one."""
        columns = zip(*(one._arrays() for one in parts), strict=True)
        return cls(*(None if any(one is None for one in column) else np.concatenate(column) for column in columns))

    def where(self, chosen: npt.NDArray[np.bool_], other: Self) -> Self:
        """Return the rows of `other` where `chosen`, else these."""
        both = zip(self._arrays(), other._arrays(), strict=True)
        return type(self)(
            *(
                None if a is None or b is None else np.where(chosen.reshape(-1, *(1,) * (a.ndim - 1)), b, a)
                for a, b in both
            )
        )


@dataclass(frozen=True, eq=False)
class Crossings(_Rows):
    """Some crossings.

    Attributes:
        phi: number of φ.
        walker: standard normals of the walker.
        car: standard normals of the car, none of one that draws by number.
        draw: number of the car's draws, of one that does.
    """

    phi: IntArray
    walker: FloatArray
    car: FloatArray
    draw: IntArray

    def __len__(self) -> int:
        return len(self.phi)


@dataclass(frozen=True, eq=False)
class Ends(_Rows):
    """How crossings ended.

    Attributes:
        touch: of each, a `Touch`.
        missed: least time by which the front of the moving car missed, s (`missed_by`); 0 where, and only where, it
            hit.
        ticks: how many each had, that of a contact included.
    """

    touch: IntArray
    missed: FloatArray
    ticks: IntArray | None = None


class CrossingModel(Protocol):
    """Runs crossings of one car."""

    car_normals: int
    """How many normals the car's draws are made of."""

    def run(self, crossings: Crossings, scale: float) -> Ends:
        """Run crossings at a scale."""


@dataclass(frozen=True, eq=False)
class CrossingPlan:
    """What all crossings of a car share.

    Attributes:
        plan: of the assessment.
        safe: φ.
        values: parameters of the behaviour model, in the order of `MEANINGS`.
    """

    plan: Plan
    safe: tuple[Trajectory, ...]
    values: FloatArray

    @property
    def ticks(self) -> int:
        """Ticks of a crossing, at most."""
        return self.plan.scenario.ticks

    @property
    def walker_normals(self) -> int:
        """How many normals a walker is made of."""
        return normals_of(self.ticks)


SAME: Final = 1e-6
"""m by which a touching disc's distance may differ from its radius."""
IN_A_CURVE: Final = 0.01
"""The same in a curve, whose arcs the contact test takes for chords."""
_PARTS: Final = 4  # of a tick, at whose ends it is looked at by how much a hit is missed
_SLOWEST: Final = 0.2  # m/s; a walker beside the car's way who stands, or goes away, counts as if walking there so

CREEPING: Final = 0.6
"""m/s; a car that is less than that faster than a hit counts as if it were so much faster.

Else a car that rolls up to a walker is as far from a hit as one that stands, a hit by it is near nothing, and one that
is found by luck stays in all levels: such replicates were seven times as large as others.
"""


@kernel
def in_car_frame(
    path: FloatArray, here: tuple[float, float], there: tuple[float, float], share: float
) -> tuple[float, float, float]:
    """Return where the walker is in the car's frame at a share of the tick, and the car's speed there."""
    before, after = path[0], path[1]
    x, y = here[0] + share * (there[0] - here[0]), here[1] + share * (there[1] - here[1])
    car_x, car_y = before[0] + share * (after[0] - before[0]), before[1] + share * (after[1] - before[1])
    ahead, left = to_car_frame(x, y, car_x, car_y, before[2] + share * (after[2] - before[2]))
    return ahead, left, before[3] + share * (after[3] - before[3])


@kernel
def side_touched(
    ahead: float,
    left: float,
    footprint: tuple[float, float, float],
    radius: float,
    impact: float,
    hit_speed: float,
    same: float,
) -> int:
    """Return how a touch counts, a `Touch`.

    A disc that touches a side has its centre a radius beside it; one whose centre is nearer to the axis touches front
    or rear, or one of their corners. In a curve it is not known as exactly how far beside it is, and near the radius it
    tells whether the centre is ahead of the front, where nothing but a corner is.

    Args:
        ahead: how far the disc's centre is ahead of the car's reference point at the contact, m.
        left: how far it is to the left of the car's axis, m.
        footprint: of the car: front, rear and half width, m.
        radius: of the disc, m.
        impact: speed of the car at the contact, m/s.
        hit_speed: of a hit, at the least, m/s.
        same: how exactly the offset to the left is known, m: `SAME`, or `IN_A_CURVE`.
    """
    if impact < hit_speed:
        return 3
    front, rear, half_width = footprint
    if abs(left) >= half_width + radius - SAME or ahead <= 0.5 * (front - rear):
        return 2
    return 2 if ahead <= front and abs(left) >= half_width + radius - same else 1


@kernel
def missed_by(
    path: FloatArray,
    here: tuple[float, float],
    there: tuple[float, float],
    until: float,
    footprint: tuple[float, float, float],
    radius: float,
    hit_speed: float,
    time_step: float,
) -> float:
    """Return the least time by which a disc misses the front of the moving car in a tick, s; infinity if it stands.

    Ahead that is the distance over how much faster than a hit the car is: of a car that brakes at b and comes to that
    speed a distance m short of a walker it is never less than √(2m/b), or m over `CREEPING`, so that crossings are
    ordered by m, and a car that creeps, and can stop at once, is far from a hit, though not out of reach of one. To the
    side it is the distance over how fast the disc comes: a walker who stands beside the way of the car, or has left
    it, is far from a hit, however near.

    It orders crossings by how near they are to a hit, and no more hangs on it: it is looked at some times in a tick.

    Args:
        path: of the car in the tick, its two ends, 2 × 4.
        here: where the walker is when the tick begins, m.
        there: and when it ends, m.
        until: share of the tick up to which to look.
        footprint: of the car: front, rear and half width, m.
        radius: of the disc, m.
        hit_speed: speed of the car above which it moves, m/s.
        time_step: duration of the tick, s.
    """
    least = math.inf
    _, before, _ = in_car_frame(path, here, there, 0.0)
    _, after, _ = in_car_frame(path, here, there, 1.0)
    to_the_left = (after - before) / time_step
    for part in range(_PARTS + 1):
        ahead, left, speed = in_car_frame(path, here, there, until * part / _PARTS)
        if speed > hit_speed:
            aside = max(0.0, abs(left) - footprint[2])
            off = ahead - footprint[0]
            apart = math.sqrt(off * off + aside * aside)
            if apart <= radius:
                return 0.0
            outside = 1.0 - radius / apart
            comes = max(_SLOWEST, -to_the_left if left > 0.0 else to_the_left)
            along, across = outside * off / max(speed - hit_speed, CREEPING), outside * aside / comes
            least = min(least, math.sqrt(along * along + across * across))
    return least


NOWHERE: Final = (0.0, 0.0, 0.0)
"""Pose at a contact where there is none."""


class AnyCar:
    """Runs crossings as episodes.

    Attributes:
        hits: logs of those that were run last in which the car hit.
    """

    car_normals = 0

    def __init__(self, crossing_plan: CrossingPlan, runner: Runner | None) -> None:
        """Run episodes by `runner`; without one they can only be asked for."""
        self._crossing_plan, self._runner = crossing_plan, runner
        self.hits: list[EpisodeLog] = []
        self._specs: list[EpisodeSpec] = []
        scenarios: dict[float, Scenario] = {}
        for index, phi in enumerate(crossing_plan.safe):
            # A kamikaze's: its car starts as in an assessment, and is not met by a way that is no φ.
            spec = crossing_plan.plan.episode(Mode.KAMIKAZE, index, 0, phi)
            car = replace(spec.scenario.car, meet_safe_trajectory=False, start_gap=spec.start_gap)
            scenario = scenarios.setdefault(spec.start_gap, replace(spec.scenario, car=car))
            self._specs.append(replace(spec, mode=Mode.REPLAY, scenario=scenario, public=spec.public_scenario))

    def episodes(self, crossings: Crossings, scale: float) -> list[EpisodeSpec]:
        """Return the episodes of crossings."""
        found = []
        for phi, normals, draw in zip(crossings.phi.tolist(), crossings.walker, crossings.draw.tolist(), strict=True):
            spec, intended = self._specs[phi], self._crossing_plan.safe[phi]
            track = walked(intended.positions, self._crossing_plan.values, normals, scale, intended.time_step)
            track = until_obstacle(spec.scenario, track)
            number = episode_id(EpisodeGroup.RISK, phi, draw)
            trajectory = Trajectory(track, intended.time_step, intended.name)
            found.append(replace(spec, episode_id=number, safe_trajectory=trajectory))
        return found

    def run(self, crossings: Crossings, scale: float) -> Ends:
        """Run crossings."""
        assert self._runner is not None
        logs = list(self._runner.run(self.episodes(crossings, scale)))
        found = ends_of(logs)
        self.hits = [log for log, touch in zip(logs, found.touch.tolist(), strict=True) if touch == Touch.FRONT]
        return found


def until_obstacle(scenario: Scenario, track: FloatArray) -> FloatArray:
    """Return a way as far as the last tick before it runs into an obstacle, but for its first step."""
    if not len(scenario.rectangles):
        return track
    step = np.diff(track, axis=0) / scenario.time_step
    for tick, (vx, vy) in enumerate(step.tolist()):
        x, y = track[tick + 1].tolist()
        if scenario.ran_into_obstacle(AdversaryState(x, y, vx, vy, 0.0)):
            return track[: max(tick + 1, 2)]
    return track


def ends_of(logs: Sequence[EpisodeLog]) -> Ends:
    """Return how crossings ended."""
    touch, missed = zip(*map(end_of, logs), strict=True)
    return Ends(np.array(touch, np.int64), np.array(missed), np.array([len(log.adversary) - 1 for log in logs]))


def end_of(log: EpisodeLog) -> tuple[Touch, float]:
    """Return how a crossing ended, and the least time by which the front of the moving car missed, s."""
    if log.outcome == Outcome.ABORTED:
        return Touch.ABORTED, math.inf
    scenario = log.episode.scenario
    collided = log.outcome == Outcome.COLLISION
    pose, passed = car_at_contact(log) if collided else (NOWHERE, 1.0)
    headings = log.car[:-1, 2] + 0.5 * np.angle(np.exp(1j * np.diff(log.car[:, 2])))
    touch, missed = ended(
        np.ascontiguousarray(log.adversary), np.ascontiguousarray(log.car), headings,
        collision_partner(log) == ADVERSARY, passed, pose,
        collided and not goes_straight(scenario, log.car[-2:]), scenario.car.footprint, scenario.adversary.reach,
        log.impact_speed, scenario.collision.hit_speed, SAME if scenario.road.straight else IN_A_CURVE,
        scenario.time_step,
    )  # fmt: skip
    return Touch(touch), missed


@kernel
def ended(
    users: FloatArray,
    cars: FloatArray,
    headings: FloatArray,
    touched: bool,
    passed: float,
    pose: Pose,
    carried: bool,
    footprint: tuple[float, float, float],
    radius: float,
    impact: float,
    hit_speed: float,
    same: float,
    time_step: float,
) -> tuple[int, float]:
    """Return how a crossing ended, a `Touch`, and the least time by which the front of the moving car missed, s.

    Args:
        users: places of the walker at ticks, n × 2, m.
        cars: the car at ticks, as in `EpisodeLog`, n × 4.
        headings: of the car in each tick, n − 1, rad.
        touched: whether the car touched the walker in the last tick, and not one of the others.
        passed: share of the last tick that counts: up to the contact, with whomever, or all of it.
        pose: of the car at the contact, m and rad.
        carried: whether that is not where it would be between both ends of the tick.
        footprint: of the car: front, rear and half width, m.
        radius: of the disc, m.
        impact: speed of the car at the contact, m/s.
        hit_speed: of a hit, at the least, m/s.
        same: how exactly it is known how far beside the car the walker is, m.
        time_step: duration of a tick, s.
    """
    least, path, last = math.inf, np.empty((2, 4)), headings.shape[0] - 1
    for tick in range(last + 1):
        for end in range(2):
            path[end, 0], path[end, 1] = cars[tick + end, 0], cars[tick + end, 1]
            path[end, 2], path[end, 3] = headings[tick], cars[tick + end, 3]
        here, there = (users[tick, 0], users[tick, 1]), (users[tick + 1, 0], users[tick + 1, 1])
        until = passed if tick == last else 1.0
        if carried and tick == last:  # the tick ends at the contact
            path[1, 0], path[1, 1], path[1, 2], path[1, 3] = pose[0], pose[1], pose[2], impact
            there = (here[0] + passed * (there[0] - here[0]), here[1] + passed * (there[1] - here[1]))
            until = 1.0
        least = min(least, missed_by(path, here, there, until, footprint, radius, hit_speed, time_step))
    if not touched:
        return 0, max(least, 1e-9)
    ahead, left, _ = in_car_frame(path, here, there, until)
    side = side_touched(ahead, left, footprint, radius, impact, hit_speed, same)
    return side, 0.0 if side == 1 else max(least, 1e-9)


class CrossingNumbers(NamedTuple):
    """The scenario in numbers; lengths in m, speeds in m/s, times in s."""

    line: FloatArray  # of the road
    footprint: tuple[float, float, float]
    radius: float
    start_speed: float
    gap_range: float
    trigger: float
    deceleration: float
    noise: tuple[float, float]  # of the speed and of the acceleration, relative
    time_step: float
    minimum_impact_speed: float
    hit_speed: float


def crossing_numbers(episode: EpisodeSpec) -> CrossingNumbers:
    """Return a scenario in numbers."""
    scenario = episode.scenario
    car = scenario.car
    return CrossingNumbers(
        scenario.road.line,
        scenario.car.footprint,
        scenario.adversary.reach,
        car.start_speed,
        car.start_gap_range,
        episode.multiplier * car.safe_distance,
        car.deceleration,
        (car.speed_noise, car.acceleration_noise),
        scenario.time_step,
        scenario.collision.minimum_impact_speed,
        scenario.collision.hit_speed,
    )


@kernel
def cross(
    course: CrossingNumbers, track: FloatArray, count: int, gap: float, draws: FloatArray, path: FloatArray
) -> tuple[int, float, int]:
    """Let the car meet a person who walks a way.

    Args:
        course: the scenario.
        track: places at ticks, m.
        count: how many of them.
        gap: front bumper to the crossing line before the draw, m.
        draws: uniform in [0, 1): of the start, then of speed and acceleration in each tick.
        path: 2 × 4, to work in.

    Returns:
        A `Touch`, the least time by which the front of the moving car missed, s, and the number of ticks, that of the
        contact included.
    """
    s = -(gap + course.gap_range * draws[0]) - course.footprint[0]
    x, y, heading = road_pose(course.line, s)
    speed, least = course.start_speed, math.inf
    footprint, (speed_noise, acceleration_noise) = course.footprint, course.noise
    for tick in range(count - 1):
        here, there = (track[tick, 0], track[tick, 1]), (track[tick + 1, 0], track[tick + 1, 1])
        ahead, _ = to_car_frame(here[0], here[1], x, y, heading)
        command = basic_acceleration(ahead - footprint[0], course.trigger, course.deceleration)
        speed_draw = speed_noise * (2.0 * draws[1 + 2 * tick] - 1.0)
        applied = command + acceleration_noise * (2.0 * draws[2 + 2 * tick] - 1.0) * command
        after = next_speed(speed, applied, speed_draw, course.time_step)
        distance = travelled(speed, after, course.time_step)
        path[0, 0], path[0, 1], path[0, 2], path[0, 3] = x, y, heading, speed
        path[1, 0], path[1, 1] = x + distance * math.cos(heading), y + distance * math.sin(heading)
        path[1, 2], path[1, 3] = heading, after
        velocity = ((there[0] - here[0]) / course.time_step, (there[1] - here[1]) / course.time_step)
        share, impact = sweep(
            path, here, there, velocity, 0.0, footprint, (course.radius, 0.0, 0.0), course.time_step, 0, 1
        )
        until = 1.0
        contact = share <= 1.0 and impact >= course.minimum_impact_speed
        if contact:
            until = share
        near = missed_by(path, here, there, until, footprint, course.radius, course.hit_speed, course.time_step)
        least = min(least, near)
        if contact:
            ahead, left, _ = in_car_frame(path, here, there, share)
            side = side_touched(ahead, left, footprint, course.radius, impact, course.hit_speed, SAME)
            return side, 0.0 if side == 1 else max(least, 1e-9), tick + 1
        x, y, speed = path[1, 0], path[1, 1], after
    return 0, max(least, 1e-9), count - 1


@kernel
def cross_many(
    course: CrossingNumbers,
    paths: FloatArray,
    lengths: IntArray,
    gaps: FloatArray,
    values: FloatArray,
    phi: IntArray,
    walker: FloatArray,
    car: FloatArray,
    normal: bool,
    scale: float,
    touch: IntArray,
    missed: FloatArray,
    lasted: IntArray,
) -> None:
    """Run crossings; `car` has standard normals, or what is uniform in [0, 1) already."""
    ticks = (car.shape[1] - 1) // 2
    track, path, draws = np.empty((ticks + 1, 2)), np.empty((2, 4)), np.empty(car.shape[1])
    for row in range(phi.shape[0]):
        index = phi[row]
        intended = paths[index, : lengths[index]]
        count = walk(intended, values, walker[row], scale, course.time_step, track)
        for at in range(draws.shape[0]):
            draws[at] = 0.5 * math.erfc(-car[row, at] * math.sqrt(0.5)) if normal else car[row, at]
        touch[row], missed[row], lasted[row] = cross(course, track, count, gaps[index], draws, path)


class KnownCar:
    """Runs crossings in front of a basic car."""

    def __init__(self, crossing_plan: CrossingPlan) -> None:
        """Take the scenario apart into numbers."""
        self.car_normals = 1 + 2 * crossing_plan.ticks
        episodes = [
            crossing_plan.plan.episode(Mode.KAMIKAZE, index, 0, phi) for index, phi in enumerate(crossing_plan.safe)
        ]
        self._course = crossing_numbers(episodes[0])
        self._values = crossing_plan.values
        self._lengths = np.array([len(phi) for phi in crossing_plan.safe], np.int64)
        self._paths = np.zeros((len(crossing_plan.safe), int(self._lengths.max()), 2))
        for index, phi in enumerate(crossing_plan.safe):
            self._paths[index, : len(phi)] = phi.positions
        self._gaps = np.array([episode.start_gap for episode in episodes])

    def run(self, crossings: Crossings, scale: float) -> Ends:
        """Run crossings by the car's normals."""
        return self._run(crossings, crossings.car, scale, normal=True)

    def run_drawn(self, crossings: Crossings, draws: FloatArray, scale: float) -> Ends:
        """Run crossings by what the car has drawn, uniform in [0, 1)."""
        return self._run(crossings, draws, scale, normal=False)

    def _run(self, crossings: Crossings, car: FloatArray, scale: float, *, normal: bool) -> Ends:
        touch, missed = np.empty(len(crossings), np.int64), np.empty(len(crossings))
        lasted = np.empty(len(crossings), np.int64)
        cross_many(
            self._course, self._paths, self._lengths, self._gaps, self._values, crossings.phi,
            np.ascontiguousarray(crossings.walker), np.ascontiguousarray(car), normal, scale, touch, missed, lasted,
        )  # fmt: skip
        return Ends(touch, missed, lasted)


BLOCK: Final = 250
"""Crossings side by side; the same on every machine, so that no figure depends on that."""


def batched_car(crossing_plan: CrossingPlan, runner: Workers) -> BatchedCar | None:
    """Return who runs crossings side by side; None where the car's policy, or the scenario, has them one by one."""
    car = crossing_plan.plan.car
    if car.is_own or car.is_external:
        return None
    one = Crossings(np.array([0]), np.zeros((1, crossing_plan.walker_normals)), np.empty((1, 0)), np.array([0]))
    if why_not_batched(AnyCar(crossing_plan, runner).episodes(one, 1.0)[0]):
        return None
    (takes,) = runner.map(answers_batches, [car])
    return BatchedCar(crossing_plan, runner) if takes else None


class BatchedCar:
    """Runs crossings side by side, a block at a time."""

    car_normals = 0

    def __init__(self, crossing_plan: CrossingPlan, runner: Workers) -> None:
        """Run blocks by `runner`."""
        self._crossing_plan, self._runner = crossing_plan, runner

    def run(self, crossings: Crossings, scale: float) -> Ends:
        """Run crossings; those of a block that a worker has died of, one by one."""
        blocks = [
            crossings.of(np.arange(at, min(at + BLOCK, len(crossings)))) for at in range(0, len(crossings), BLOCK)
        ]
        found = self._runner.map(partial(_crossed, self._crossing_plan, scale), blocks, _not_crossed)
        one_by_one = AnyCar(self._crossing_plan, self._runner)
        pairs = zip(blocks, found, strict=True)
        return Ends.together([one_by_one.run(block, scale) if ends is None else ends for block, ends in pairs])


def _not_crossed(_block: Crossings, _reason: str) -> Ends | None:
    return None


def _crossed(crossing_plan: CrossingPlan, scale: float, block: Crossings) -> Ends | None:
    try:
        return isolated(crossing_plan.plan.car.user_code, partial(_crossed_here, crossing_plan, scale), block)
    except LostProcessError:
        return None


def _crossed_here(crossing_plan: CrossingPlan, scale: float, block: Crossings) -> Ends:
    """Run crossings side by side."""
    return ends_of(replayed(AnyCar(crossing_plan, None).episodes(block, scale)))
