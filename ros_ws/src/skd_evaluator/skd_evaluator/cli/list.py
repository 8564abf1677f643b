"""`skd list`: the assessments under a folder, and with --trend how a car has changed from one to the next."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line
from skd_sim.scenario.scenario import scenario_from_dict

from skd_evaluator.assessment.compare.comparability import has_tyres, scenario_difference
from skd_evaluator.assessment.compare.comparison import Comparison, compare
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.cli.output import print_json
from skd_evaluator.report.history import Run, find_runs, runs_table, trend_table, trends_of
from skd_evaluator.report.terminal import counted, print_table


def _known(value: float | None) -> float:
    return float("inf") if value is None else value


_KEYS: dict[str, Callable[[Run], Any]] = {
    "date": lambda run: run.date,
    "folder": lambda run: str(run.folder),
    "car": lambda run: (run.car, run.date),
    "margin": lambda run: _known(run.figures["margin"]),
    "nominal_collision_rate": lambda run: _known(run.figures["nominal_collision_rate"]),
}


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    runs = find_runs(arguments.paths)
    unread = [one for one in runs if not one.figures]
    found = [one for one in runs if one.figures and _is_requested(one, arguments)]
    found.sort(key=_KEYS[arguments.sort])
    if arguments.last is not None:
        found = found[-arguments.last :]
    if arguments.trend is not None:
        return _trend(arguments, found, unread)
    if arguments.json:
        print_json({"results": [one.as_dict() for one in found], "unread": [str(one.folder) for one in unread]})
    else:
        for one in unread:
            print(f"skd list: warning: {one.folder}: {one.remark}", file=sys.stderr)
        if not found:
            where = ", ".join(map(str, arguments.paths))
            raise UsageError(f"{where}: holds no such assessment ({counted(len(runs), 'result')} in all)")
        print_table(runs_table(found))
        for one in found:
            for line in (*([one.remark] if one.remark else []), *one.warnings):
                print(f"* {one.folder}: {line}")
        for line in _namesakes(found):
            print(f"skd list: warning: {one_line(line)}", file=sys.stderr)
        print(f"{counted(len(found), 'result')}; skd verify says whether figures follow from their episodes")
    return 0


def _is_requested(one: Run, arguments: argparse.Namespace) -> bool:
    requested = {one.car: arguments.car, one.scenario: arguments.scenario}
    return all(part is None or part.casefold() in name.casefold() for name, part in requested.items())


def _trend(arguments: argparse.Namespace, found: Sequence[Run], unread: Sequence[Run]) -> int:
    lines = [f"left out: {one.folder}: {one.remark}" for one in unread]
    read = {}
    for one in found:
        try:
            read[one.folder] = read_result(one.folder)  # it is checked against its episodes
        except UsageError as error:
            lines.append(f"left out: {error}")
    if len(read) < 2:
        raise UsageError("; ".join(["a trend is of at least two assessments of a car", *lines[:1]]))
    runs = [Run(folder, result.figures) for folder, result in read.items()]

    def compared(first: Run, second: Run, confidence: float) -> Comparison:
        return compare(read[first.folder], read[second.folder], confidence)

    trends = trends_of(runs, arguments.trend, compared)
    if arguments.json:
        print_json({"figure": arguments.trend, "cars": [one.as_dict() for one in trends]})
    else:
        for trend in trends:
            print_table(trend_table(trend))
    lines += [remark for result in read.values() for remark in result.remarks]
    for step in (step for trend in trends for step in trend.steps):
        lines += step.comparison.lines() if step.comparison is not None else []
    for line in dict.fromkeys(lines):
        print(f"skd list: warning: {one_line(line)}", file=sys.stderr)
    return 0


def _namesakes(runs: Sequence[Run]) -> list[str]:
    """Return a line for each scenario that has the name of an earlier one and differs from it."""
    kinds: dict[str, Run] = {}
    for run in runs:
        kinds.setdefault(json.dumps(run.figures["scenario"], sort_keys=True), run)
    known: dict[str, list[tuple[Run, dict[str, Any]]]] = {}
    found = []
    for run in kinds.values():
        try:
            scenario = scenario_from_dict(run.figures["scenario"], str(run.folder)).as_dict()
        except UsageError:
            continue  # a list shows what was written; whoever reads the result refuses it
        earlier = known.setdefault(run.scenario, [])
        # A car without tyres is in the scenario of any friction: it makes no two of them one.
        alike = [one for one in earlier if has_tyres(one[1]) == has_tyres(scenario)]
        differ = [
            (other, difference)
            for other, its in alike or earlier
            if (difference := scenario_difference(its, scenario)) is not None
        ]
        is_new = len(differ) == len(alike or earlier)
        if is_new and differ:
            other, (key, there, here) = differ[0]
            said = f"{key} is {there} in {other.folder} and {here} in {run.folder}"
            found.append(f"{run.scenario} is the name of different scenarios: {said}")
        if is_new or not alike:
            earlier.append((run, scenario))
    return found
