"""The options of `skd export` and `skd import`; light, for help reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skd_evaluator.cli.arguments import add_count, add_output_arguments, frame_place, real_number, whole_number

EXPORT_FORMATS = ("openscenario", "osi", "commonroad", "csv")
"""Names of the formats that results go out in; what they are stands in `extensions/exchange/exports.py`."""
LONGEST_GAP = 0.5  # s, as `bags.tracks` has it


def add_export(commands: Any) -> None:
    """Add `skd export` to a parser's commands."""
    export = commands.add_parser(
        "export",
        help="write kamikazes and safe trajectories as OpenSCENARIO, OSI, CommonRoad or csv",
        description="Write the safe trajectories φ of a result, and every kamikaze, as files that other tools open. "
        "docs/logs.md says what each format keeps.",
    )
    export.add_argument("path", type=Path, metavar="RESULT", help="folder of an assessment")
    text = "openscenario (1.2, OpenDRIVE road), osi (ground truth as MCAP; extra exchange), commonroad (2020a), csv"
    export.add_argument("--format", choices=EXPORT_FORMATS, required=True, help=text)
    which = export.add_mutually_exclusive_group()
    text = "only the episode that has this id in episodes.npz and bags, and its φ"
    which.add_argument("--episode", type=whole_number(0), metavar="ID", help=text)
    text = "only so many episodes, the worst for the car first, runs along φ among them, and their φ"
    add_count(which, "--worst", 1, 1_000_000, text)
    export.add_argument("--objective", metavar="NAME", help="only kamikazes of this objective, and their φ")
    text = "leave out how the car drove, so that another may drive in its place"
    export.add_argument("--no-car", dest="car", action="store_false", help=text)
    add_output_arguments(export)
    export.set_defaults(module="skd_evaluator.extensions.exchange.exports")


def add_import(commands: Any) -> None:
    """Add `skd import` to a parser's commands."""
    taken = commands.add_parser(
        "import",
        help="import trajectories from OpenSCENARIO, OSI, CommonRoad, CSV or bags",
        description="Import a road user's trajectory, check its rate, gaps and frame, and write it as csv that --safe "
        "reads. Files: OpenSCENARIO XML, ASAM OSI (MCAP), CommonRoad XML, csv (also of inD and rounD), "
        "recordings of ROS, and folders of such (docs/logs.md).",
    )
    text = "a file, a bag's folder, or a folder of files"
    taken.add_argument("paths", type=Path, nargs="+", metavar="PATH", help=text)
    who = taken.add_argument_group("who")
    text = "whose trajectory: name, id, topic, /tf:FRAME or TOPIC:ID (default: the adversary, else the only one)"
    who.add_argument("--road-user", metavar="NAME", help=text)
    text = "the kind of road user in inD and rounD (default: pedestrian)"
    who.add_argument("--kind", default="pedestrian", metavar="KIND", help=text)
    text = "which object is the car, for --frame car; named as --road-user"
    who.add_argument("--car", metavar="NAME", help=text)
    where = taken.add_argument_group("where")
    text = (
        "origin (m) and direction of the scenario's frame map in the file. With car it follows from how the car drives"
    )
    where.add_argument(
        "--frame", type=_place, default=(0.0, 0.0, 0.0), metavar="X,Y,DEGREES|car", help=f"{text} (default: 0,0,0)"
    )
    text = "frame of a bag to which /tf and /tf_static bring all objects"
    where.add_argument("--map-frame", metavar="FRAME", help=text)
    text = "topic of a bag's transforms, as /car1/tf; those that are fixed are on TOPIC_static (default: /tf)"
    where.add_argument("--tf-topic", default="/tf", metavar="TOPIC", help=text)
    text = "also check each trajectory for this scenario, cut it to the horizon, and leave out what cannot be used"
    where.add_argument("--scenario", metavar="NAME", help=text)
    text, gap = "leave out tracks with a longer gap, in transforms as well (default: %(default)s)", LONGEST_GAP
    where.add_argument("--longest-gap", type=real_number(0.0, 60.0, above=True), default=gap, metavar="S", help=text)
    which = taken.add_argument_group("what of a file")
    text = "only say what the files hold: who, in which form, rate, gaps, times, frame"
    which.add_argument("--list", action="store_true", help=text)
    text = "with --list: only these topics of bags"
    which.add_argument("--topics", nargs="+", default=(), metavar="TOPIC", help=text)
    for option, name, what in (("--from", "begin", "before"), ("--to", "end", "after")):
        text = f"nothing {what} this time on the file's clock, s, as --list says it"
        which.add_argument(option, dest=name, type=real_number(-1e12, 1e12), metavar="S", help=text)
    add_output_arguments(taken)
    taken.set_defaults(module="skd_evaluator.extensions.exchange.imports")


def _place(text: str) -> tuple[float, float, float] | str:
    """Parse X,Y,DEGREES, or the word for the frame that goes by the car."""
    return text if text == BY_CAR else frame_place(text)


BY_CAR = "car"
"""Value of --frame: the frame follows from the car's way."""
