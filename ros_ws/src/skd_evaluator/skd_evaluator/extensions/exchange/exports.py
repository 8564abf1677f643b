"""The work of `skd export`: which episodes and φ of a result are written, and the formats in which they are.

OpenSCENARIO XML 1.2: road users on polylines with a time at each vertex. An entity's origin is SKD's reference point;
its bounding box says where the body is around it. Vertices are the states at ticks and that at the contact.

OpenDRIVE 1.8: the reference line is the middle of the car's lane. A lane offset moves the lanes' zero to the left edge
of those that run as the car drives, so that these have ids −1, −2, … from left to right, and those to their left 1, 2,
….
Lanes elsewhere are roads of their own, which cross the first without a junction.

CommonRoad XML 2020a: states at whole ticks, so the last state of a kamikaze is that of the tick in which the contact
was. An object's position is the middle of its shape. The planning problem is the car's: from where it begins, along its
lane.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skd_adversary.safe_trajectories.sources import read_csv_trajectory
from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line
from skd_sim.scenario.road import ONCOMING, Road, right_and_along, road_curvature, road_pose
from skd_sim.scenario.road_user import CAR, height_of
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import Mode, Outcome
from skd_sim.world.state import FloatArray

from skd_evaluator.assessment.files.assessment_json import understood
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.bags.tracks import TABLE_CAR, TABLE_OTHER
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import finish
from skd_evaluator.extensions.exchange import scene
from skd_evaluator.extensions.exchange.osi import osi_name, osi_writer, write_osi
from skd_evaluator.extensions.exchange.scene import ADVERSARY, EGO, EXPORT, ROAD_FILE, ExportedEpisode
from skd_evaluator.metrics.surrogate_scenes import EpisodeMotion, course_of
from skd_evaluator.report.formats import counted
from skd_evaluator.report.html.subjects import Subject, chosen_episodes, episode_entry, read_one
from skd_evaluator.report.html.template import filled
from skd_evaluator.report.repeat import SCENARIO_FILE, TRAJECTORY_FILE
from skd_evaluator.version import version


def number(value: float) -> str:
    """Return the shortest text that is read back as a number is, without an exponent, which decimals of XML lack."""
    return str(np.format_float_positional(float(value), trim="0"))


def _write(path: Path, template: str, **values: Any) -> None:
    path.write_text(
        filled("skd_evaluator.extensions.exchange", template, n=number, zip=zip, **values), encoding="utf-8"
    )


# --- OpenDRIVE


def write_road(path: Path, recorded: Sequence[scene.ExportedEpisode]) -> None:
    """Write the road on which some episodes of one scenario are, as long as they need it."""
    scenario = recorded[0].scenario
    road = scenario.road
    beside = sorted(number for number, lane in road.every_lane.items() if lane.beside)
    elsewhere = [number for number, lane in road.every_lane.items() if not lane.beside]
    roads = [_road(road, beside, scene.stretch(scenario, recorded))]
    roads += [_road(road, [one], scene.stretch(scenario, recorded, one)) for one in elsewhere]
    _write(path, "opendrive.xodr.j2", called=one_line(scenario.name), date=recorded[0].date, roads=roads)


def _road(road: Road, lanes: Sequence[int], span: tuple[float, float]) -> dict[str, Any]:
    """Return what is to be said of a road with lanes, from left to right, between two path coordinates, m."""
    low, high = span
    line = road.line_of(lanes[0])
    pieces = [
        (begin - low, *road_pose(line, begin), end - begin, curvature)
        for begin, end, curvature in _pieces(line, low, high)
    ]
    runs = {one: road.every_lane[one].direction != ONCOMING for one in lanes}
    left = [one for one in lanes if one < 0 and not all(runs[other] for other in lanes if one <= other < 0)]
    right = [one for one in lanes if one not in left]
    edge = road.offset(right[0]) - 0.5 * road.width(right[0])  # to the right of the reference line
    # Those on the right run along the reference line, those on the left against it.
    said = {
        one: {"id": id_, "width": road.width(one), "is_reversed": runs[one] != (id_ < 0)}
        for lanes_of_side, ids in ((left, range(len(left), 0, -1)), (right, range(-1, -1 - len(right), -1)))
        for one, id_ in zip(lanes_of_side, ids, strict=True)
    }
    sides = {"left": [said[one] for one in left], "right": [said[one] for one in right]}
    return {"length": high - low, "pieces": pieces, "offset": -edge, **sides}


def _pieces(line: FloatArray, low: float, high: float) -> list[tuple[float, float, float]]:
    """Return the stretches of a line of one curvature each: path coordinates of both ends (m), and curvature (1/m)."""
    inner = {float(s) for row in line for s in (row[0], row[0] + row[5]) if low < s < high}
    found: list[tuple[float, float, float]] = []
    for begin, end in pairwise(sorted({low, high, *inner})):
        curvature = float(road_curvature(line, 0.5 * (begin + end)))
        if found and found[-1][2] == curvature:
            begin = found.pop()[0]
        found.append((begin, end, curvature))
    return found


# --- OpenSCENARIO


def write_openscenario(path: Path, recorded: scene.ExportedEpisode) -> None:
    """Write an episode; its road is in the file `ROAD_FILE` beside it.

    A car that was left out begins as it did, and another may drive it.
    """
    car, actors = recorded.scenario.car, recorded.actors
    if recorded.ego is None:
        size, centre = (car.front + car.rear, car.width, height_of(CAR)), 0.5 * (car.front - car.rear)
        actors = (
            scene.Actor(scene.EGO, scene.EGO_ID, None, size, centre, np.zeros(1), np.array([recorded.start])),
            *actors,
        )
    moving = [one for one in actors if not one.stands]
    about = {"recorded": recorded, "road_file": scene.ROAD_FILE, "ego": scene.EGO}
    _write(path, "openscenario.xosc.j2", actors=actors, moving=moving, **about)


# --- CommonRoad

_FIRST_LANELET = 10_001
_GOAL = 20.0  # m behind the crossing line, and so long


def write_commonroad(path: Path, recorded: scene.ExportedEpisode) -> None:
    """Write an episode.

    The car's task: from where it begins, to be beyond the crossing line within the scenario's horizon.
    """
    scenario, lanes = recorded.scenario, scene.lanes_of(recorded)
    x, y, heading, speed = recorded.start
    ahead = 0.5 * (scenario.car.front - scenario.car.rear)
    along = float(right_and_along(scenario.road.line, np.array([[x, y]]))[0, 1])
    goal = dict(zip(("x", "y", "heading"), road_pose(scenario.road.line, max(_GOAL, along + _GOAL)), strict=True))

    def rows(actor: scene.Actor) -> list[list[float]]:
        ticks = np.rint(actor.times / scenario.time_step)
        found: list[list[float]] = np.column_stack([actor.centres, actor.states[:, 2:], ticks]).tolist()
        return found

    _write(
        path,
        "commonroad.xml.j2",
        recorded=recorded,
        called="".join(one for one in scenario.name.title() if one.isascii() and one.isalnum()) or "Skd",
        lanes=lanes,
        ids={lane.number: _FIRST_LANELET + index for index, lane in enumerate(lanes)},
        directions={number: lane.direction for number, lane in scenario.road.every_lane.items()},
        rows=rows,
        remainder=lambda angle: math.remainder(angle, math.tau),
        begin=(x + ahead * math.cos(heading), y + ahead * math.sin(heading), heading, speed, 0),
        goal={"length": _GOAL, "width": scenario.road.lane_width, **goal},
    )


_IDS = {EGO: TABLE_CAR, ADVERSARY: TABLE_OTHER}


class Format(NamedTuple):
    """A format.

    Attributes:
        write: writes an episode into a file.
        name: returns the name of an episode's file.
        whole_ticks: whether it knows states at whole time steps alone.
        with_road: whether the road is a file of its own, beside those of the episodes.
    """

    write: Callable[[Path, ExportedEpisode], None]
    name: Callable[[ExportedEpisode], str]
    whole_ticks: bool = False
    with_road: bool = False


def _write_csv(path: Path, recorded: ExportedEpisode) -> None:
    """Write an episode as csv: a row for each object at each time, as `skd fuse` reads two tracked objects.

    Its columns are t (s), id, x, y (m, of reference points), heading (rad) and speed (m/s).
    """
    lines = ["t,id,x,y,heading,speed"]
    for actor in recorded.actors:
        name = _IDS.get(actor.name, actor.name)
        for time, state in zip(actor.times.tolist(), actor.states.tolist(), strict=True):
            lines.append(",".join([repr(time), name, *map(repr, state)]))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


FORMATS = {
    "openscenario": Format(write_openscenario, lambda recorded: f"{recorded.stem}.xosc", with_road=True),
    "osi": Format(write_osi, osi_name, with_road=True),
    "commonroad": Format(write_commonroad, lambda recorded: f"{recorded.stem}.xml", whole_ticks=True),
    "csv": Format(_write_csv, lambda recorded: f"{recorded.stem}.csv"),
}

_UNKNOWN_DATE = "1970-01-01T00:00:00Z"


def run(arguments: argparse.Namespace) -> int:
    """Write what is requested of a result, or a trial; return the exit code."""
    kind = FORMATS[arguments.format]
    if kind.write is write_osi:
        osi_writer()  # that its libraries are there
    if trial := trial_of(arguments.path):
        if given := [name for name in ("episode", "worst", "objective") if getattr(arguments, name) is not None]:
            raise UsageError(f"--{given[0]}: {arguments.path} is one trial")
        what, going, warnings = "the trial", [trial], list[str]()
    else:
        subject = read_one([arguments.path])
        with understood(arguments.path):
            numbers = selected_episodes(subject, arguments.episode, arguments.worst, arguments.objective)
            going = exports_of(subject, numbers, whole_ticks=kind.whole_ticks, with_car=arguments.car)
        what, warnings = f"{len(going) - len(numbers)} φ and {counted(len(numbers), 'episode')}", subject.warnings
    out = result_folder(arguments)
    files = {kind.name(one): one for one in going}
    content = {
        "export": 1,
        "skd": version(),
        "result": str(arguments.path),
        "format": arguments.format,
        "road": ROAD_FILE if kind.with_road else None,
        "files": [{"file": name, **one.about} for name, one in files.items()],
    }

    def write(folder: Path) -> None:
        if kind.with_road:
            write_road(folder / ROAD_FILE, going)
        for name, one in files.items():
            kind.write(folder / name, one)
        write_json(folder / EXPORT, content)

    where = f"{what} as {arguments.format} in {out.path}; {EXPORT} says which file is which"
    return finish(arguments, content, lambda: None, warnings, saved=(out.save(write), where))


def selected_episodes(subject: Subject, episode: int | None, worst: int | None, objective: str | None) -> list[int]:
    """Return the numbers of the requested episodes; every kamikaze that was not aborted by default.

    Args:
        subject: the result.
        episode: only those with this id.
        worst: only so many, the worst for the car first, runs along φ among them.
        objective: only kamikazes of this objective.

    Raises:
        UsageError: there is none.
    """
    episodes = subject.episodes

    def fits(number: int) -> bool:
        if len(episodes.adversary[number]) < 2 or not np.isfinite(episodes.car[number]).all():
            return False
        chosen = worst is not None or episodes.mode[number] == Mode.KAMIKAZE
        return episode is not None or bool(chosen and episodes.outcome[number] != Outcome.ABORTED)

    if (episode, worst, objective) == (None, None, None):
        return list(filter(fits, range(len(episodes))))
    found = chosen_episodes(subject, episode, objective, fits)
    return sorted(found) if worst is None else found[:worst]


def exports_of(subject: Subject, numbers: Sequence[int], *, whole_ticks: bool, with_car: bool) -> list[ExportedEpisode]:
    """Return the φ of some episodes, or every φ where there is no episode, and then the episodes.

    Args:
        subject: the result.
        numbers: numbers of its episodes.
        whole_ticks: whether states are at whole ticks alone.
        with_car: whether the car, as it was recorded, is in the episodes.
    """
    stored = subject.episodes
    indices = np.unique(stored.safe_index[list(numbers)]).tolist() if numbers else range(len(stored.safe))
    found = [_phi(subject, index) for index in indices]
    return found + [_episode(subject, number, whole_ticks=whole_ticks, with_car=with_car) for number in numbers]


def _phi(subject: Subject, index: int) -> ExportedEpisode:
    """Return a φ: the adversary and the others, and where the car begins."""
    name, scenario = _name(subject, index), subject.scenario
    title = f"SKD: safe trajectory φ {index} ({name}) of {scenario.name}, {subject.label}"
    about = {"mode": Mode.SAFE.name.lower(), "phi": index, "phi_name": name}
    return _walk(scenario, subject.episodes.safe[index], f"phi_{index:03d}", title, _date(subject), about)


def trial_of(folder: Path) -> ExportedEpisode | None:
    """Return the trial that a folder of `skd compare --explain`, `skd bisect` or `skd log` holds; None: it holds none.

    Raises:
        UsageError: its scenario or its trajectory cannot be read.
    """
    if not (folder / TRAJECTORY_FILE).is_file():
        return None
    scenario = load_scenario(str(folder / SCENARIO_FILE))
    walked = read_csv_trajectory(folder / TRAJECTORY_FILE, scenario).positions
    title = f"SKD: trial {folder.resolve().name} of {scenario.name}"
    return _walk(scenario, walked, "trial", title, _UNKNOWN_DATE, {"mode": Mode.REPLAY.name.lower()})


def _walk(
    scenario: Scenario, walked: FloatArray, stem: str, title: str, date: str, about: dict[str, Any]
) -> ExportedEpisode:
    """Return a trajectory of the adversary, n × 2, m, with the others, and where the car begins."""
    times, title = scenario.time_step * np.arange(len(walked), dtype=np.float64), one_line(title)
    course = EpisodeMotion(times, walked, np.full((len(walked), 4), np.nan))
    actors, start = scene.actors_of(scenario, course, with_car=False), scene.start_of(scenario, walked)
    return ExportedEpisode(
        stem, title, scenario, actors, start, float(times[-1]), date, about={**about, "title": title}
    )


def _episode(subject: Subject, number: int, *, whole_ticks: bool, with_car: bool) -> ExportedEpisode:
    episodes, scenario = subject.episodes, subject.scenario
    hit = bool(episodes.collided[number])
    impact = () if whole_ticks else episodes.impact(number)
    course = course_of(scenario, episodes.adversary[number], episodes.car[number], *impact)
    actors, duration = scene.actors_of(scenario, course, with_car=True), float(course.times[-1])
    x, y, heading, speed = actors[0].states[0].tolist()
    entry, index = episode_entry(subject, number), int(episodes.safe_index[number])
    id_, objective, name = entry["episode_id"], entry["objective"], _name(subject, index)
    who = f"kamikaze of objective {objective}" if objective else "run along φ"
    of = f"φ {index} ({name}) of {scenario.name}, {subject.label}"
    title = one_line(f"SKD: {who}, episode {id_}, {of}: {entry['outcome']}")
    about = {
        **{"phi": index, "phi_name": name, "title": title, **entry},
        "impact_time": float(episodes.impact_time[number]) if hit else None,
        "contact": episodes.until_contact(number)[-1].tolist() if hit else None,
    }
    stem = f"kamikaze_{re.sub(r'[^A-Za-z0-9_]', '-', objective)}_{id_}" if objective else f"along_{id_}"
    start, shown = (x, y, heading, speed), actors if with_car else actors[1:]
    return ExportedEpisode(stem, title, scenario, shown, start, duration, _date(subject), whole_ticks, about)


def _name(subject: Subject, index: int) -> str:
    return str(subject.figures["per_safe_trajectory"][index]["name"])


def _date(subject: Subject) -> str:
    """Return when a result was made, so that two exports of it are the same, byte for byte."""
    said = str((subject.figures.get("provenance") or {}).get("date", ""))
    return said if re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", said) else _UNKNOWN_DATE
