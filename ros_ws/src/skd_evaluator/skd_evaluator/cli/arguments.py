"""Arguments that several commands share, and their checks."""

from __future__ import annotations

import argparse
import datetime
from collections.abc import Callable
from pathlib import Path


def whole_number(low: int) -> Callable[[str], int]:
    """Return a parser of whole numbers from `low` on."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = low - 1
        if value < low:
            raise argparse.ArgumentTypeError(f"must be a whole number ≥ {low}, got {text!r}")
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
        "--safe-count", type=whole_number(1), default=5, metavar="N", help="safe trajectories (default 5)"
    )
    group.add_argument(
        "--kamikaze-count",
        type=whole_number(1),
        default=100,
        metavar="N",
        help="kamikaze trajectories per safe trajectory (default 100)",
    )
    group.add_argument(
        "--collision-runs",
        type=whole_number(1),
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
    group.add_argument(
        "--simulations",
        type=whole_number(1),
        default=1000,
        metavar="N",
        help="planner's budget per decision (default 1000)",
    )
    group.add_argument(
        "--seed", type=whole_number(0), default=0, metavar="N", help="of every draw (default 0)"
    )
    group.add_argument(
        "--workers", type=whole_number(1), metavar="N", help="processes (default: one per core)"
    )
    add_output_arguments(parser)


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


def output_path(arguments: argparse.Namespace) -> Path:
    """Return --out, or a new folder named for the command and the time."""
    if arguments.out is not None:
        return Path(arguments.out)
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S-%f")[:-3]
    return Path("skd_results") / f"{arguments.command}-{stamp}"
