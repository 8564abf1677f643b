"""The commands that look around, and their options; light, for every command begins with them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skd_evaluator.cli.arguments import (
    add_car_arguments,
    add_count,
    add_graph_arguments,
    add_options,
    add_output_arguments,
    add_pictures_argument,
)

DEFAULT_FOLDER = Path("skd_results")


def add_overview_commands(commands: Any) -> None:
    """Add them to a parser's commands; each says in which module of `cli/commands` it is."""
    listed = commands.add_parser(
        "list",
        help="list the assessments under a folder",
        description="List the assessments in and under folders, cells of campaigns and sweeps included: car, margin, "
        "date, and the commit of the car's code. Figures are those that are written; a file that is not what was "
        "written is marked.",
    )
    _add_folders(listed)
    _add_car(listed)
    listed.add_argument("--scenario", metavar="TEXT", help="only those whose scenario's name holds this text")
    listed.add_argument(
        "--sort",
        choices=("date", "folder", "car", "margin", "nominal_collision_rate"),
        default="date",
        help="in which order (default: date)",
    )
    add_count(listed, "--last", 1, 1_000_000, "only so many, the last of the order")
    listed.add_argument("--json", action="store_true", help="print JSON instead of a table")
    listed.set_defaults(module="overview.list")

    trend = commands.add_parser(
        "trend",
        help="say how a car has changed from assessment to assessment",
        description="Follow a figure of each car over its assessments in and under folders, in the order of their "
        "dates: each with its interval, and whether the car is safer or less safe than in the one before, judged as "
        "skd compare does. All verdicts of a car together are right with 95 percent.",
    )
    _add_folders(trend)
    _add_car(trend)
    trend.add_argument(
        "--figure",
        choices=("margin", "deviation", "skd", "nominal_collision_rate", "risk_1"),
        default="margin",
        help="the figure that is followed (default: margin)",
    )
    add_pictures_argument(trend, "draw no picture beside trend.json")
    add_output_arguments(trend)
    trend.set_defaults(module="overview.trend")

    doctor = commands.add_parser(
        "doctor",
        help="say what is installed, what is missing, and for what",
        description="Look at what SKD needs and at what is optional, say what to do about what is missing, and send a "
        "message between two nodes of ROS 2. Nothing is installed. The exit code is 1 where something does not work.",
    )
    doctor.add_argument(
        "--no-round-trip", dest="round_trip", action="store_false", help="start no nodes: look at files alone"
    )
    doctor.add_argument("--json", action="store_true", help="print JSON instead of lines")
    doctor.set_defaults(module="overview.doctor")

    _add_drive(commands)


def _add_drive(commands: Any) -> None:
    drive = commands.add_parser(
        "drive",
        help="watch a car drive, and step in front of it with the keyboard",
        description="Watch a car drive at the pace of the wall clock, in the terminal: as seen from above, with its "
        "speed, its commands and their age. The adversary goes where your keys send it, or follows a safe trajectory "
        "φ. The options are those of skd assess, so you can see your controller or node work before you rate it. With "
        "--graph, RViz and Foxglove can show the drive, too. Nothing is rated, and only a run that fails leaves "
        "something: its logs. Without a terminal it prints one line a second and ends with the first episode.",
    )
    followed = (
        "let the adversary follow safe trajectories φ instead of the keys: synthetic, own, walkers, regulatory, or a "
        "path, as skd assess takes them (default: it goes by keys)"
    )
    add_car_arguments(drive, "drive", safe={"default": None, "help": followed})
    add_count(drive, "--safe-number", 0, 65_534, "with --safe, by which φ to begin, counted from 0 (default: 0)")
    ticks = "end each episode after at most this many ticks, mostly of 0.3 s (default: as the scenario says)"
    add_count(drive, "--ticks", 1, 100_000, ticks)
    add_options(drive, "drive", "campaign")
    rate = "how many simulated seconds pass in a second of the wall clock; 0.5 is slow motion (default: 1)"
    add_graph_arguments(drive, "drive", optional=True, record=False, rate_factor={"help": rate})
    group = drive.add_argument_group("output")
    group.add_argument("--json", action="store_true", help="print how each episode ended as JSON, and no picture")
    loudness = group.add_mutually_exclusive_group()
    loudness.add_argument("-v", "--verbose", action="store_true", help="report the source of an error")
    loudness.add_argument("-q", "--quiet", action="store_true", help="print only how each episode ended")
    drive.set_defaults(module="overview.drive")


def _add_folders(parser: Any) -> None:
    parser.add_argument(
        "paths",
        type=Path,
        nargs="*",
        default=[DEFAULT_FOLDER],
        metavar="DIR",
        help=f"folder of results, or one above some (default: {DEFAULT_FOLDER})",
    )


def _add_car(parser: Any) -> None:
    parser.add_argument("--car", metavar="TEXT", help="only cars whose name holds this text")
