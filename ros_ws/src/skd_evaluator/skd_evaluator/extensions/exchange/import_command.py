"""`skd import`: recorded tracks from files of other tools, as safe trajectories in the frame `map`."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from skd_sim.errors import UsageError

from skd_evaluator.cli.arguments import Parser, frame_place, real_number, result_folder
from skd_evaluator.cli.output import finish, warn

if TYPE_CHECKING:
    from skd_sim.scenario.scenario import Scenario

    from skd_evaluator.bags.checks import Damage
    from skd_evaluator.bags.tracks import RecordingFrame
    from skd_evaluator.extensions.exchange.imports import ImportedTrajectory
    from skd_evaluator.extensions.exchange.readers import ImportRequest

BY_CAR = "car"
"""Value of --frame: the frame follows from how the car drives."""
SAFE = "safe"
"""Folder of the trajectories, in that of the result."""
_SHOWN = 20
_LONGEST_GAP = 0.5  # s, as `bags.tracks` has it


def add_import(parser: Parser) -> None:
    """Import trajectories from OpenSCENARIO, OSI, CommonRoad, CSV or bags.

    Import a road user's trajectory, check its rate, gaps and frame, and write it as csv that --safe reads. Files:
    OpenSCENARIO XML, ASAM OSI (MCAP), CommonRoad XML, csv (also of inD and rounD), recordings of ROS, and folders of
    such (docs/logs.md).
    """
    parser.set_defaults(group="exchange")
    parser.add_paths("paths", "PATH", "a file, a bag's folder, or a folder of files")
    who = parser.add_argument_group("which road user")
    text = "whose trajectory: name, id, topic, /tf:FRAME or TOPIC:ID (default: the adversary, else the only one)"
    who.add_value("--road-user", text, metavar="NAME")
    who.add_value("--kind", "the kind of road user in inD and rounD", default="pedestrian", metavar="KIND")
    who.add_value("--car", "which object is the car, for --frame car; named as --road-user", metavar="NAME")
    where = parser.add_argument_group("frames and gaps")
    text = (
        "origin (m) and direction of the scenario's frame map in the file. With car it follows from how the car drives "
        "(default: 0,0,0)"
    )
    where.add_value("--frame", text, type=_place, default=(0.0, 0.0, 0.0), metavar="X,Y,DEGREES|car")
    text = "frame of a bag to which /tf and /tf_static bring all objects"
    where.add_value("--map-frame", text, metavar="FRAME")
    text = "topic of a bag's transforms, as /car1/tf; those that are fixed are on TOPIC_static"
    where.add_value("--tf-topic", text, default="/tf", metavar="TOPIC")
    text = "also check each trajectory for this scenario, cut it to the horizon, and leave out what cannot be used"
    where.add_value("--scenario", text, metavar="NAME")
    text = "leave out tracks with a longer gap, in transforms as well"
    where.add_value("--longest-gap", text, type=real_number(0.0, 60.0, above=True), default=_LONGEST_GAP, metavar="S")
    which = parser.add_argument_group("which part of a file")
    text = "only say what the files hold: who, in which form, rate, gaps, times, frame"
    which.add_flag("--list", text)
    which.add_value("--topics", "with --list: only these topics of bags", nargs="+", default=(), metavar="TOPIC")
    for flag, name, what in (("--from", "begin", "before"), ("--to", "end", "after")):
        text = f"nothing {what} this time on the file's clock, s, as --list says it"
        which.add_value(flag, text, dest=name, type=real_number(-1e12, 1e12), metavar="S")
    parser.add_output()


def _place(text: str) -> tuple[float, float, float] | str:
    """Parse X,Y,DEGREES, or the word for the frame that goes by the car."""
    return text if text == BY_CAR else frame_place(text)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_sim.scenario.road_user import ROAD_USERS
    from skd_sim.scenario.scenario import load_scenario

    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.bags.checks import Damage
    from skd_evaluator.bags.tracks import RecordingFrame
    from skd_evaluator.extensions.exchange.readers import ImportRequest
    from skd_evaluator.extensions.exchange.scene import IMPORT
    from skd_evaluator.version import version

    ROAD_USERS.target(arguments.kind)  # that there is such a kind
    damage = Damage(skip=True)
    if arguments.list:
        return _list(arguments, damage)
    scenario = None if arguments.scenario is None else load_scenario(arguments.scenario)
    frame = None
    if arguments.frame != BY_CAR:
        x, y, degrees = arguments.frame
        frame = RecordingFrame(x, y, math.radians(degrees))
    same = ("road_user", "car", "kind", "map_frame", "longest_gap", "begin", "end")
    given = {name: getattr(arguments, name) for name in same}
    out = result_folder(arguments)
    request = ImportRequest(needs_car=frame is None, tf=arguments.tf_topic, **given)
    found, left_out = _imported(arguments.paths, request, frame, scenario, damage)
    if not found:
        path, name, why = left_out[0]
        more = f" (and {len(left_out) - 1} more are left out)" if len(left_out) > 1 else ""
        raise UsageError(f"{path}, {name}: {why}{more}: nothing is left")
    named = dict(zip(_file_names(found), found, strict=True))
    content = {
        "import": 1,
        "skd": version(),
        "scenario": arguments.scenario,
        "files": [one.entry(f"{SAFE}/{name}") for name, one in named.items()],
        "left_out": [{"source": str(path), "road_user": name, "why": why} for path, name, why in left_out],
        "warnings": damage.lines,
    }

    def write(folder: Path) -> None:
        (folder / SAFE).mkdir()
        for name, one in named.items():
            one.write(folder / SAFE / name)
        write_json(folder / IMPORT, content)

    problem = out.save(write)

    def show() -> None:
        warn("import", damage.lines)
        for name, one in list(named.items())[:_SHOWN]:
            print(f"{name}: {one.source.format}, {one.track.name}: {one.text}")
        warn("import", [f"{path}, {who}, left out: {why}" for path, who, why in left_out[:_SHOWN]])
        if max(len(found), len(left_out)) > _SHOWN:
            print(f"{len(found)} imported, {len(left_out)} left out; {IMPORT} has all of them")
        if not problem:
            behind = f" --scenario {arguments.scenario}" if arguments.scenario else ""
            print(f"next: skd assess --safe {out.path / SAFE} --safe-count {len(found)}{behind}")

    return finish(arguments, content, show, failures=[problem])


def _list(arguments: argparse.Namespace, damage: Damage) -> int:
    """Say what files hold; return the exit code."""
    from rich.markup import escape

    from skd_evaluator.extensions.exchange.readers import files_in, listing
    from skd_evaluator.report.terminal import narrow_table, print_table

    held = {}
    for files in files_in(arguments.paths, damage)[0]:
        name = str(files[0] if len(files) == 1 else files[0].parent)
        held[name] = [one.as_dict() for one in listing(files, damage, arguments.topics)]

    def show() -> None:
        for path, every in held.items():
            rows = []
            for one in every:
                rate, gaps = "", ""
                if one["rate"] is not None:
                    rate, gaps = f"{one['rate']:.3g}", f"{one['gaps']} (step ≤ {one['longest_step']:.2f} s)"
                ends = ("" if one[key] is None else f"{one[key]:.2f}" for key in ("begins", "ends"))
                name, form, frame, why = (escape(one[key]) for key in ("name", "form", "frame", "why"))
                rows.append([name, form, str(one["count"]), rate, gaps, *ends, frame, why])
            heads = ("who", "form", "positions", "a second", "gaps", "from", "to", "frame", "not read because")
            print_table(narrow_table(path, heads, rows))
        warn("import", damage.lines)

    return finish(arguments, {"files": held, "warnings": damage.lines}, show)


def _imported(
    paths: Sequence[Path],
    request: ImportRequest,
    frame: RecordingFrame | None,
    scenario: Scenario | None,
    damage: Damage,
) -> tuple[list[ImportedTrajectory], list[tuple[Path, str, str]]]:
    """Return the trajectories that can be used, and of the others file, name and why they cannot."""
    import numpy as np
    from skd_adversary.safe_trajectories.recordings import duplicate_of, repeated

    from skd_evaluator.extensions.exchange.imports import UnusableError, at_ticks, trajectory_of
    from skd_evaluator.extensions.exchange.readers import files_in, read_sources

    found: list[ImportedTrajectory] = []
    compared = []
    files, exported = files_in(paths, damage)
    kamikaze = "a kamikaze or a run along φ, which is no safe trajectory"
    left_out = [(path, "its adversary", kamikaze) for path in exported]
    for source in (source for one in files for source in read_sources(one, request, damage)):
        try:
            one = trajectory_of(source, frame, request.longest_gap, scenario)
            compared.append(np.column_stack([one.places, one.times]) if scenario is None else at_ticks(one, scenario))
        except UnusableError as error:
            left_out.append((source.path, source.found.name, str(error)))
            continue
        found.append(one)
        for note in one.track.notes:
            damage.warn(f"{one.track.where}: {note}")
    again = dict(repeated(compared, moved=False))  # drawn ones may be the same; --safe refuses them
    for index, first in again.items():
        source = found[index].source
        left_out.append((source.path, source.found.name, duplicate_of(str(found[first].source.path))))
    return [one for index, one in enumerate(found) if index not in again], left_out


def _file_names(found: Sequence[ImportedTrajectory]) -> list[str]:
    """Return a name of each trajectory's file, no two alike, none that leads elsewhere."""
    names: dict[str, None] = {}
    for one in found:
        stem = re.sub(r"[^\w.-]", "_", one.source.stem, flags=re.ASCII).lstrip(".")[:100] or "track"
        name, number = stem, 1
        while f"{name}.csv" in names:
            number += 1
            name = f"{stem}_{number}"
        names[f"{name}.csv"] = None
    return list(names)
