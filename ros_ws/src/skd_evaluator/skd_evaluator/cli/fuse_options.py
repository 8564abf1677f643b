"""The options of `skd fuse`; light, for they are imported at every start."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skd_evaluator.cli.arguments import add_count, add_output_arguments, frame_place, real_number


def add_fuse(commands: Any) -> None:
    """Add `skd fuse` to the commands."""
    fuse = commands.add_parser(
        "fuse",
        help="say what the physical car does, from few trials on a proving ground and many simulated ones",
        description="Estimate clearance, required deceleration, hit rate and margin of the physical car over all safe "
        "trajectories φ. Physical trials are paired with simulated ones of the same φ and timing; where the simulator "
        "predicts them, simulations of further φ make the interval narrower (docs/fusion.md). Where it does not, the "
        "physical trials stand alone.",
    )
    fuse.add_argument(
        "simulated", type=Path, metavar="SIMULATED", help="folder of an assessment, or a table of simulated trials"
    )
    fuse.add_argument(
        "physical",
        type=Path,
        metavar="PHYSICAL",
        help="table of physical trials, or the folder with its trials.csv: columns phi and file (a bag or a table of "
        "the two tracked objects), or phi and figures (clearance, required_deceleration, hit, margin); gap says how "
        "far the car was before the crossing line when φ began, m",
    )
    add_count(
        fuse,
        "--looks",
        1,
        1000,
        "how often you look at the results, at most, before you stop, said before the first trial: each look after as "
        "many further trials. The intervals then hold at all looks together",
        default=1,
    )
    recordings = fuse.add_argument_group("recordings")
    recordings.add_argument(
        "--car", metavar="NAME", help="topic of the car in bags, or its id in tables (default: /ego/odometry, car)"
    )
    recordings.add_argument(
        "--road-user",
        metavar="NAME",
        help="topic of the road user in bags, or its id in tables (default: /adversary/odometry, other)",
    )
    recordings.add_argument(
        "--frame",
        type=frame_place,
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
    recordings.add_argument(
        "--gap-tolerance",
        type=real_number(0.0, 20.0, above=True),
        default=0.5,
        metavar="M",
        help="how far apart the car may start in a physical and a simulated trial of one timing (default: 0.5)",
    )
    add_output_arguments(fuse)
