"""`skd log`: the conflicts in recordings of a drive, driven again by a car under test and ranked by safety margin."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skd_evaluator.assessment.options import AssessmentOptions
from skd_evaluator.cli.arguments import CAR_GROUP, Parser, real_number, result_folder, runner_of
from skd_evaluator.cli.output import finish

if TYPE_CHECKING:
    from skd_evaluator.extensions.log.conflicts import Conflict

RESULT = "log.json"
_SHOWN = 30


def add_log(parser: Parser) -> None:
    """Find the conflicts in recordings of a drive, and rank them by safety margin.

    Find every road user in recordings whose predicted path meets the car's. Drive each such conflict again with a car
    under test, and rank them by safety margin. Without --controller the recording alone gives bounds of the margin of
    the car that drove (docs/logs.md).
    """
    parser.set_defaults(group="rate")
    parser.add_paths("PATH", "a recording of ROS, a csv of tracked objects, CITR, or a folder of them")
    car = parser.add_argument_group(CAR_GROUP)
    cars = "the car under test: basic, cal, a registered name, file.py:Class or package.module:Class (default: none)"
    car.add_options(CAR_GROUP, controller={"default": None, "help": cars})
    car.add_options(table=AssessmentOptions)
    text = "road, shapes, braking and kind of road user of each conflict (default: %(default)s)"
    car.add_value("--scenario", text, default="crossing", metavar="NAME")
    where = parser.add_argument_group("recordings")
    text = "topic, /tf:FRAME or id of the car that drove (default: the only Odometry, base_link, or car)"
    where.add_value("--car", text, metavar="NAME")
    where.add_value("--map-frame", "frame to which tf brings all objects (default: that of the car)", metavar="FRAME")
    where.add_value("--tf-topic", "topic of a bag's transforms", default="/tf", metavar="TOPIC")
    text = "how far ahead of the middle of the car its tracked point is, m"
    where.add_value("--reference", text, type=real_number(-20.0, 20.0), default=0.0, metavar="M")
    text = "do not fill longer gaps"
    where.add_value("--longest-gap", text, type=real_number(0.0, 60.0, above=True), default=0.5, metavar="S")
    which = parser.add_argument_group("conflicts")
    text = "how far ahead both are predicted, s"
    which.add_value("--within", text, type=real_number(0.5, 30.0), default=4.0, metavar="S")
    text = "earliest reaction, for the upper bound: a full brake so long after the road user leaves its path, s"
    which.add_value("--reaction", text, type=real_number(0.0, 10.0), default=0.1, metavar="S")
    which.add_count("--export", 0, 10_000, "write so many of the worst as scenarios with a campaign of them", default=0)
    parser.add_runner()
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_sim.options.car_and_adversary import CarUnderTest
    from skd_sim.scenario.scenario import load_scenario

    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.assessment.from_options import check_car
    from skd_evaluator.bags.checks import Damage
    from skd_evaluator.extensions.log.conflicts import CAMPAIGN, ConflictRequest, conflicts_in, export, with_margins
    from skd_evaluator.extensions.log.drives import DriveRequest, RecordedDrive, read_drives
    from skd_evaluator.report.formats import counted
    from skd_evaluator.report.progress import progress_bar
    from skd_evaluator.version import version

    damage, scenario = Damage(skip=True), load_scenario(arguments.scenario)
    if arguments.controller is not None:  # which may declare a control period
        scenario = check_car(vars(arguments), scenario, graph=False)
    gap, users, seconds = arguments.longest_gap, 0, 0.0
    request = ConflictRequest(scenario, arguments.within, arguments.reaction, gap, arguments.reference)
    drives = DriveRequest(arguments.car, arguments.map_frame, arguments.tf_topic, gap)
    out = result_folder(arguments)
    found: list[Conflict] = []
    left_out: list[tuple[str, str]] = []
    with runner_of(arguments, isolated=True) as runner, progress_bar(quiet=arguments.quiet) as progress:
        runner.start()
        for number, drive in enumerate(read_drives(arguments.paths, drives, damage), start=1):
            if isinstance(drive, RecordedDrive):
                users, seconds = users + len(drive.users), seconds + float(drive.car.times[-1] - drive.car.times[0])
                found += conflicts_in(drive, request)
                left_out += [(f"{drive.name}, {name}", why) for name, why in drive.left_out]
            else:
                left_out.append(drive)
            progress("recordings", number, number)
        if arguments.controller is not None and arguments.margin_limit:
            car = CarUnderTest(arguments.controller, arguments.multiplier)
            found = with_margins(found, car, arguments.margin_limit, runner, progress)
    found.sort(key=lambda one: one.rank)
    rows = [one.as_dict() for one in found]
    content = {
        "log": 1,
        "skd": version(),
        "controller": arguments.controller,
        "conflicts": rows,
        "left_out": [{"what": what, "why": why} for what, why in left_out],
        "warnings": damage.lines,
    }
    worst = [one for one in found if one.safe is not None][: arguments.export]

    def write(folder: Path) -> None:
        write_json(folder / RESULT, content)
        if worst:
            export(folder, worst, arguments.controller, arguments.multiplier)

    problem = out.save(write)

    def show() -> None:
        if seconds:
            read = f"{counted(users, 'road user')} in {seconds:.0f} s"
            _print(rows, read, arguments.controller or "no car under test")
        if not problem:
            print(f"results in {out.path}")
        if worst and not problem:
            print(f"next: skd campaign {out.path / CAMPAIGN}")

    warnings = [*damage.lines, *(f"{what}: left out: {why}" for what, why in left_out)]
    return finish(arguments, content, show, warnings, [problem, None if seconds else "no recording could be read"])


def _print(rows: Sequence[Mapping[str, Any]], read: str, car: str) -> None:
    """Print the conflicts among what was read, the worst first, and why some were not driven again."""
    from rich.markup import escape

    from skd_evaluator.extensions.log.conflicts import short_name
    from skd_evaluator.report.formats import counted
    from skd_evaluator.report.terminal import narrow_table, print_table

    again = sum(not row["why"] for row in rows)
    title = f"{counted(len(rows), 'conflict')} with {read}, of which {again} can be driven again; {car}"
    heads = ("drive", "road user", "at (s)", "car (m/s)", "margin (m)", "impact (m/s)", "recorded (m)", "bounds (m)")
    cells = []
    for row in rows[:_SHOWN]:
        speed, impact = ("" if (one := row[key]) is None else f"{one:.1f}" for key in ("speed", "impact_speed"))
        bound = "at most " if row["margin"] and not row["exact"] else ""
        margin = "" if row["margin"] is None else f"{bound}{row['margin']:.2f}"
        drive, user, why = (escape(one) for one in (row["drive"], short_name(row["user"]), row["why"]))
        recorded, bounds = f"{row['recorded']:.2f}", f"{row['least']:.2f} to {row['most']:.2f}"
        cells.append([drive, user, f"{row['nearest']:.2f}", speed, margin, impact, recorded, bounds, why])
    print_table(narrow_table(title, (*heads, "not driven again because"), cells))
    if len(rows) > _SHOWN:
        print(f"{len(rows) - _SHOWN} more in {RESULT}")
