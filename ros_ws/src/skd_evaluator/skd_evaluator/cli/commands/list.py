"""`skd list`: the assessments under a folder, and with --trend how a car has changed from one to the next."""

from __future__ import annotations

import argparse
import math
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skd_sim.errors import UsageError

from skd_evaluator.cli.arguments import Parser
from skd_evaluator.cli.output import finish, warn

if TYPE_CHECKING:
    from skd_evaluator.report.history import Run

_FIGURES = ("margin", "deviation", "skd", "nominal_collision_rate", "risk_1", "time_lost")
_KEYS: dict[str, Callable[[Run], Any]] = {
    "date": lambda run: run.date,
    "folder": lambda run: str(run.folder),
    "car": lambda run: (run.car, run.date),
    "margin": lambda run: _known(run.figures["margin"]),
    "nominal_collision_rate": lambda run: _known(run.figures["nominal_collision_rate"]),
}


def _known(value: float | None) -> float:
    return math.inf if value is None else value


def add(parser: Parser) -> None:
    """List results under a folder, or how a car has changed from one to the next.

    List the assessments in and under folders, and those that were interrupted. With --trend say of each car whether it
    is safer than in the assessment before, as skd compare does.
    """
    parser.set_defaults(group="look")
    text = "folder of results, or one above some (default: skd_results)"
    parser.add_paths("DIR", text, nargs="*", default=[Path("skd_results")])
    parser.add_value("--car", "only cars whose name holds this text", metavar="TEXT")
    parser.add_value("--scenario", "only scenarios whose name holds this text", metavar="TEXT")
    parser.add_value("--sort", "in which order", choices=tuple(_KEYS), default="date")
    parser.add_count("--last", 1, 1_000_000, "only so many, the last of the order")
    parser.add_value("--trend", "follow this figure of each car from result to result", choices=_FIGURES)
    parser.add_flag("--json", "print JSON instead of a table")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_evaluator.report.formats import counted
    from skd_evaluator.report.history import find_runs, runs_table, unfinished_below
    from skd_evaluator.report.repeat import program
    from skd_evaluator.report.terminal import print_table

    runs = find_runs(arguments.paths)
    unread = [one for one in runs if not one.figures]
    car, scenario = ((part or "").casefold() for part in (arguments.car, arguments.scenario))
    read = [one for one in runs if one.figures]
    found = [one for one in read if car in one.car.casefold() and scenario in one.scenario.casefold()]
    found.sort(key=_KEYS[arguments.sort])
    if arguments.last is not None:
        found = found[-arguments.last :]
    if arguments.trend is not None:
        return _trend(arguments, found, unread)
    open_ones = [] if car or scenario else unfinished_below(arguments.paths)
    content = {"results": [one.as_dict() for one in found], "unread": [str(one.folder) for one in unread]}
    content["unfinished"] = list(map(str, open_ones))

    def show() -> None:
        warn("list", [f"{one.folder}: {one.remark}" for one in unread])
        if not (found or open_ones):
            where = ", ".join(map(str, arguments.paths))
            raise UsageError(f"{where}: holds no such assessment ({counted(len(runs), 'result')} in all)")
        if found:
            print_table(runs_table(found))
        for one in found:
            for line in filter(None, (one.remark, *one.not_credible[:1])):
                print(f"* {one.folder}: {line}")
        for folder in open_ones:
            print(f"unfinished: {folder}; go on with: {shlex.join([program(), 'assess', '--resume', str(folder)])}")
        noted = ", some with warnings (*), which --json prints" if any(one.warnings for one in found) else ""
        print(f"{counted(len(found), 'result')}{noted}; skd verify says whether figures follow from their episodes")

    return finish(arguments, content, show)


def _trend(arguments: argparse.Namespace, found: Sequence[Run], unread: Sequence[Run]) -> int:
    from skd_evaluator.assessment.files.results import read_result
    from skd_evaluator.report.history import trend_table, trends_of
    from skd_evaluator.report.terminal import print_table

    lines = [f"left out: {one.folder}: {one.remark}" for one in unread]
    results = []
    for one in found:
        try:
            results.append(read_result(one.folder))  # it is checked against its episodes
        except UsageError as error:
            lines.append(f"left out: {error}")
    if len(results) < 2:
        raise UsageError("; ".join(["a trend is of at least two assessments of a car", *lines[:1]]))
    trends, said = trends_of(results, arguments.trend)
    alone = sorted({trend["car"] for trend in trends if len(trend["runs"]) == 1})

    def show() -> None:
        for trend in trends:
            if len(trend["runs"]) > 1:
                print_table(trend_table(trend))
        if alone:
            print(f"no trend, of one result ({len(alone)}): {', '.join(alone)}")

    return finish(arguments, {"figure": arguments.trend, "cars": trends}, show, [*lines, *said])
