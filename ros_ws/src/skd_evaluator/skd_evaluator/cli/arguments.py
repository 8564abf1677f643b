"""Arguments that several commands share, and their checks."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.objective import BOTH, DEFAULT_FLOOR_BUDGET, DEFAULT_SIMULATIONS, Objective

MAXIMUM_ABORTED = 0.05
"""Share of episodes that may be aborted before an assessment counts as failed."""


def whole_number(low: int, high: int = 2**63 - 1) -> Callable[[str], int]:
    """Return a parser of whole numbers from `low` to `high`."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            allowed = f"≥ {low}" if value < low else f"≤ {high}"
            raise argparse.ArgumentTypeError(f"must be a whole number {allowed}, got {text!r}")
        return value

    return parse


def positive_number(text: str) -> float:
    """Parse a positive finite number."""
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be a positive number, got {text!r}")
    return value


def multiplier(text: str) -> float:
    """Parse C, a finite number ≥ 0."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"must be a finite number ≥ 0, got {text!r}")
    return value


def add_campaign_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what `assess` and `sweep` share."""
    group = parser.add_argument_group("campaign")
    group.add_argument(
        "--safe-count", type=whole_number(1, 65_535), default=5, metavar="N", help="safe trajectories (default 5)"
    )
    group.add_argument(
        "--kamikaze-count",
        type=whole_number(1, 1_000_000),
        default=100,
        metavar="N",
        help="kamikaze trajectories per safe trajectory (default 100)",
    )
    group.add_argument(
        "--collision-runs",
        type=whole_number(1, 10_000_000),
        default=500,
        metavar="N",
        help="runs of the car against a pedestrian that follows the safe trajectories (default 500)",
    )
    group.add_argument(
        "--max-distance",
        type=positive_number,
        metavar="M",
        help="discard pairs further apart than this many metres, and report how many (default: keep all)",
    )
    add_max_aborted_argument(group)
    add_floor_argument(group)
    group.add_argument(
        "--simulations",
        type=whole_number(1, 100_000),
        default=DEFAULT_SIMULATIONS,
        metavar="N",
        help=f"planner's budget per decision (default {DEFAULT_SIMULATIONS})",
    )
    add_objective_argument(group)
    group.add_argument("--seed", type=whole_number(0), default=0, metavar="N", help="of every draw (default 0)")
    group.add_argument("--workers", type=whole_number(1, 1024), metavar="N", help="processes (default: one per core)")
    add_output_arguments(parser)


def percentage(text: str) -> float:
    """Parse a percentage from 0 to 100, and return it as a share."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 100.0:
        raise argparse.ArgumentTypeError(f"must be a number from 0 to 100, got {text!r}")
    return value / 100.0


def command_line(text: str) -> str:
    """Return a command line that is not empty.

    Raises:
        argparse.ArgumentTypeError: it is.
    """
    if not text.strip():
        raise argparse.ArgumentTypeError("is empty; leave it out where you start the controller yourself")
    return text


def add_max_aborted_argument(parser: argparse._ActionsContainer) -> None:
    """Add --max-aborted."""
    parser.add_argument(
        "--max-aborted",
        type=percentage,
        default=MAXIMUM_ABORTED,
        metavar="PERCENT",
        help="of the episodes; aborted ones say nothing about the car, and where they are more the exit code is 1 "
        "(default 5)",
    )


def add_objective_argument(parser: argparse._ActionsContainer, *, several: bool = True) -> None:
    """Add --objective; with `several` both default ones can be asked for, and are by default."""
    names = tuple(objective.value for objective in Objective)  # whose own names are Python's, not the user's
    parser.add_argument(
        "--objective",
        choices=(BOTH, *names) if several else names,
        default=BOTH if several else Objective.PAPER.value,
        help="what kamikazes are rewarded for: to deform φ little, which ranks cars; to collide as fast as possible "
        "(paper); a small Fréchet distance (frechet); "
        + ("both: the first two (default)" if several else "default paper"),
    )


def add_floor_argument(group: argparse._ActionsContainer) -> None:
    """Add --floor."""
    group.add_argument(
        "--floor",
        action="store_true",
        help="also the least distance that a kamikaze who knew the car's noise could have reached in each episode, and "
        "how close its own comes: exact for the basic controller; for others that run in process what a search finds, "
        "by objective deformation",
    )
    group.add_argument(
        "--floor-budget",
        type=whole_number(1, 10_000_000),
        default=DEFAULT_FLOOR_BUDGET,
        metavar="N",
        help="ticks that this search may simulate per episode (default %(default)s)",
    )


def add_damage_argument(parser: argparse._ActionsContainer) -> None:
    """Add --skip-damaged."""
    parser.add_argument(
        "--skip-damaged",
        action="store_true",
        help="leave out, and count, what is damaged or cannot have happened so, instead of refusing all",
    )


def add_car_model_argument(parser: argparse._ActionsContainer) -> None:
    """Add --car-model."""
    parser.add_argument(
        "--car-model",
        type=Path,
        metavar="FILE",
        help="what the pedestrian thinks of the car: car_model.yaml of skd fit (default: C of the basic controller is "
        "known, and nothing of another)",
    )


def add_graph_arguments(parser: argparse.ArgumentParser, *, optional: bool, record: bool = True) -> None:
    """Add the options of the node graph; with `optional` also --graph, and with `record` --record."""
    group = parser.add_argument_group("node graph")
    if optional:
        group.add_argument("--graph", action="store_true", help="run the episodes through the node graph")
    if optional and record:
        group.add_argument("--record", action="store_true", help="keep a bag of every episode (graph only)")
    group.add_argument(
        "--controller-command",
        type=command_line,
        default=None,
        metavar="COMMAND",
        help="command line of an external controller node; without it the controller is started by you",
    )
    group.add_argument(
        "--command-type",
        choices=("accel_stamped", "twist_stamped", "twist"),
        default="accel_stamped",
        help="what the controller publishes on /ego/acceleration_command (default accel_stamped)",
    )
    group.add_argument(
        "--pacing",
        choices=("lockstep", "real_time"),
        default="lockstep",
        help="as fast as the nodes answer, or by the wall clock (default lockstep)",
    )
    group.add_argument(
        "--rate-factor",
        type=positive_number,
        default=1.0,
        metavar="F",
        help="simulated seconds per second in real time (default 1)",
    )
    group.add_argument("--restart-controller", action="store_true", help="start the controller anew for each episode")
    group.add_argument(
        "--command-timeout",
        type=positive_number,
        default=5.0,
        metavar="S",
        help="seconds of silence after which an episode is aborted (default 5)",
    )
    group.add_argument(
        "--startup-timeout",
        type=positive_number,
        default=60.0,
        metavar="S",
        help="the same for an episode's first command, and in process for every call of a controller of yours "
        "(default 60)",
    )


def add_output_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --out, --overwrite and --json."""
    group = parser.add_argument_group("output")
    group.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for the results (default: skd_results/<command>-<time>)",
    )
    group.add_argument("--overwrite", action="store_true", help="replace the results in --out")
    group.add_argument("--json", action="store_true", help="print JSON instead of a table")


def refuse_to_replace(out: Path, paths: Sequence[Path]) -> None:
    """Refuse an output folder that holds what is read: --overwrite would delete it."""
    for path in paths:
        if path.resolve().is_relative_to(out.resolve()):
            raise UsageError(f"--out {out}: holds {path}, which is read; give another folder")


def output_path(arguments: argparse.Namespace) -> Path:
    """Return --out, or a new folder named for the command and the time."""
    if arguments.out is not None:
        return Path(arguments.out)
    from skd_evaluator.tasks import default_folder  # this module is imported at every start, and has to be light

    return default_folder(arguments.command)
