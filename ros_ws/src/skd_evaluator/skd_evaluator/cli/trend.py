"""`skd trend`: how a figure of a car has changed, from assessment to assessment."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.inputs.files import one_line

from skd_evaluator.assessment.compare.comparison import Comparison, compare
from skd_evaluator.assessment.figure_table import AT_THE_TOP
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import is_read, print_json
from skd_evaluator.report.terminal import print_table
from skd_evaluator.report.trend import Run, find_runs, trend_table, trends_of


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    runs = find_runs(arguments.paths)
    for one in (one for one in runs if not one.figures):
        raise UsageError(f"{one.folder}: {one.remark}")
    wanted = [one for one in runs if arguments.car is None or arguments.car.casefold() in one.car.casefold()]
    if len(wanted) < 2:
        raise UsageError("a trend is of at least two assessments of a car")
    out = result_folder(arguments)
    # Each is read once more, and only this is shown: what does not follow from its episodes is refused, also of a car
    # that has no neighbour to be held against.
    read = {one.folder: read_result(one.folder) for one in wanted}
    wanted = [Run(folder, result.figures) for folder, result in read.items()]
    remarks = dict.fromkeys(remark for result in read.values() for remark in result.remarks)
    for remark in remarks:
        print(f"skd trend: warning: {remark}", file=sys.stderr)

    def held(first: Run, second: Run, confidence: float) -> Comparison:
        return compare(read[first.folder], read[second.folder], confidence)

    trends = trends_of(wanted, arguments.figure, held)
    kind = AT_THE_TOP[arguments.figure].kind
    content = {"figure": arguments.figure, "cars": [one.as_dict() for one in trends]}

    def show() -> None:
        if arguments.json:
            print_json(content)
            return
        for trend in trends:
            print_table(trend_table(trend, kind))

    def write(folder: Path) -> None:
        write_json(folder / "trend.json", content)
        if arguments.pictures:
            from skd_evaluator.report.pictures import save_trends

            save_trends(folder / "trend.png", trends, kind)

    is_seen = is_read(show)  # before the picture, which takes longer than the figures
    problem = out.save(write)
    if problem:
        print(f"skd trend: {problem}", file=sys.stderr)
    elif not arguments.json:
        print(f"results in {out.path}")
    lines = dict.fromkeys(line for trend in trends for step in trend.steps for line in step.lines)
    for line in (one for one in lines if one not in remarks):
        print(f"skd trend: warning: {one_line(line)}", file=sys.stderr)
    return 1 if problem or not is_seen else 0
