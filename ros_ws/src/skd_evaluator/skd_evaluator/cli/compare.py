"""`skd compare`: several assessments side by side, each compared with the first."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError

from skd_evaluator.assessment.compare.comparison import MARGIN, Comparison, compare, ranking_figure
from skd_evaluator.assessment.figure_table import columns
from skd_evaluator.assessment.files.assessment_json import understood
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.files.results import StoredResult, read_result, result_folders
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import is_read, print_json
from skd_evaluator.files import tails
from skd_evaluator.margin.common_trajectories import on_common_trajectories
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.report.charts import alike
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.report.tables import comparison_table, equal_remarks, verdict_table
from skd_evaluator.report.terminal import print_table


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    if arguments.width is not None or arguments.difference is not None:
        from skd_evaluator.cli import plan

        return plan.run(arguments)
    folders = result_folders(arguments.paths)
    if len(folders) < 2:
        raise UsageError("give folders with at least two assessments")
    results = [read_result(path) for path in folders]
    with understood(Path("one of the results")):
        return _run(arguments, results)


def _run(arguments: argparse.Namespace, results: Sequence[StoredResult]) -> int:
    names = labels(results)
    out = result_folder(arguments)
    rows = [
        {
            "car": name,
            "folder": str(result.folder),
            **{key: result.figures.get(key) for key in columns("compare")},
            "warnings": not_credible(result.figures.get("warnings") or ()),
        }
        for name, result in zip(names, results, strict=True)
    ]
    # All verdicts together are to be right with 95 %: Bonferroni's share for each.
    confidence = 1.0 - 0.05 / (len(results) - 1)
    compared: list[Comparison] = []
    tried: list[str] = []
    with progress_bar() as progress:
        for other in results[1:]:
            first, second, said = on_common_trajectories(results[0], other, progress)
            compared.append(compare(first, second, confidence))
            tried += said
    entries = [
        {"car": name, "compared_with": names[0], **one.as_dict()} for name, one in zip(names[1:], compared, strict=True)
    ]
    remarks = [line for one in results for line in one.remarks]
    warnings = [*remarks, *tried, *(line for one in compared for line in one.lines()), *equal_remarks(rows, "car")]
    warnings = list(dict.fromkeys(warnings))
    ranked_by = ranking_figure(results)
    content = {
        "rows": rows,
        "ranked_by": ranked_by,
        "confidence": confidence,
        "comparisons": entries,
        "warnings": warnings,
    }

    def show() -> None:
        if arguments.json:
            print_json(content)
            return
        print_table(comparison_table(rows, ranked_by))
        print_table(verdict_table(entries, names[0], confidence))

    def write(folder: Path) -> None:
        write_json(folder / "comparison.json", content)
        if not arguments.pictures:
            return
        from skd_evaluator.report.charts import ChartedCar, coloured, has_risks, save_rating, save_vulnerability

        cars = coloured(
            [
                ChartedCar(name, result.figures, curves=_curves(result, margins=ranked_by == MARGIN))
                for result, name in zip(results, names, strict=True)
            ]
        )
        if ranked_by is not None:  # curves of unlike kind say nothing beside each other
            save_vulnerability(folder / "vulnerability.png", cars)
        if ranked_by == MARGIN and all(has_risks(one.figures) and _one_scale(results[0], one) for one in results):
            save_rating(folder / "rating.png", cars)

    read = is_read(show)  # before the pictures, which take longer than the figures
    problem = out.save(write)
    if not arguments.json and not problem:
        print(f"results in {out.path}")
    for warning in warnings:
        print(f"skd compare: warning: {warning}", file=sys.stderr)
    if problem:
        print(f"skd compare: {problem}", file=sys.stderr)
    return 1 if problem or not read else 0


def _one_scale(first: StoredResult, other: StoredResult) -> bool:
    """Return whether margins and risks of two results may stand in one picture."""
    return alike(first.figures, other.figures) and first.same_safe(other.safe)


def _curves(result: StoredResult, *, margins: bool) -> dict[str, Any]:
    """Return the vulnerability curve to draw for a result: that of its margins, or else of its planned kamikazes."""
    least, planned = result.margin_curve if margins else None, result.curve
    return {
        "kamikazes": {} if planned is None else planned.as_dict(),
        "budgets": [],
        "margins": least and least.as_dict(),
    }


def labels(results: Sequence[StoredResult]) -> list[str]:
    """Return a name for each result: that of its car, with its folder where several have the same."""
    cars = [str(result.figures["car"]) for result in results]
    often = Counter(cars)
    return [
        car if often[car] == 1 else f"{car} ({tail})"
        for car, tail in zip(cars, tails([result.folder for result in results]), strict=True)
    ]
