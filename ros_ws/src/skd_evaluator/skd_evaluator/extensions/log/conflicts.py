"""Traffic conflicts in a recorded drive: a road user and the car who would come close if both went on as they go.

A conflict becomes a scenario: the car at its recorded place and speed, the road user on its recorded trajectory φ. From
the recording alone follow bounds of the safety margin of the car that drove (Zanardi et al., arXiv 2308.01050);
the margin of a car under test is found by driving the scenario. The worst ones make up a campaign.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from skd_adversary.crossing.road_users import road_user_named
from skd_sim.controllers.isolated import isolated
from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import AdversaryModel, CarUnderTest, ControllerName
from skd_sim.scenario.scenario import Scenario, scenario_from_dict
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import BoolArray, FloatArray, Trajectory

from skd_evaluator.assessment.context import Progress
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.assessment.stages.margin import LABEL, exact_or_found
from skd_evaluator.bags.tracks import Track
from skd_evaluator.extensions.log.drives import CAR_SMOOTHED, RecordedDrive, path_at, states_at, steady_state
from skd_evaluator.margin.actions import has_exact_margin
from skd_evaluator.margin.search.rounds import one_by_one
from skd_evaluator.margin.search.search import IN_PROCESS, search_margins
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.report.repeat import SCENARIO_FILE, TRAJECTORY_FILE, write_trial

STEP, FINE = 0.05, 0.02
"""s between the moments at which a drive, and a conflict in it, is looked at."""
_NEAR = 0.5  # m between outlines, below which a predicted approach counts
_LASTS = 0.25  # s that a conflict lasts at least
_BEFORE, _AFTER = 1.0, 3.0  # s before it shows, and after the two are nearest
_DRIVES = 1.0  # m/s
_ASIDE = 0.75  # m that the car may be off a straight line
_GRADES = 41  # moments of a prediction


@dataclass(frozen=True, eq=False)
class Conflict:
    """A conflict.

    Attributes:
        drive: name of the recording.
        user: name of the road user.
        begins: when the scenario begins, s on the recording's clock.
        nearest: when the two were nearest, s on the same clock.
        speed: of the car when it begins, m/s.
        recorded: least distance of the outlines while the car drove, m: the margin of a car that goes on as recorded.
        least: lower bound of the margin of the car that drove, m; see `_bounds`.
        most: upper bound, m.
        why: why it is not driven again; empty where it is.
        scenario: what it became; None where it is not driven again.
        safe: φ in that scenario.
        gap: from the front of the car to where φ crosses its line when it begins, m; None where it is not driven again.
        margin: of the car under test, m; None where none was computed.
        exact: whether it is exact; else it was searched for, and is at most so much.
        impact_speed: of the car under test in the hit of the margin, m/s; None without any.
    """

    drive: str
    user: str
    begins: float
    nearest: float
    speed: float
    recorded: float
    least: float
    most: float
    why: str = ""
    scenario: Scenario | None = None
    safe: Trajectory | None = None
    gap: float | None = None
    margin: float | None = None
    exact: bool | None = None
    impact_speed: float | None = None

    @property
    def rank(self) -> tuple[bool, float, float]:
        """What conflicts are sorted by, the worst first: the margin, else the recorded distance."""
        return self.scenario is None, self.recorded if self.margin is None else self.margin, self.recorded

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        left_out = ("scenario", "safe")
        return {one.name: getattr(self, one.name) for one in fields(self) if one.name not in left_out}


@dataclass(frozen=True)
class ConflictRequest:
    """What counts as a conflict, and what a car could do.

    Attributes:
        scenario: road, shapes and braking of the car, and the kind of road user.
        within: how far both are predicted, s.
        reaction: of the car that brakes as soon as it can, s.
        longest_gap: time over which nothing is filled in, s.
        reference: how far ahead of the middle of the car the tracked point is, m.
    """

    scenario: Scenario
    within: float = 4.0
    reaction: float = 0.1
    longest_gap: float = 0.5
    reference: float = 0.0


class _Approach(NamedTuple):
    """A road user that would meet the car: its track, and the first and the last time at which that is so, s."""

    user: Track
    first: float
    last: float


def conflicts_in(drive: RecordedDrive, request: ConflictRequest) -> list[Conflict]:
    """Return the conflicts of a drive by their times."""
    car = drive.car
    times = np.arange(car.times[0], car.times[-1], STEP)
    driven = _pointing(states_at(car, times, request.longest_gap, CAR_SMOOTHED), request.reference)
    found: list[_Approach] = []
    for user in drive.users:
        some = np.flatnonzero((times >= user.times[0]) & (times <= user.times[-1]))
        if some.size:
            met = _meets(driven[some], states_at(user, times[some], request.longest_gap), request)
            found += [
                _Approach(user, *times[some][[first, last]].tolist()) for first, last in _spans(met, request.within)
            ]
    return [_conflict(drive, one, found, request) for one in sorted(found, key=lambda each: each.first)]


def _pointing(states: FloatArray, reference: float) -> FloatArray:
    """Return x, y (m) of the car's middle, its heading (rad) and speed (m/s), n × 4: it points where it goes."""
    speed = np.hypot(*states[:, 2:].T)
    heading = np.arctan2(states[:, 3], states[:, 2])
    moving = np.flatnonzero(speed > 0.5 * _DRIVES)
    if moving.size:
        heading = heading[moving[np.maximum(np.searchsorted(moving, np.arange(len(speed)), side="right") - 1, 0)]]
    middle = states[:, :2] - reference * np.column_stack([np.cos(heading), np.sin(heading)])
    return np.column_stack([middle, heading, speed])


def _clearance(scenario: Scenario, car: FloatArray, places: FloatArray, longer: float | FloatArray = 0.0) -> FloatArray:
    """Return how far road users at places (… × 2) are from the outline of the car at poses (… × 3 or more), m.

    The outline may be longer behind than the car is, m.
    """
    offset, cos, sin = places - car[..., :2], np.cos(car[..., 2]), np.sin(car[..., 2])
    ahead = cos * offset[..., 0] + sin * offset[..., 1]
    left = cos * offset[..., 1] - sin * offset[..., 0]
    body = scenario.car
    outside = np.maximum(np.maximum(ahead - body.front, -body.rear - longer - ahead), 0.0)
    apart = np.hypot(outside, np.maximum(np.abs(left) - body.half_width, 0.0))
    return np.asarray(np.maximum(apart - scenario.adversary.reach, 0.0))


def _meets(car: FloatArray, user: FloatArray, request: ConflictRequest) -> BoolArray:
    """Return at which moments the two, both going on at their velocities, come near to each other."""
    ahead = np.linspace(0.0, request.within, _GRADES)[None, :, None]
    velocity = car[:, 3:] * np.column_stack([np.cos(car[:, 2]), np.sin(car[:, 2])])
    places = user[:, None, :2] + ahead * (user[:, 2:] - velocity)[:, None]
    apart = _clearance(request.scenario, np.broadcast_to(car[:, None], (*places.shape[:2], 4)), places)
    return np.asarray((apart.min(axis=1) < _NEAR) & (car[:, 3] > _DRIVES))


def _spans(flags: BoolArray, pause: float) -> Iterator[tuple[int, int]]:
    """Yield the first and last moment of each time that lasts, with pauses of at most so many s."""
    rows = np.flatnonzero(flags)
    for part in np.split(rows, np.flatnonzero(np.diff(rows) * STEP > pause) + 1):
        if len(part) * STEP >= _LASTS:
            yield int(part[0]), int(part[-1])


def _conflict(
    drive: RecordedDrive, approach: _Approach, every: Sequence[_Approach], request: ConflictRequest
) -> Conflict:
    user, car, gap = approach.user, drive.car, request.longest_gap
    begin = max(approach.first - _BEFORE, float(user.times[0]), float(car.times[0]))
    times = np.arange(begin, min(approach.last + request.within, user.times[-1], car.times[-1]), FINE)
    driven = _pointing(states_at(car, times, gap, CAR_SMOOTHED), request.reference)
    seen = states_at(user, times, gap)[:, :2]
    first = int(np.argmax(np.isfinite(np.column_stack([driven, seen])).all(axis=1)))
    times, driven, seen = times[first:], driven[first:], seen[first:]
    if (start := steady_state(car, float(times[0]), gap)) is not None:
        driven[0] = _pointing(start[None], request.reference)[0]
    apart = _clearance(request.scenario, driven, seen)
    nearest = float(times[int(np.nanargmin(np.where(driven[:, 3] > _DRIVES, apart, np.inf)))])
    until = times <= nearest + _AFTER
    times, driven, seen = times[until], driven[until], seen[until]
    begins, met = (car.origin + float(one) for one in (times[0], nearest))
    found = Conflict(drive.name, user.name, begins, met, float(driven[0, 3]), *_bounds(request, driven, seen))
    others = [short_name(one.user.name) for one in every if one is not approach and _overlap(one, approach)]
    if others:
        return replace(found, why=f"several conflicts at once: also with {', '.join(dict.fromkeys(others))}")
    try:
        return _simulated(found, times, driven, user, request)
    except UsageError as error:
        return replace(found, why=str(error))


def short_name(user: str) -> str:
    """Return the id of a tracked object, of a long one its beginning; the name of what has none."""
    name = user.rpartition(":")[2]
    return f"{name[:8]}…" if len(name) == 32 and name.isalnum() else name  # a UUID


def _overlap(one: _Approach, other: _Approach) -> bool:
    return one.first <= other.last and other.first <= one.last


def _simulated(
    found: Conflict, times: FloatArray, driven: FloatArray, user: Track, request: ConflictRequest
) -> Conflict:
    """Return a conflict with its scenario.

    Raises:
        UsageError: it cannot be driven again.
    """
    base = request.scenario
    if found.speed < _DRIVES:
        raise UsageError(f"the car stands when it begins ({found.speed:.1f} m/s)")
    ticks = times[0] + base.time_step * np.arange(base.ticks + 1)
    walked = path_at(user, ticks, request.longest_gap)
    holes = np.flatnonzero(np.isnan(walked).any(axis=1))
    walked = walked[: holes[0]] if holes.size else walked
    whole = len(walked) > 1 and ticks[len(walked) - 1] >= times[-1] - base.time_step
    if not whole or not np.isfinite(driven).all():
        raise UsageError(f"the road user or the car is not tracked for more than {request.longest_gap:g} s of it")
    until = times <= found.nearest - found.begins + times[0] + 0.5
    line, offset, across = _line(driven[until, :2])
    if offset > _ASIDE:
        raise UsageError(f"the car turns: it is {offset:.1f} m off a straight line")
    fastest = road_user_named(base.adversary.kind).fastest
    speed = float(np.hypot(*np.diff(walked, axis=0).T).max(initial=0.0)) / base.time_step
    if speed > fastest:
        raise UsageError(f"the road user goes {speed:.1f} m/s, and no {base.adversary.kind} does: give --scenario")
    phi = np.column_stack([(walked - driven[0, :2]) @ across, (walked - driven[0, :2]) @ line])
    if phi[-1, 0] < phi[0, 0]:
        phi[:, 0] *= -1.0
    after = np.flatnonzero((phi[:-1, 0] < 0.0) & (phi[1:, 0] >= 0.0))
    if after.size:
        (x, y), (to_x, to_y) = phi[after[0]], phi[after[0] + 1]
        crossed = float(y - x * (to_y - y) / (to_x - x))
    else:
        crossed = float(phi[int(np.argmin(np.abs(phi[:, 0]))), 1])
    crossed = max(crossed, base.car.front)
    phi[:, 1] -= crossed
    name = f"{found.drive}-{short_name(found.user).strip('/')}-{found.begins:.1f}"
    scenario = _scenario(base, name, phi, found.speed, crossed - base.car.front)
    return replace(found, scenario=scenario, safe=Trajectory(phi, base.time_step, name), gap=scenario.car.start_gap)


def _line(places: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Return the direction of a drive, how far it is off a straight line at most, m, and what is to its right."""
    centre = places.mean(axis=0)
    line = np.linalg.svd(places - centre, full_matrices=False)[2][0]
    line = line if line @ (places[-1] - places[0]) >= 0.0 else -line
    across = np.array([line[1], -line[0]])
    return line, float(np.abs((places - centre) @ across).max()), across


def _scenario(base: Scenario, name: str, phi: FloatArray, speed: float, gap: float) -> Scenario:
    """Return the scenario of a conflict: what its base says of car, road and road user, without any noise."""
    left_out = ("ending", "protocol", "others", "obstacles")
    data = {key: value for key, value in base.as_dict().items() if key not in left_out}
    start = {"start_x": float(phi[0, 0]), "start_y": float(phi[0, 1])}
    beyond = max(base.path_edge, float(phi[0, 0])) + 1.0
    data |= {
        "name": name,
        "description": "A conflict of a recorded drive.",
        "road": {"lane_width": base.road.lane_width, "friction": base.road.friction},
        "car": data["car"] | {"start_speed": speed, "start_gap": gap, "start_gap_range": 0.0}
        | {"meet_safe_trajectory": False, "speed_noise": 0.0, "acceleration_noise": 0.0},
        "adversary": data["adversary"] | start | {"destination_x": beyond},
    }  # fmt: skip
    return scenario_from_dict(data, name)


def _bounds(request: ConflictRequest, car: FloatArray, places: FloatArray) -> tuple[float, float, float]:
    """Return the margin of a car that goes on as recorded, whatever happens, and the least and most it may be, m.

    The first is the least distance between the outlines while the car drives. For the others the road user follows φ up
    to any moment, and then goes straight, as fast as its kind does, to where the outlines touch. The car does from then
    on anything between a full brake after the reaction time and no brake at all (least), or brakes fully (most).

    Args:
        request: what a car could do.
        car: recorded poses and speeds each `FINE` s, n × 4.
        places: φ at the same moments, n × 2, m.
    """
    scenario = request.scenario
    slow, brake, most = scenario.collision.hit_speed, scenario.car.deceleration, scenario.eta_max
    apart = _clearance(scenario, car, places)
    recorded = least = float(np.nanmin(np.where(car[:, 3] >= slow, apart, most), initial=most))
    braked, delay = most, round(request.reaction / FINE)
    for leaves in range(len(car) - 1):
        rest = car[leaves:]
        passed = FINE * np.arange(len(rest))
        begin = min(delay, len(rest) - 1)
        lasted = np.clip(passed - passed[begin], 0.0, rest[begin, 3] / brake)
        speed = np.where(passed <= passed[begin], rest[:, 3], rest[begin, 3] - brake * lasted)
        ahead = np.array([math.cos(rest[begin, 2]), math.sin(rest[begin, 2])])
        stops, goes = rest[:, :3].copy(), rest[:, :3].copy()
        stops[begin:] = rest[begin, :3]
        stops[:, :2] += (lasted * (rest[begin, 3] - 0.5 * brake * lasted))[:, None] * ahead
        goes[:, :2] = rest[0, :2] + (rest[0, 3] * passed)[:, None] * ahead
        goes[:, 2] = rest[begin, 2]
        behind = np.maximum((goes[:, :2] - stops[:, :2]) @ ahead, 0.0)
        reach = scenario.adversary.speed * passed
        away = np.hypot(*(places[leaves:] - places[leaves]).T)
        for poses, longer, moves in ((stops, 0.0, speed >= slow), (goes, behind, rest[0, 3] >= slow)):
            apart = _clearance(scenario, poses, places[leaves:], longer)
            possible = moves & ((apart == 0.0) | (away + apart <= reach))
            found = float(np.nanmin(np.where(possible, apart, most), initial=most))
            braked, least = (min(braked, found), least) if poses is stops else (braked, min(least, found))
    return recorded, least, max(recorded, braked)


CAMPAIGN = "campaign.yaml"


def with_margins(
    conflicts: Sequence[Conflict], car: CarUnderTest, limit: int, runner: Workers, progress: Progress
) -> list[Conflict]:
    """Return conflicts with the margin of a car in each that can be driven again.

    Args:
        conflicts: found in recordings.
        car: the car under test, in process.
        limit: candidates that the search for a margin may drive.
        runner: drives them, in several processes.
        progress: called with how far the work is.

    Raises:
        AssessmentError: the car fails.
    """
    found = list(conflicts)
    of_car: dict[str, Any] = {"controller": car.controller, "multiplier": car.multiplier}
    of_car["adversary_model"] = AdversaryModel.GENERIC  # nothing is planned
    trials = [
        EpisodeSpec(one.scenario, Mode.KAMIKAZE, 0, row, one.safe, **of_car)
        for row, one in enumerate(found)
        if one.scenario is not None
    ]
    hits = runner.map(partial(_isolated, limit), trials)
    for count, (trial, hit) in enumerate(zip(trials, hits, strict=True), start=1):
        margin = trial.scenario.eta_max if hit is None else min(hit.distance, trial.scenario.eta_max)
        row, exact = trial.episode_id, has_exact_margin(car, trial.scenario)
        speed = None if hit is None else hit.impact_speed
        found[row] = replace(found[row], margin=margin, exact=exact, impact_speed=speed)
        progress(LABEL, count, len(trials))
    return found


def least_deviation(limit: int, trial: EpisodeSpec) -> Hit | None:
    """Return the hit of least deviation in a trial, for which so many candidates may be driven; None: none was found.

    It is exact where the car is known, else the best that was found.
    """
    if has_exact_margin(trial.car, trial.scenario):
        return exact_or_found(trial)
    return search_margins([trial], {}, one_by_one, IN_PROCESS._replace(limit=limit)).hits[0]


def _isolated(limit: int, trial: EpisodeSpec) -> Hit | None:
    return isolated(trial.car.user_code, partial(least_deviation, limit), trial)


def export(folder: Path, conflicts: Sequence[Conflict], controller: str | None, multiplier: float) -> None:
    """Write each conflict that can be driven again as a scenario with its φ, and a campaign of all.

    Args:
        folder: into which; it is there.
        conflicts: the worst first.
        controller: of the car under test; None: basic.
        multiplier: its C, if it is basic.
    """
    cells: list[dict[str, Any]] = []
    for number, one in enumerate(conflicts, start=1):
        assert one.scenario is not None
        assert one.safe is not None
        inside = folder / f"conflict_{number:03}"
        inside.mkdir()
        write_trial(inside, one.scenario, one.safe)
        files = {"scenario": f"{inside.name}/{SCENARIO_FILE}", "safe": f"{inside.name}/{TRAJECTORY_FILE}"}
        cells.append({"name": inside.name, **files})
    name = str(ControllerName(controller or "basic"))
    car = {"controller": name, **({"multiplier": multiplier} if name == "basic" else {})}
    few = {"safe_count": 1, "kamikaze_count": 1, "collision_runs": 1}
    campaign = {"defaults": few, "cars": [car], "scenarios": cells}
    (folder / CAMPAIGN).write_text(yaml.safe_dump(campaign, sort_keys=False), encoding="utf-8")
