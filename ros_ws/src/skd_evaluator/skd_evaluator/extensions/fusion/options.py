"""The options of `skd fuse`; light, for help reads them."""

from __future__ import annotations

from pathlib import Path

from skd_evaluator.cli.arguments import (
    add_count,
    add_output_arguments,
    add_value,
    add_workers_argument,
    frame_place,
    positive_number,
    real_number,
)
from skd_evaluator.cli.parser import Parser

CALIBRATED = ("delay", "deceleration", "friction", "sensor_range")
"""Names of the simulator's parameters; what they are stands in `fusion/calibration.py`."""
FUSED = ("clearance", "required_deceleration", "hit", "margin")
"""Names of the figures that are fused; what they are stands in `fusion/trial.py`."""


def add_fuse(parser: Parser) -> None:
    """Few trials on a proving ground and many simulated ones: rate the physical car, calibrate the simulator.

    Estimate clearance, required deceleration, nominal collision rate and margin of the physical car over all safe
    trajectories φ. Where simulated trials predict physical ones of the same φ, simulations of further φ make the
    intervals narrower. Else the physical trials stand alone (docs/proving_ground.md).
    """
    parser.set_defaults(group="research", module="skd_evaluator.extensions.fusion.fuse_command")
    text = "folder of an assessment, or a table of simulated trials. With --width also an earlier fusion"
    add_value(parser, "simulated", text, type=Path, metavar="SIMULATED")
    text = "table of physical trials, or the folder of its trials.csv (docs/proving_ground.md has the columns)"
    add_value(parser, "physical", text, type=Path, nargs="?", metavar="PHYSICAL")
    text = "how often you look at the results, at most: the intervals then hold at all looks together"
    add_count(parser, "--looks", 1, 100, text, default=1)  # `metrics.statistics.sequential.MOST_LOOKS`
    planning = parser.add_argument_group("planning")
    text = "without PHYSICAL: say how many trials it takes until the 95 %% interval is so wide, in the figure's unit"
    add_value(planning, "--width", text, type=positive_number, metavar="W")
    add_value(planning, "--figure", "the figure that is planned for", choices=FUSED, default="margin")
    text = "how well the simulator is expected to predict from φ to φ (default: as an earlier fusion found)"
    add_value(planning, "--correlation", text, type=real_number(0.0, 0.999), metavar="R")
    read = parser.add_argument_group("recordings")
    text = "the car in bags: topic, /tf:FRAME or TOPIC:ID, or its id in tables (default: /ego/odometry, car)"
    add_value(read, "--car", text, metavar="NAME")
    text = "the road user, named as --car (default: /adversary/odometry, other)"
    add_value(read, "--road-user", text, metavar="NAME")
    text = "origin (m) and direction of the scenario's frame map in that of the recordings (default: 0,0,0)"
    add_value(read, "--frame", text, type=frame_place, default=(0.0, 0.0, 0.0), metavar="X,Y,DEGREES")
    text = "how far ahead of the car's reference point in the scenario its tracked point is, m"
    add_value(read, "--reference", text, type=real_number(-20.0, 20.0), default=0.0, metavar="M")
    text = "how far the tracked road user may be off its φ; a trial beyond is refused"
    add_value(read, "--path-tolerance", text, type=real_number(0.0, 5.0, above=True), default=0.5, metavar="M")
    text = "greatest difference of the car's start in a physical and a simulated trial of one timing"
    add_value(read, "--gap-tolerance", text, type=real_number(0.0, 20.0, above=True), default=0.5, metavar="M")
    calibration = parser.add_argument_group("calibration")
    text = "estimate delay and deceleration of the brake, friction and sensor range of the simulator instead"
    module = "skd_evaluator.extensions.fusion.calibrate_command"
    calibration.add_argument("--calibrate", dest="module", action="store_const", const=module, help=text)
    text = f"what may be calibrated: {', '.join(CALIBRATED)} (default: all of which the trials say something)"
    add_value(calibration, "--parameters", text, nargs="+", choices=CALIBRATED, metavar="NAME")
    add_workers_argument(calibration)
    add_output_arguments(parser)
