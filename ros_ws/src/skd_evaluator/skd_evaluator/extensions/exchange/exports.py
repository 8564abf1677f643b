"""`skd export`: which episodes and φ of a result are written, in which format, and what each format does not keep."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from skd_sim.arrays import IntArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line
from skd_sim.world.episode import Mode, Outcome

from skd_evaluator.assessment.files.assessment_json import understood
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.bags.tracks import TABLE_CAR, TABLE_OTHER
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import finish
from skd_evaluator.extensions.exchange.osi import osi_name, osi_writer, write_osi
from skd_evaluator.extensions.exchange.scene import (
    ADVERSARY,
    EGO,
    EXPORT,
    ROAD_FILE,
    ExportedEpisode,
    actors_of,
    start_of,
)
from skd_evaluator.extensions.exchange.xml_formats import write_commonroad, write_openscenario, write_road
from skd_evaluator.metrics.surrogate_scenes import EpisodeMotion, course_of
from skd_evaluator.report.formats import counted
from skd_evaluator.report.html.subjects import Subject, read_subjects
from skd_evaluator.version import version

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


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    kind = FORMATS[arguments.format]
    if kind.write is write_osi:
        osi_writer()  # that its libraries are there
    subjects = read_subjects([arguments.path])
    if len(subjects) > 1:
        raise UsageError(
            f"{arguments.path}: holds {len(subjects)} assessments; give the folder of one, as {subjects[0].folder}"
        )
    with understood(arguments.path):
        return _export(subjects[0], kind, arguments)


def _export(subject: Subject, kind: Format, arguments: argparse.Namespace) -> int:
    numbers = selected_episodes(subject, arguments.episode, arguments.worst, arguments.objective)
    out = result_folder(arguments)
    going = exports_of(subject, numbers, whole_ticks=kind.whole_ticks, with_car=arguments.car)
    content: dict[str, Any] = {
        "export": 1,
        "skd": version(),
        "result": str(arguments.path),
        "format": arguments.format,
        "road": ROAD_FILE if kind.with_road else None,
        "files": [{"file": kind.name(one.recorded), **one.entry} for one in going],
    }

    def write(folder: Path) -> None:
        if kind.with_road:
            write_road(folder / ROAD_FILE, [one.recorded for one in going])
        for one in going:
            kind.write(folder / kind.name(one.recorded), one.recorded)
        write_json(folder / EXPORT, content)

    def show() -> None:
        if not problem:
            episodes = sum("episode_id" in one.entry for one in going)
            said = f"{len(going) - episodes} φ and {counted(episodes, 'episode')} as {arguments.format} in {out.path}"
            print(f"{said}; {EXPORT} says which file is which")

    problem = out.save(write)
    return finish(arguments, content, show, subject.warnings, [problem])


_UNKNOWN_DATE = "1970-01-01T00:00:00Z"


class Export(NamedTuple):
    """Something that goes out.

    Attributes:
        recorded: what is written.
        entry: what export.json says of it.
    """

    recorded: ExportedEpisode
    entry: dict[str, Any]


def selected_episodes(subject: Subject, episode: int | None, worst: int | None, objective: str | None) -> list[int]:
    """Return the numbers of the episodes that are asked for; every kamikaze that was not aborted by default.

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
        is_of = objective is None or str(episodes.objective[number]) == objective
        return is_of and len(episodes.adversary[number]) > 1 and bool(np.isfinite(episodes.car[number]).all())

    lasting = list(filter(fits, range(len(episodes))))
    if episode is not None:
        found = [number for number in lasting if int(episodes.episode_id[number]) == episode]
        if not found:
            none = "holds no such episode; the report has the id of each"
            raise UsageError(f"--episode {episode}: {subject.folder} {none}")
        return found
    fine = {number for number in lasting if episodes.outcome[number] != Outcome.ABORTED}
    if worst is not None:
        found = [number for number in episodes.worst_first().tolist() if number in fine][:worst]
    else:
        found = [number for number in sorted(fine) if episodes.mode[number] == Mode.KAMIKAZE]
    if not found and (worst is not None or objective is not None):
        raise UsageError(f"{subject.folder}: holds no episode of that kind: every one was aborted, or none was run")
    return found


def exports_of(subject: Subject, numbers: Sequence[int], *, whole_ticks: bool, with_car: bool) -> list[Export]:
    """Return the φ of some episodes, or every φ where there is no episode, and then the episodes.

    Args:
        subject: the result.
        numbers: numbers of its episodes.
        whole_ticks: whether states are at whole ticks alone.
        with_car: whether the car, as it was recorded, is in the episodes.
    """
    every = range(len(subject.episodes.safe))
    indices: IntArray = np.unique(subject.episodes.safe_index[list(numbers)]) if len(numbers) else np.array(every)
    found = [_phi(subject, int(index)) for index in indices]
    return found + [_episode(subject, number, whole_ticks=whole_ticks, with_car=with_car) for number in numbers]


def _phi(subject: Subject, index: int) -> Export:
    """Return a φ: the adversary and the others, and where the car begins."""
    phi, step = subject.episodes.safe[index], subject.episodes.time_step
    course = EpisodeMotion(step * np.arange(len(phi), dtype=np.float64), phi, np.full((len(phi), 4), np.nan))
    name, scenario = _name(subject, index), subject.scenario
    title = one_line(f"SKD: safe trajectory φ {index} ({name}) of {scenario.name}, {subject.label}")
    actors, duration = actors_of(scenario, course, with_car=False), float(course.times[-1])
    start, date = start_of(scenario, phi), _date(subject)
    recorded = ExportedEpisode(f"phi_{index:03d}", title, scenario, actors, start, duration, date)
    return Export(recorded, {"mode": Mode.SAFE.name.lower(), "phi": index, "phi_name": name, "title": title})


def _episode(subject: Subject, number: int, *, whole_ticks: bool, with_car: bool) -> Export:
    episodes, scenario = subject.episodes, subject.scenario
    hit = bool(episodes.collided[number])
    contact = None if whole_ticks else episodes.contact(number)
    course = course_of(scenario, episodes.adversary[number], episodes.car[number], contact)
    scene = actors_of(scenario, course, with_car=True)
    x, y, heading, speed = scene[0].states[0].tolist()
    index, id_, objective = (one[number] for one in (episodes.safe_index, episodes.episode_id, episodes.objective))
    who, outcome = f"kamikaze of objective {objective}" if objective else "run along φ", episodes.outcome[number]
    entry = {
        "mode": Mode(int(episodes.mode[number])).name.lower(),
        "phi": int(index),
        "phi_name": _name(subject, int(index)),
        "title": "",
        "episode_id": int(id_),
        "objective": str(objective),
        "outcome": Outcome(int(outcome)).name.lower(),
        "impact_time": float(episodes.impact_time[number]) if hit else None,
        "impact_speed": float(episodes.impact_speed[number]) if hit else None,
        "contact": episodes.until_contact(number)[-1].tolist() if hit else None,
        "deviation": float(episodes.deviation[number]) if hit else None,
    }
    of = f"φ {index} ({entry['phi_name']}) of {scenario.name}, {subject.label}"
    title = entry["title"] = one_line(f"SKD: {who}, episode {id_}, {of}: {entry['outcome']}")
    stem = f"kamikaze_{re.sub(r'[^A-Za-z0-9_]', '-', str(objective))}_{id_}" if objective else f"along_{id_}"
    actors, duration = scene if with_car else scene[1:], float(course.times[-1])
    start, date = (x, y, heading, speed), _date(subject)
    return Export(ExportedEpisode(stem, title, scenario, actors, start, duration, date, whole_ticks), entry)


def _name(subject: Subject, index: int) -> str:
    return str(subject.figures["per_safe_trajectory"][index]["name"])


def _date(subject: Subject) -> str:
    """Return when a result was made, so that two exports of it are the same, byte for byte."""
    said = str((subject.figures.get("provenance") or {}).get("date", ""))
    return said if re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", said) else _UNKNOWN_DATE
