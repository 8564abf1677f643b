"""Arguments that several commands share, and their checks."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skd_sim.options.options import Option, options_of

from skd_evaluator.assessment.options import (
    MAXIMUM_ABORTED,
    MOST_WORKERS,
    AssessmentOptions,
    CampaignOptions,
    GraphOptions,
)

if TYPE_CHECKING:
    from skd_evaluator.assessment.files.result_folder import ResultFolder
    from skd_evaluator.assessment.run.workers import Workers

CAR_GROUP = "car and test"


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


def real_number(low: float, high: float = math.inf, *, above: bool = False) -> Callable[[str], float]:
    """Return a parser of finite numbers from `low` to `high`; with `above`, `low` itself is none of them."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = -math.inf
        if not (math.isfinite(value) and low <= value <= high) or (above and value == low):
            lowest = f"{'>' if above else '≥'} {low:g}"
            allowed = f"≤ {high:g}" if math.isfinite(value) and value > high else lowest
            raise argparse.ArgumentTypeError(f"must be a finite number {allowed}, got {text!r}")
        return value

    return parse


positive_number = real_number(0.0, above=True)
_MOST_STEPS = 100


def steps_of(unit: str, low: float, high: float) -> Callable[[str], list[float]]:
    """Return a parser of numbers above `low` and up to `high`, as FROM:TO:STEP, both ends included."""

    def parse(text: str) -> list[float]:
        try:
            first, last, step = (float(part) for part in text.split(":"))
            count = int((last - first) / step + 1e-9) + 1
        except (ValueError, ZeroDivisionError, OverflowError):
            first, last, step, count = 0.0, 0.0, 0.0, 0
        if not (low < first <= last <= high and step > 0.0 and 1 <= count <= _MOST_STEPS):
            raise argparse.ArgumentTypeError(
                f"must be FROM:TO:STEP in {unit}, above {low:g} and up to {high:g}, at most {_MOST_STEPS} values, as "
                f"10:60:10; got {text!r}"
            )
        return [first + step * number for number in range(count)]

    return parse


def add_count(
    group: argparse._ActionsContainer, flag: str, low: int, high: int, text: str, *, default: int | None = None
) -> None:
    """Add a whole number from `low` to `high`; the help says its default, if it has one."""
    said = text if default is None else f"{text} (default: %(default)s)"
    group.add_argument(flag, type=whole_number(low, high), default=default, metavar="N", help=said)


def add_workers_argument(group: argparse._ActionsContainer) -> None:
    """Add --workers."""
    add_count(group, "--workers", 1, MOST_WORKERS, "how many processes run the episodes (default: one per core)")


def add_options(
    group: argparse._ActionsContainer,
    command: str,
    title: str = "",
    table: Callable[..., Any] = CampaignOptions,
    **changes: Mapping[str, Any],
) -> None:
    """Add the options of a table that a command takes.

    Args:
        group: the parser, or group of one, that gets them.
        command: name of the command that takes them.
        title: add only the options of the group with this title; all by default.
        table: the dataclass whose fields are the options.
        changes: other arguments for `add_argument`, by name of the option.
    """
    for one in options_of(table):
        if command in one.commands and title in ("", one.group):
            arguments = {**_argument(one), **changes.get(one.name, {})}
            group.add_argument(one.flag, **arguments)


def _argument(one: Option) -> dict[str, Any]:
    """Return the arguments of `add_argument` for an option."""
    text = one.text.replace("%", "%%")
    if one.kind is bool:
        return {"action": "store_true", "help": text}
    default = one.unsaid
    said = one.unset if default in (None, "") else f"{default:g}" if one.kind is float else str(default)
    found: dict[str, Any] = {"default": default, "metavar": one.metavar, "help": f"{text} (default: {said})"}
    if one.kind is tuple:
        found["action"] = "append"
    if one.choices is not None:
        return {**found, "choices": one.choices, "metavar": one.metavar or f"{{{','.join(one.choices.own)}}}"}
    low, high = (-math.inf if one.low is None else one.low), (math.inf if one.high is None else one.high)
    if one.kind is int:
        found["type"] = whole_number(int(low), int(high))
    elif one.kind is float:
        found["type"] = real_number(low, high, above=one.absent is not None)
    return found


_PAPER = {
    "safe_count": (5, "how many safe trajectories (φ) of each kind there are"),
    "kamikaze_count": (100, "how many kamikazes are planned for each safe trajectory"),
}


def add_campaign_arguments(parser: argparse.ArgumentParser, command: str) -> None:
    """Add what `assess` and `sweep` share."""
    group = parser.add_argument_group("campaign")
    # The paper's table has the paper's numbers; for a rating more φ say more than more trials on each.
    paper: dict[str, Any] = {
        name: {"default": count, "help": f"{text} (default: {count})"} for name, (count, text) in _PAPER.items()
    }
    add_options(group, command, group.title or "", **(paper if command == "sweep" else {}))
    add_max_aborted_argument(group)
    add_options(group, command, table=AssessmentOptions)
    add_runner_arguments(group)
    add_output_arguments(parser)


def add_runner_arguments(parser: argparse._ActionsContainer) -> None:
    """Add the options that say where episodes run in process."""
    where = parser.add_mutually_exclusive_group()
    add_workers_argument(where)
    where.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="address of a Dask cluster that runs the episodes instead, such as tcp://host:8786 (see docs/scale.md)",
    )


def runner_of(arguments: argparse.Namespace, *, isolated: bool = False, answer_limit: float | None = None) -> Workers:
    """Return what runs the episodes of a command in process, as the options of `add_runner_arguments` say."""
    from skd_sim.controllers.isolated import CALL_LIMIT

    from skd_evaluator.assessment.run.dask_cluster import make_runner
    from skd_evaluator.assessment.run.workers import available_workers

    workers = arguments.workers or available_workers()
    return make_runner(arguments.scheduler, workers, isolated=isolated, answer_limit=answer_limit or CALL_LIMIT)


def percentage(text: str) -> float:
    """Parse a percentage from 0 to 100, and return it as a share."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 100.0:
        raise argparse.ArgumentTypeError(f"must be a number from 0 to 100, got {text!r}")
    return value / 100.0


def frame_place(text: str) -> tuple[float, float, float]:
    """Parse X,Y,DEGREES: where one frame lies in another."""
    try:
        x, y, degrees = (float(part) for part in text.split(","))
    except ValueError:
        x = y = degrees = math.nan
    if not all(math.isfinite(one) for one in (x, y, degrees)):
        raise argparse.ArgumentTypeError(f"must be X,Y,DEGREES, such as 12.5,-3,90, got {text!r}")
    return x, y, degrees


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
        help="percentage of the episodes that may be aborted, of all kamikazes and runs along φ and of those of each "
        "figure. An aborted episode says nothing about the car; if more are aborted, the exit code is 1 (default: 5)",
    )


def add_details_argument(parser: argparse._ActionsContainer) -> None:
    """Add --details."""
    parser.add_argument(
        "--details", action="store_true", help="print every figure, and a line for each safe trajectory"
    )


def add_pictures_argument(parser: argparse._ActionsContainer, text: str) -> None:
    """Add --no-pictures."""
    parser.add_argument("--no-pictures", dest="pictures", action="store_false", help=text)


def add_damage_argument(parser: argparse._ActionsContainer) -> None:
    """Add --skip-damaged."""
    parser.add_argument(
        "--skip-damaged",
        action="store_true",
        help="leave out and count the recorded episodes that are damaged or cannot have happened as recorded, instead "
        "of refusing all of them",
    )


def add_graph_arguments(
    parser: argparse.ArgumentParser,
    command: str,
    *,
    optional: bool,
    record: bool = True,
    **changes: Mapping[str, Any],
) -> None:
    """Add the options of the node graph; with `optional` also --graph, with `record` --record; see `add_options`."""
    group = parser.add_argument_group("node graph")
    if optional:
        group.add_argument("--graph", action="store_true", help="run the episodes through a graph of ROS 2 nodes")
    if optional and record:
        group.add_argument(
            "--record", action="store_true", help="keep a recording (a bag) of every episode; needs --graph"
        )
    add_options(group, command, "", GraphOptions, controller_command={"type": command_line}, **changes)


def add_output_arguments(
    parser: argparse.ArgumentParser,
    metavar: str = "DIR",
    text: str = "folder for the results (default: skd_results/<command>-<time>)",
) -> None:
    """Add --out, --overwrite, --json, -v and -q."""
    group = parser.add_argument_group("output")
    group.add_argument("--out", type=Path, metavar=metavar, help=text)
    group.add_argument("--overwrite", action="store_true", help="replace what --out names, if it exists")
    group.add_argument("--json", action="store_true", help="print JSON, and nothing else, on standard output")
    loudness = group.add_mutually_exclusive_group()
    loudness.add_argument(
        "-v", "--verbose", action="store_true", help="report every step, and the source of an error, on standard error"
    )
    loudness.add_argument("-q", "--quiet", action="store_true", help="print no tables and no progress")


def result_folder(arguments: argparse.Namespace) -> ResultFolder:
    """Take the folder for the results.

    Raises:
        UsageError: it cannot be taken, or holds what the command reads.
    """
    from skd_evaluator.assessment.files.result_folder import ResultFolder
    from skd_evaluator.assessment.from_options import inputs_of, refuse_to_replace

    out = output_path(arguments)
    refuse_to_replace(out, inputs_of(vars(arguments)))
    return ResultFolder(out, overwrite=arguments.overwrite)


def output_path(arguments: argparse.Namespace) -> Path:
    """Return --out, or a new folder named for the command and the time."""
    if arguments.out is not None:
        return Path(arguments.out)
    from skd_evaluator.assessment.from_options import (
        default_folder,  # this module is imported at every start, and has to be light
    )

    return default_folder(arguments.command)


def add_car_arguments(parser: argparse.ArgumentParser, command: str, **changes: Mapping[str, Any]) -> None:
    """Add the options that say which car meets whom; `changes` as `add_options` takes them."""
    group = parser.add_argument_group(CAR_GROUP)
    add_options(group, command, CAR_GROUP, CampaignOptions, **changes)
    group.add_argument(
        "--scenario",
        metavar="NAME",
        help="the road and who meets on it: a scenario that comes with SKD or is registered by an installed package, "
        "or a YAML file (default: crossing; citr_crossing with CITR data)",
    )
