"""The commands that make a model of a car, of people or of a proving ground, and their options; light."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skd_evaluator.cli.arguments import (
    add_car_arguments,
    add_count,
    add_damage_argument,
    add_graph_arguments,
    add_options,
    add_output_arguments,
    add_workers_argument,
    frame_place,
    real_number,
)

CALIBRATED = ("delay", "deceleration", "friction", "sensor_range")
"""Names of the simulator's parameters; what they are stands in `fusion/calibration`."""


def add_model_commands(commands: Any) -> None:
    """Add them to a parser's commands; each says in which module of `cli/commands` it is."""
    probe = commands.add_parser(
        "probe",
        help="run episodes that show how a car reacts, for skd fit",
        description="Run varied crossings that show when and how a car brakes, and keep them for skd fit: with --graph "
        "as bags, otherwise in a file episodes.npz.",
    )
    add_car_arguments(probe, "probe")
    add_count(probe, "--episodes", 1, 1_000_000, "how many episodes to run", default=1000)
    add_options(probe, "probe", "campaign")
    add_workers_argument(probe)
    add_graph_arguments(probe, "probe", optional=True, record=False)
    add_output_arguments(probe)
    probe.set_defaults(module="models.probe")

    fit = commands.add_parser(
        "fit",
        help="learn a model of a car from recorded episodes, or calibrate the simulator by physical trials",
        description="Estimate by maximum likelihood how a car brakes, from recorded episodes, and write the model to "
        "car_model.yaml. skd assess --car-model lets the adversary plan with it. With --simulator: estimate the "
        "simulator's brake, friction and sensor range from trials on a proving ground (docs/fusion.md).",
    )
    fit.add_argument(
        "paths",
        type=Path,
        nargs="+",
        metavar="PATH",
        help="a bag folder, an .mcap file, an episodes.npz, or a folder of them; with --simulator the folder of the "
        "simulated assessment, and the physical trials as of skd fuse",
    )
    _add_simulator(fit)
    add_damage_argument(fit)
    add_output_arguments(fit)
    fit.set_defaults(module="models.fit")

    fuse = commands.add_parser(
        "fuse",
        help="estimate what the physical car does, from few trials on a proving ground and many simulated ones",
        description="Estimate clearance, required deceleration, nominal collision rate and margin of the physical car "
        "over all safe trajectories φ. Physical trials are paired with simulated ones of the same φ and timing; where "
        "the simulator predicts them, simulations of further φ make the interval narrower (docs/fusion.md). Where it "
        "does not, the physical trials stand alone.",
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
        100,  # `measure.statistics.sequential.MOST_LOOKS`
        "how often you look at the results, at most, before you stop, said before the first trial: each look after as "
        "many further trials. The intervals then hold at all looks together",
        default=1,
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
    fuse.set_defaults(module="models.fuse")

    behaviour = commands.add_parser(
        "behaviour",
        help="learn how people deviate from the way they mean to go, for the risk",
        description="Fit a behaviour model to people who were tracked, check it on people whom it has not seen, and "
        "write it to behaviour.yaml. skd assess --behaviour estimates the risk with it.",
    )
    behaviour.add_argument("action", choices=("fit",), help="fit: fit a behaviour model to tracks")
    behaviour.add_argument(
        "paths",
        type=Path,
        nargs="+",
        metavar="PATH",
        help="the folder of CITR's vci_lat_uni, a csv file with columns t, x, y (x along the way that is intended) "
        "or a folder of such files, or recorded episodes, whose safe trajectories are taken",
    )
    behaviour.add_argument(
        "--name", default="fitted", metavar="NAME", help="what the model is called (default: fitted)"
    )
    behaviour.add_argument(
        "--kind", default="pedestrian", metavar="KIND", help="the kind of road user (default: pedestrian)"
    )
    behaviour.add_argument("--description", default="", metavar="TEXT", help="whom the model is of")
    add_damage_argument(behaviour)
    add_output_arguments(behaviour)
    behaviour.set_defaults(module="models.behaviour")


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


def _add_simulator(fit: Any) -> None:
    """Add --simulator and what goes with it."""
    fit.add_argument(
        "--simulator",
        action="store_true",
        help="calibrate the simulator: which delay and deceleration of the brake, friction and sensor range make "
        "simulated cars go as recorded ones, and what margin and risk follow",
    )
    _add_recordings(fit)
    calibration = fit.add_argument_group("calibration")
    calibration.add_argument(
        "--parameters",
        nargs="+",
        choices=CALIBRATED,
        metavar="NAME",
        help=f"what may be calibrated: {', '.join(CALIBRATED)} (default: all of which the trials say something)",
    )
    add_count(
        calibration,
        "--draws",
        0,
        1000,
        "how many draws of the parameters margin and risk are computed with; 0: neither",
        default=10,
    )
    add_count(calibration, "--draw-phi", 5, 10_000, "on how many φ, at most, each draw is assessed", default=20)
    add_workers_argument(calibration)
