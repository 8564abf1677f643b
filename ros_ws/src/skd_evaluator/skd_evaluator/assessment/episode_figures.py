"""What single episodes say beside the planned figures: collision partner, surrogate measures, ages of commands.

Surrogate measures depend on who walks: along φ no adversary aims at the car, and kamikazes want to be hit. So the two
are never put together, and nothing is rated by them.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final, TextIO

import numpy as np
from skd_sim.scenario.road import beyond, right_and_along
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog, Outcome
from skd_sim.world.state import FloatArray, RoadUserState

from skd_evaluator.assessment.plan import split_episode_id
from skd_evaluator.assessment.plausibility import driven_paths
from skd_evaluator.metrics.aborted import NOT_CREDIBLE
from skd_evaluator.metrics.contact_place import Pose, car_at_contact, leaves_line, outline_of
from skd_evaluator.metrics.entry import Entry
from skd_evaluator.metrics.surrogate_measures import SURROGATE_MEASURES, clearance_at, surrogate_measures
from skd_evaluator.metrics.surrogate_scenes import course_of

ADVERSARY, ROAD_EDGE = -1, -2


def collision_partner(log: EpisodeLog) -> int | None:
    """Return what was touched: `ADVERSARY`, `ROAD_EDGE`, or the number of one of the others; None without a collision.

    It is the one who is nearest to the car at the impact, whose place within the tick is interpolated.
    """
    scenario = log.episode.scenario
    if log.outcome != Outcome.COLLISION:
        return None
    steered = leaves_line(scenario, log.car[-2:])
    if not scenario.others and not steered:
        return ADVERSARY
    pose, share = car_at_contact(log)
    body, place = scenario.adversary, log.trajectory.positions[-1].tolist()
    apart = [clearance_at(scenario, pose, body, place, body.last_heading(log.adversary))]
    for other, (before, after) in zip(scenario.others, _others_in_last_tick(log), strict=True):
        state = before.moved(after, share * scenario.time_step)
        apart.append(clearance_at(scenario, pose, other, state[:2], state.heading))
    nearest = int(np.argmin(apart))
    if steered and _from_edge(scenario, pose) < apart[nearest]:
        return ROAD_EDGE
    return nearest - 1


def _from_edge(scenario: Scenario, pose: Pose) -> float:
    """Return how far inside the road the car's outermost corner is, m; how far outside it is just as well."""
    right = right_and_along(scenario.road.line, outline_of(scenario, pose))[:, 0]
    left_edge, right_edge = scenario.road.edges
    return abs(min(left_edge + float(right.min()), right_edge - float(right.max())))


def closing_speed(log: EpisodeLog) -> float:
    """Return the speed of the car relative to whom it touched, m/s; nan without a collision.

    Euro NCAP's impact speeds of pedestrians are the car's own; of two vehicles what counts is this.
    """
    who = collision_partner(log)
    if who is None:
        return math.nan
    heading = car_at_contact(log)[0][2]
    vx, vy = (log.adversary[-1] - log.adversary[-2]) / log.episode.scenario.time_step
    if who == ROAD_EDGE:
        return log.impact_speed
    if who != ADVERSARY:
        vx, vy = _others_in_last_tick(log)[who][1][2:4]
    return math.hypot(log.impact_speed * math.cos(heading) - vx, log.impact_speed * math.sin(heading) - vy)


def speed_ahead(log: EpisodeLog) -> float:
    """Return how fast the adversary moves the way that the car points, when the two collide, m/s."""
    heading = car_at_contact(log)[0][2]
    vx, vy = (log.adversary[-1] - log.adversary[-2]) / log.episode.scenario.time_step
    return float(vx * math.cos(heading) + vy * math.sin(heading))


def _others_in_last_tick(log: EpisodeLog) -> list[tuple[RoadUserState, RoadUserState]]:
    """Return the states of each of the others when the last tick begins and when it ends."""
    scenario, tick = log.episode.scenario, len(log.adversary) - 2
    return list(zip(scenario.others_at(tick), scenario.others_at(tick + 1), strict=True))


STANDING = 0.1
"""m/s below which a car stands when it is touched: then it was walked into."""


_ASIDE = 0.05
"""m that a car which keeps to its lane stays within."""


def steers(log: EpisodeLog) -> bool:
    """Return whether the car leaves the middle of its lane."""
    places = right_and_along(log.episode.scenario.road.line, np.ascontiguousarray(log.car[:, :2]))
    return bool(np.abs(places[:, 0]).max() > _ASIDE)


def lane_left(log: EpisodeLog) -> float:
    """Return for how long a corner of the car is beyond the edges of its lane, s; nan of an aborted episode."""
    if log.outcome == Outcome.ABORTED:
        return math.nan
    if not steers(log):
        return 0.0
    road, footprint, shares = log.episode.scenario.road, log.episode.scenario.car.footprint, list[float]()
    edges = 0.5 * road.lane_width, 0.5 * road.lane_width
    for path in driven_paths(log):
        out = [beyond(road.line, edges, footprint, path[row : row + 1]) >= 0 for row in range(1, len(path))]
        shares.append(float(np.mean(out)))
    return (len(log.car) - 1) * log.episode.scenario.time_step * float(np.mean(shares))


def standing_contacts(logs: Iterable[EpisodeLog]) -> int:
    """Return how many episodes ended with an adversary that walked into a standing car."""
    return sum(log.outcome == Outcome.COLLISION and log.impact_speed < STANDING for log in logs)


def simulator_contacts(logs: Iterable[EpisodeLog]) -> dict[str, Any]:
    """Return the entry of assessment.json; empty where the simulator has no shapes of its own.

    Args:
        logs: episodes; aborted ones do not count.
    """
    requested = [log for log in logs if log.own_contact is not None and log.outcome != Outcome.ABORTED]
    if not requested:
        return {}
    pairs = [(log.impact_time, float(log.own_contact or 0.0)) for log in requested]
    found = [(not math.isnan(ours), not math.isnan(its)) for ours, its in pairs]
    gaps = [abs(ours - its) for ours, its in pairs if not math.isnan(ours - its)]
    return {
        "both": found.count((True, True)),
        "geometry_alone": found.count((True, False)),
        "simulator_alone": found.count((False, True)),
        "episodes": len(requested),
        "greatest_gap": max(gaps, default=None),
    }


def command_age(logs: Iterable[EpisodeLog]) -> dict[str, Any] | None:
    """Return the figures of episodes that ran to their end; None if nothing is known, as for episodes in process.

    Ages are s of wall time, over all control periods of all episodes; `held` counts the control periods for which no
    new command had come, and `greatest_delay` (s) is by how much the latest control period of real time was late.
    """
    timings = [log.timing for log in logs if log.outcome != Outcome.ABORTED and log.timing.ages]
    if not timings:
        return None
    ages = np.concatenate([timing.ages for timing in timings])
    median, late = np.percentile(ages, (50.0, 99.0))
    return {
        "median": float(median),
        "p99": float(late),
        "worst": float(ages.max()),
        "control_periods": len(ages),
        "held": sum(timing.held for timing in timings),
        "greatest_delay": max(timing.delay for timing in timings),
    }


SURROGATES = "surrogate_measures.csv"
ALONG_PHI, KAMIKAZES = "along_phi", "kamikazes"
DEPENDS_ON = {
    ALONG_PHI: "the car and φ; no adversary aims at the car",
    KAMIKAZES: "the car, φ, and kamikazes that aim at being hit",
}


@dataclass(frozen=True, eq=False)
class Surrogates:
    """Surrogate safety measures of episodes.

    Attributes:
        logs: the episodes, aborted ones left out.
        objectives: objective of each; empty of a run along φ.
        values: of each measure by its name, one an episode; nan: not defined, or it never came about.
    """

    logs: tuple[EpisodeLog, ...]
    objectives: tuple[str, ...]
    values: dict[str, FloatArray]

    def as_dict(self) -> dict[str, Any]:
        """Return what they come to: the entry of assessment.json."""
        objectives = np.array(self.objectives, str)
        names = [name for name in dict.fromkeys(self.objectives) if name]
        return {
            ALONG_PHI: self._group(objectives == "", ALONG_PHI),
            KAMIKAZES: {name: self._group(objectives == name, KAMIKAZES) for name in names},
        }

    def write_csv(self, file: TextIO) -> None:
        """Write the content of surrogate_measures.csv, row by row: an episode each, blank where not defined."""
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["objective", "episode_id", "phi", "trial", "outcome", *self.values])
        for log, objective, *values in zip(self.logs, self.objectives, *self.values.values(), strict=True):
            number = log.episode.episode_id
            _, phi, trial = split_episode_id(number)
            stated = [f"{one:.9g}" if math.isfinite(one) else "" for one in values]
            rows.writerow([objective, number, phi, trial, log.outcome.name.lower(), *stated])

    def _group(self, rows: Any, who: str) -> dict[str, Any]:
        found: dict[str, Any] = {"depends_on": DEPENDS_ON[who], "episodes": int(np.count_nonzero(rows))}
        for name, measure in SURROGATE_MEASURES.items():
            values = self.values[name][rows] if self.logs else np.empty(0)
            known = values[np.isfinite(values)]
            worst = known.min if measure.worst == "min" else known.max
            found[name] = {
                "median": float(np.median(known)) if known.size else None,
                "worst": float(worst()) if known.size else None,
                "defined": int(known.size),
            }
        return found


def surrogates_of(scenario: Scenario, episodes: Iterable[tuple[EpisodeLog, str]]) -> Surrogates:
    """Return the measures of episodes in a scenario, each with its objective; those of the adversary and the car.

    An episode that ended because the car touched one of the others counts as one in which it did not touch the
    adversary.
    """
    kept = [(log, objective) for log, objective in episodes if log.outcome != Outcome.ABORTED and len(log.car) > 1]
    logs: Sequence[EpisodeLog] = [log for log, _ in kept]
    courses = (course_of(scenario, log.adversary, log.car, log.impact_time, log.impact_speed) for log in logs)
    collided = np.array([collision_partner(log) == ADVERSARY for log in logs], bool)
    return Surrogates(tuple(logs), tuple(name for _, name in kept), surrogate_measures(scenario, courses, collided))


@dataclass(frozen=True, kw_only=True)
class StaticTest(Entry):
    """One static test: no noise, and a target that goes the protocol's way whatever the car does.

    Attributes:
        place: % of the car's width at which the unbraked car meets the target.
        touched: whether there was a contact.
        target: whether the target was touched, and no other road user.
        impact_speed: of the car, m/s; 0 without a contact.
        speed_ahead: of the target, along the car's heading, m/s.
        fastest: greatest speed of the car, m/s.
        braking_ttc: time to collision when the car began to brake, along the lane with both speeds kept, s; None where
            it did not brake before the target.
        aborted: why it was aborted; empty: it was not.
    """

    KEYS = "place touched target impact_speed speed_ahead fastest braking_ttc aborted"

    place: float
    touched: bool = False
    target: bool = False
    impact_speed: float = 0.0
    speed_ahead: float = 0.0
    fastest: float = 0.0
    braking_ttc: float | None = None
    aborted: str = ""

    @classmethod
    def of(cls, place: float, log: EpisodeLog) -> StaticTest:
        """Return what an episode of `static_episodes` says."""
        if log.outcome == Outcome.ABORTED:
            return cls(place=place, aborted=log.reason)
        touched = log.outcome == Outcome.COLLISION
        impact = log.impact_speed if touched else 0.0
        return cls(
            place=place,
            touched=touched,
            target=touched and collision_partner(log) == ADVERSARY,
            impact_speed=impact,
            speed_ahead=speed_ahead(log) if touched else 0.0,
            fastest=max(impact, float(log.car[:, 3].max())),
            braking_ttc=braking_ttc(log),
        )


_BRAKES = 0.5  # m/s² by which a car slows at least that brakes


def braking_ttc(log: EpisodeLog) -> float | None:
    """Return the time to collision along the lane (s) at the tick from which the car brakes; None where it does not."""
    scenario = log.episode.scenario
    slows = np.flatnonzero(np.diff(log.car[:, 3]) < -_BRAKES * scenario.time_step)
    if not slows.size:
        return None
    tick = int(slows[0])
    line = scenario.road.line
    (_, front), (_, there), (_, then) = right_and_along(
        line, np.array([log.car[tick, :2], log.adversary[tick], log.adversary[tick + 1]])
    ).tolist()
    gap = there - front - scenario.car.front
    closing = float(log.car[tick, 3]) - (then - there) / scenario.time_step
    return gap / closing if gap > 0.0 and closing > 0.0 else None


DRIVES_NOT: Final = "a car that does not drive hits no road user, so its figures do not say how it avoids them"
_NEARLY_ALL = 0.9  # of the runs along φ
_GENTLY, _ROOM = 2.0, 5.0  # m/s², m


def standing(car: str, logs: Sequence[EpisodeLog]) -> tuple[str, ...]:
    """Return in a line that a car stands far from every road user in nearly all runs along φ; empty if it does not.

    It follows from what happened, so it is asked of recordings, too.

    Args:
        car: name of the car.
        logs: its runs along φ.
    """
    runs = [one for one in logs if one.outcome != Outcome.ABORTED]
    still = sum(map(_stands_far_off, runs))
    if not runs or still < _NEARLY_ALL * len(runs):
        return ()
    far = _far(runs[0].episode.scenario)
    what = f"{car} stood from more than {far:.0f} m away from every road user on"
    return (f"{NOT_CREDIBLE}in {still} of {len(runs)} runs along φ {what}: {DRIVES_NOT}",)


def _far(scenario: Scenario) -> float:
    """Return from how far on a car has no need to slow down yet, m: it can still stop gently."""
    return scenario.car.start_speed**2 / (2.0 * _GENTLY) + _ROOM


def _stands_far_off(log: EpisodeLog) -> bool:
    """Tell whether a car was slower than a hit begins from some tick to the end, far from every road user."""
    scenario = log.episode.scenario
    drives = np.flatnonzero(log.car[:, 3] >= scenario.collision.hit_speed)
    tick = int(drives[-1]) + 1 if drives.size else 0
    if log.hit or tick == len(log.car):
        return False
    x, y = log.car[tick, :2].tolist()
    (near_x, near_y), adversary = log.adversary[tick].tolist(), scenario.adversary
    away = [math.hypot(near_x - x, near_y - y) - adversary.reach]
    for other, state in zip(scenario.others, scenario.others_at(tick), strict=True):
        away.append(math.hypot(state.x - x, state.y - y) - other.reach)
    return min(away) - scenario.car.front > _far(scenario)


MISSED, MOST_MISSED = 0.05, 0.25
"""Shares of the control periods without a new command of the car, above which that is warned of, and a failure."""


def missed_periods(controller: str, logs: Iterable[EpisodeLog]) -> tuple[str, ...]:
    """Return in a line that a stack missed many of its control periods; empty if it did not."""
    age = command_age(logs)
    share = age["held"] / age["control_periods"] if age else 0.0
    if age is None or share <= MISSED:
        return ()
    begin = NOT_CREDIBLE if share > MOST_MISSED else ""
    return (
        f"{begin}in {age['held']} of {age['control_periods']} control periods ({100 * share:.0f} %) "
        f"{controller} sent no new command, and its last one was held: it is slower than its control "
        "period, or silent; let it publish always, or try a longer -p control_period, a lower -p rate_factor, or "
        "--pacing lockstep",
    )
