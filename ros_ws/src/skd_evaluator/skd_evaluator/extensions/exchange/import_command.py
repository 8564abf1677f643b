"""`skd import`: recorded tracks from files of other tools, as safe trajectories in the frame `map`."""

from __future__ import annotations

from skd_evaluator.cli.arguments import Parser, frame_place, real_number

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
