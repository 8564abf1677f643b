"""`skd export`: results as files that other tools open; `skd import`: their recorded tracks as φ in the frame `map`."""

from __future__ import annotations

from pathlib import Path

from skd_evaluator.cli.arguments import Parser, frame_place, real_number, whole_number

BY_CAR = "car"
"""Value of --frame: the frame follows from how the car drives."""
_LONGEST_GAP = 0.5  # s, as `bags.tracks` has it


def add_import(parser: Parser) -> None:
    """Import trajectories from OpenSCENARIO, OSI, CommonRoad, CSV or bags.

    Import a road user's trajectory, check its rate, gaps and frame, and write it as csv that --safe reads. Files:
    OpenSCENARIO XML, ASAM OSI (MCAP), CommonRoad XML, csv (also of inD and rounD), recordings of ROS, and folders of
    such (docs/logs.md).
    """
    parser.set_defaults(group="exchange", module="skd_evaluator.extensions.exchange.imports")
    parser.add_paths("PATH", "a file, a bag's folder, or a folder of files")
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


EXPORT_FORMATS = ("openscenario", "osi", "commonroad", "csv")
"""Names of the formats: see `exports.FORMATS`."""


def add_export(parser: Parser) -> None:
    """Write kamikazes and safe trajectories as OpenSCENARIO, OSI, CommonRoad or csv.

    Write the safe trajectories φ of a result, and every kamikaze, as files that other tools open. It takes the trial of
    a comparison, a bisection or a log, too. docs/logs.md says what each format keeps.
    """
    parser.set_defaults(group="exchange", module="skd_evaluator.extensions.exchange.exports")
    parser.add_value("path", "folder of an assessment or of a trial", type=Path, metavar="RESULT")
    text = "openscenario (1.2, OpenDRIVE road), osi (ground truth as MCAP; extra exchange), commonroad (2020a), csv"
    parser.add_value("--format", text, choices=EXPORT_FORMATS, required=True)
    which = parser.add_mutually_exclusive_group()
    text = "only the episode that has this id in episodes.npz and bags, and its φ"
    which.add_value("--episode", text, type=whole_number(0), metavar="ID")
    worst = "only so many episodes, the worst for the car first, runs along φ among them, and their φ"
    which.add_count("--worst", 1, 1_000_000, worst)
    parser.add_value("--objective", "only kamikazes of this objective, and their φ", metavar="NAME")
    parser.add_flag("--no-car", "leave out how the car drove, so that another may drive in its place")
    parser.add_output()
