"""The options of `skd fuse` and `skd calibrate`; light, for help reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skd_evaluator.cli.arguments import (
    add_count,
    add_output_arguments,
    add_workers_argument,
    frame_place,
    positive_number,
    real_number,
)

CALIBRATED = ("delay", "deceleration", "friction", "sensor_range")
"""Names of the simulator's parameters; what they are stands in `fusion/calibration.py`."""
FUSED = ("clearance", "required_deceleration", "hit", "margin")
"""Names of the figures that are fused; what they are stands in `fusion/trial.py`."""


def add_fuse(commands: Any) -> None:
    """Add `skd fuse` to a parser's commands."""
    fuse = commands.add_parser(
        "fuse",
        help="estimate what the physical car does, from few trials on a proving ground and many simulated ones",
        description="Estimate clearance, required deceleration, nominal collision rate and margin of the physical car "
        "over all safe trajectories φ. Physical trials are paired with simulated ones of the same φ and timing; where "
        "the simulator predicts them, simulations of further φ make the interval narrower (docs/fusion.md). Where it "
        "does not, the physical trials stand alone.",
    )
    fuse.add_argument(
        "simulated",
        type=Path,
        metavar="SIMULATED",
        help="folder of an assessment, or a table of simulated trials; with --width also an earlier fusion",
    )
    fuse.add_argument(
        "physical",
        type=Path,
        nargs="?",
        metavar="PHYSICAL",
        help="table of physical trials, or the folder with its trials.csv: columns phi and file (a bag or a table of "
        "the two tracked objects), or phi and figures (clearance, required_deceleration, hit, margin); gap says how "
        "far the car was before the crossing line when φ began, m",
    )
    add_count(
        fuse,
        "--looks",
        1,
        100,  # `metrics.statistics.sequential.MOST_LOOKS`
        "how often you look at the results, at most, before you stop, said before the first trial: each look after as "
        "many further trials. The intervals then hold at all looks together",
        default=1,
    )
    planning = fuse.add_argument_group("planning")
    planning.add_argument(
        "--width",
        type=positive_number,
        metavar="W",
        help="without PHYSICAL: say how many trials it takes until the 95 %% interval is so wide, in the figure's unit",
    )
    planning.add_argument(
        "--figure",
        choices=FUSED,
        default="margin",
        help="the figure that is planned for (default: margin)",
    )
    planning.add_argument(
        "--correlation",
        type=real_number(0.0, 0.999),
        metavar="R",
        help="how well the simulator is expected to predict from φ to φ (default: as an earlier fusion found)",
    )
    recordings = _add_recordings(fuse)
    recordings.add_argument(
        "--gap-tolerance",
        type=real_number(0.0, 20.0, above=True),
        default=0.5,
        metavar="M",
        help="how far apart the car may start in a physical and a simulated trial of one timing (default: 0.5)",
    )
    add_output_arguments(fuse)
    fuse.set_defaults(module="skd_evaluator.extensions.fusion.fuse_command")


def add_calibrate(commands: Any) -> None:
    """Add `skd calibrate` to a parser's commands."""
    calibrate = commands.add_parser(
        "calibrate",
        help="calibrate the simulator by physical trials",
        description="Estimate which delay and deceleration of the brake, friction and sensor range make simulated cars "
        "go as those recorded on a proving ground (docs/fusion.md).",
    )
    calibrate.add_argument("simulated", type=Path, metavar="SIMULATED", help="folder of the simulated assessment")
    calibrate.add_argument(
        "physical", type=Path, metavar="PHYSICAL", help="table of the physical trials, or its folder, as of skd fuse"
    )
    _add_recordings(calibrate)
    calibration = calibrate.add_argument_group("calibration")
    calibration.add_argument(
        "--parameters",
        nargs="+",
        choices=CALIBRATED,
        metavar="NAME",
        help=f"what may be calibrated: {', '.join(CALIBRATED)} (default: all of which the trials say something)",
    )
    add_workers_argument(calibration)
    add_output_arguments(calibrate)
    calibrate.set_defaults(module="skd_evaluator.extensions.fusion.calibrate_command")


def _add_recordings(parser: Any) -> Any:
    """Add how recordings of physical trials are read, and return the group."""
    recordings = parser.add_argument_group("recordings")
    recordings.add_argument(
        "--car",
        metavar="NAME",
        help="topic of the car in bags, /tf:FRAME, or TOPIC:ID of tracked objects, or its id in tables (default: "
        "/ego/odometry, car)",
    )
    recordings.add_argument(
        "--road-user",
        metavar="NAME",
        help="topic of the road user in bags, or as --car; or its id in tables (default: /adversary/odometry, other)",
    )
    recordings.add_argument(
        "--frame",
        type=frame_place,
        default=(0.0, 0.0, 0.0),
        metavar="X,Y,DEGREES",
        help="where the frame map of the scenario lies in the recordings' frame: its origin, m, and the direction of "
        "its x axis (default: 0,0,0)",
    )
    recordings.add_argument(
        "--reference",
        type=real_number(-20.0, 20.0),
        default=0.0,
        metavar="M",
        help="how far ahead of the car's reference point in the scenario the tracked point of the car is, m; below 0 "
        "behind it (default: 0)",
    )
    recordings.add_argument(
        "--path-tolerance",
        type=real_number(0.0, 5.0, above=True),
        default=0.5,
        metavar="M",
        help="how far the tracked road user may be off its φ; a trial beyond is refused (default: 0.5)",
    )
    return recordings
