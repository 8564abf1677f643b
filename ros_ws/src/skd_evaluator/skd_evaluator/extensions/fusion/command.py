"""`skd fuse`: what the physical car does by few physical and many simulated trials; how many it takes; calibration."""

from __future__ import annotations

import argparse
from pathlib import Path

from skd_sim.errors import UsageError

from skd_evaluator.cli.arguments import Parser, frame_place, positive_number, real_number

CALIBRATED = ("delay", "deceleration", "friction", "sensor_range")
"""Names of the simulator's parameters: see `calibration.PARAMETERS`."""
FUSED = ("clearance", "required_deceleration", "hit", "margin")
"""Names of the figures that are fused: see `trials.FIGURES`."""


def add_fuse(parser: Parser) -> None:
    """Few trials on a proving ground and many simulated ones: rate the physical car, calibrate the simulator.

    Estimate clearance, required deceleration, nominal collision rate and margin of the physical car over all safe
    trajectories φ. Where simulated trials predict physical ones of the same φ, simulations of further φ make the
    intervals narrower. Else the physical trials stand alone (docs/proving_ground.md).
    """
    parser.set_defaults(group="research", rare=True)
    text = "folder of an assessment, or a table of simulated trials. With --width also an earlier fusion"
    parser.add_value("simulated", text, type=Path, metavar="SIMULATED")
    text = "table of physical trials, or the folder of its trials.csv (docs/proving_ground.md has the columns)"
    parser.add_value("physical", text, type=Path, nargs="?", metavar="PHYSICAL")
    text = "how often you look at the results, at most: the intervals then hold at all looks together"
    parser.add_count("--looks", 1, 100, text, default=1)  # `metrics.sample_size.MOST_LOOKS`
    planning = parser.add_argument_group("planning")
    text = "without PHYSICAL: say how many trials it takes until the 95 %% interval is so wide, in the figure's unit"
    planning.add_value("--width", text, type=positive_number, metavar="W")
    planning.add_value("--figure", "the figure that is planned for", choices=FUSED, default="margin")
    text = "how well the simulator is expected to predict from φ to φ (default: as an earlier fusion found)"
    planning.add_value("--correlation", text, type=real_number(0.0, 0.999), metavar="R")
    read = parser.add_argument_group("recordings")
    text = "the car in bags: topic, /tf:FRAME or TOPIC:ID, or its id in tables (default: /ego/odometry, car)"
    read.add_value("--car", text, metavar="NAME")
    text = "the road user, named as --car (default: /adversary/odometry, other)"
    read.add_value("--road-user", text, metavar="NAME")
    text = "origin (m) and direction of the scenario's frame map in that of the recordings (default: 0,0,0)"
    read.add_value("--frame", text, type=frame_place, default=(0.0, 0.0, 0.0), metavar="X,Y,DEGREES")
    text = "how far ahead of the car's reference point in the scenario its tracked point is, m"
    read.add_value("--reference", text, type=real_number(-20.0, 20.0), default=0.0, metavar="M")
    text = "how far the tracked road user may be off its φ; a trial beyond is refused"
    read.add_value("--path-tolerance", text, type=real_number(0.0, 5.0, above=True), default=0.5, metavar="M")
    text = "greatest difference of the car's start in a physical and a simulated trial of one timing"
    read.add_value("--gap-tolerance", text, type=real_number(0.0, 20.0, above=True), default=0.5, metavar="M")
    calibration = parser.add_argument_group("calibration")
    text = "estimate delay and deceleration of the brake, friction and sensor range of the simulator instead"
    calibration.add_flag("--calibrate", text)
    text = f"what may be calibrated: {', '.join(CALIBRATED)} (default: all of which the trials say something)"
    calibration.add_value("--parameters", text, nargs="+", choices=CALIBRATED, metavar="NAME")
    calibration.add_workers()
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_evaluator.extensions.fusion import fusion

    if arguments.calibrate and arguments.physical is None:
        raise UsageError("--calibrate needs PHYSICAL, the table of physical trials")
    if (arguments.physical is None) == (arguments.width is None):
        raise UsageError("give PHYSICAL, the table of trials, or --width, to plan how many there are to be")
    if arguments.width is not None:
        return fusion.plan_trials(arguments)
    return fusion.calibrate(arguments) if arguments.calibrate else fusion.rate_car(arguments)
