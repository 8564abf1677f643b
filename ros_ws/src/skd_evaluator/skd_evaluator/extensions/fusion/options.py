"""The options of `skd fuse`; light, for help reads them."""

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
        help="few trials on a proving ground and many simulated ones: rate the physical car, calibrate the simulator",
        description="Estimate clearance, required deceleration, nominal collision rate and margin of the physical car "
        "over all safe trajectories φ. Where simulated trials predict physical ones of the same φ, simulations of "
        "further φ make the intervals narrower. Else the physical trials stand alone (docs/proving_ground.md).",
    )
    text = "folder of an assessment, or a table of simulated trials. With --width also an earlier fusion"
    fuse.add_argument("simulated", type=Path, metavar="SIMULATED", help=text)
    text = "table of physical trials, or the folder of its trials.csv (docs/proving_ground.md has the columns)"
    fuse.add_argument("physical", type=Path, nargs="?", metavar="PHYSICAL", help=text)
    text = "how often you look at the results, at most: the intervals then hold at all looks together"
    add_count(fuse, "--looks", 1, 100, text, default=1)  # `metrics.statistics.sequential.MOST_LOOKS`
    planning = fuse.add_argument_group("planning")
    text = "without PHYSICAL: say how many trials it takes until the 95 %% interval is so wide, in the figure's unit"
    planning.add_argument("--width", type=positive_number, metavar="W", help=text)
    text = "the figure that is planned for (default: margin)"
    planning.add_argument("--figure", choices=FUSED, default="margin", help=text)
    text = "how well the simulator is expected to predict from φ to φ (default: as an earlier fusion found)"
    planning.add_argument("--correlation", type=real_number(0.0, 0.999), metavar="R", help=text)
    recordings = fuse.add_argument_group("recordings")
    text = "the car in bags: topic, /tf:FRAME or TOPIC:ID, or its id in tables (default: /ego/odometry, car)"
    recordings.add_argument("--car", metavar="NAME", help=text)
    text = "the road user, named as --car (default: /adversary/odometry, other)"
    recordings.add_argument("--road-user", metavar="NAME", help=text)
    text, origin = "origin (m) and direction of the scenario's frame map in that of the recordings", (0.0, 0.0, 0.0)
    recordings.add_argument(
        "--frame", type=frame_place, default=origin, metavar="X,Y,DEGREES", help=f"{text} (default: 0,0,0)"
    )
    text = "how far ahead of the car's reference point in the scenario its tracked point is, m (default: 0)"
    recordings.add_argument("--reference", type=real_number(-20.0, 20.0), default=0.0, metavar="M", help=text)
    text = "how far the tracked road user may be off its φ; a trial beyond is refused (default: 0.5)"
    tolerance = {"default": 0.5, "metavar": "M"}
    recordings.add_argument("--path-tolerance", type=real_number(0.0, 5.0, above=True), **tolerance, help=text)
    text = "greatest difference of the car's start in a physical and a simulated trial of one timing (default: 0.5)"
    recordings.add_argument("--gap-tolerance", type=real_number(0.0, 20.0, above=True), **tolerance, help=text)
    calibration = fuse.add_argument_group("calibration")
    text = "estimate delay and deceleration of the brake, friction and sensor range of the simulator instead"
    module = "skd_evaluator.extensions.fusion.calibrate_command"
    calibration.add_argument("--calibrate", dest="module", action="store_const", const=module, help=text)
    text = f"what may be calibrated: {', '.join(CALIBRATED)} (default: all of which the trials say something)"
    calibration.add_argument("--parameters", nargs="+", choices=CALIBRATED, metavar="NAME", help=text)
    add_workers_argument(calibration)
    add_output_arguments(fuse)
    fuse.set_defaults(module="skd_evaluator.extensions.fusion.fuse_command")
