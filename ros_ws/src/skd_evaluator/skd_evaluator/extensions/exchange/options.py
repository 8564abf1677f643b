"""The options of `skd export` and `skd import`; light, for help reads them."""

from __future__ import annotations

from pathlib import Path

from skd_evaluator.cli.arguments import (
    add_count,
    add_flag,
    add_output_arguments,
    add_paths,
    add_value,
    frame_place,
    real_number,
    whole_number,
)
from skd_evaluator.cli.parser import Parser

EXPORT_FORMATS = ("openscenario", "osi", "commonroad", "csv")
"""Names of the formats that results go out in; what they are stands in `extensions/exchange/exports.py`."""
LONGEST_GAP = 0.5  # s, as `bags.tracks` has it
BY_CAR = "car"
"""Value of --frame: the frame follows from the car's way."""


def add_export(parser: Parser) -> None:
    """Write kamikazes and safe trajectories as OpenSCENARIO, OSI, CommonRoad or csv.

    Write the safe trajectories φ of a result, and every kamikaze, as files that other tools open. docs/logs.md says
    what each format keeps.
    """
    parser.set_defaults(group="exchange", module="skd_evaluator.extensions.exchange.exports")
    add_value(parser, "path", "folder of an assessment", type=Path, metavar="RESULT")
    text = "openscenario (1.2, OpenDRIVE road), osi (ground truth as MCAP; extra exchange), commonroad (2020a), csv"
    add_value(parser, "--format", text, choices=EXPORT_FORMATS, required=True)
    which = parser.add_mutually_exclusive_group()
    text = "only the episode that has this id in episodes.npz and bags, and its φ"
    add_value(which, "--episode", text, type=whole_number(0), metavar="ID")
    worst = "only so many episodes, the worst for the car first, runs along φ among them, and their φ"
    add_count(which, "--worst", 1, 1_000_000, worst)
    add_value(parser, "--objective", "only kamikazes of this objective, and their φ", metavar="NAME")
    add_flag(parser, "--no-car", "leave out how the car drove, so that another may drive in its place")
    add_output_arguments(parser)


def add_import(parser: Parser) -> None:
    """Import trajectories from OpenSCENARIO, OSI, CommonRoad, CSV or bags.

    Import a road user's trajectory, check its rate, gaps and frame, and write it as csv that --safe reads. Files:
    OpenSCENARIO XML, ASAM OSI (MCAP), CommonRoad XML, csv (also of inD and rounD), recordings of ROS, and folders of
    such (docs/logs.md).
    """
    parser.set_defaults(group="exchange", module="skd_evaluator.extensions.exchange.imports")
    add_paths(parser, "paths", "PATH", "a file, a bag's folder, or a folder of files")
    who = parser.add_argument_group("who")
    text = "whose trajectory: name, id, topic, /tf:FRAME or TOPIC:ID (default: the adversary, else the only one)"
    add_value(who, "--road-user", text, metavar="NAME")
    add_value(who, "--kind", "the kind of road user in inD and rounD", default="pedestrian", metavar="KIND")
    add_value(who, "--car", "which object is the car, for --frame car; named as --road-user", metavar="NAME")
    where = parser.add_argument_group("where")
    text = (
        "origin (m) and direction of the scenario's frame map in the file. With car it follows from how the car drives "
        "(default: 0,0,0)"
    )
    add_value(where, "--frame", text, type=_place, default=(0.0, 0.0, 0.0), metavar="X,Y,DEGREES|car")
    text = "frame of a bag to which /tf and /tf_static bring all objects"
    add_value(where, "--map-frame", text, metavar="FRAME")
    text = "topic of a bag's transforms, as /car1/tf; those that are fixed are on TOPIC_static"
    add_value(where, "--tf-topic", text, default="/tf", metavar="TOPIC")
    text = "also check each trajectory for this scenario, cut it to the horizon, and leave out what cannot be used"
    add_value(where, "--scenario", text, metavar="NAME")
    text = "leave out tracks with a longer gap, in transforms as well"
    add_value(where, "--longest-gap", text, type=real_number(0.0, 60.0, above=True), default=LONGEST_GAP, metavar="S")
    which = parser.add_argument_group("what of a file")
    text = "only say what the files hold: who, in which form, rate, gaps, times, frame"
    add_flag(which, "--list", text)
    add_value(which, "--topics", "with --list: only these topics of bags", nargs="+", default=(), metavar="TOPIC")
    for flag, name, what in (("--from", "begin", "before"), ("--to", "end", "after")):
        text = f"nothing {what} this time on the file's clock, s, as --list says it"
        add_value(which, flag, text, dest=name, type=real_number(-1e12, 1e12), metavar="S")
    add_output_arguments(parser)


def _place(text: str) -> tuple[float, float, float] | str:
    """Parse X,Y,DEGREES, or the word for the frame that goes by the car."""
    return text if text == BY_CAR else frame_place(text)
