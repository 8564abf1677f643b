"""`skd compare`: several assessments side by side."""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError

from skd_evaluator.campaign.results import ResultFolder, write_json
from skd_evaluator.campaign.stored_result import StoredResult, read_result
from skd_evaluator.cli.arguments import output_path, refuse_to_replace
from skd_evaluator.report.terminal import car_name, comparison_table, print_table

_FIGURES = (
    "deformation", "deformation_ci95", "deformation_ci95_clustered", "deformation_success_rate",
    "equivalent_multiplier", "equivalent_multiplier_text", "equivalent_multiplier_ci95",
    "equivalent_multiplier_ci95_text", "collision_rate", "collision_rate_ci95", "skd", "skd_ci95", "eta_max", "seed",
    "version",
)  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    if len({path.resolve() for path in arguments.paths}) < max(2, len(arguments.paths)):
        raise UsageError("give at least two folders of assessments, each once")
    results = [read_result(path) for path in arguments.paths]
    out = ResultFolder(output_path(arguments), overwrite=arguments.overwrite)
    refuse_to_replace(out.path, arguments.paths)
    names = labels(results)
    rows = [
        {"car": name, "folder": str(result.folder), **{key: result.figures[key] for key in _FIGURES}}
        for name, result in zip(names, results, strict=True)
    ]
    warnings = doubts(results)
    content = {"rows": rows, "warnings": warnings}

    def write(folder: Path) -> None:
        from skd_evaluator.report.vulnerability import save_vulnerability, shown_curve

        write_json(folder / "comparison.json", content)
        curves: list[dict[str, Any]] = [
            {"kamikazes": result.curve.as_dict(), "budgets": [], "floors": None} for result in results
        ]
        shown = [
            shown_curve(result.figures, curve, name) for result, curve, name in zip(results, curves, names, strict=True)
        ]
        save_vulnerability(folder / "vulnerability.png", shown)

    problem = out.save(write)
    if arguments.json:
        print(json.dumps(content, indent=2, ensure_ascii=False))
    else:
        print_table(comparison_table(rows))
        if not problem:
            print(f"results in {out.path}")
    for warning in warnings:
        print(f"skd compare: warning: {warning}", file=sys.stderr)
    if problem:
        print(f"skd compare: {problem}", file=sys.stderr)
    return 1 if problem else 0


def labels(results: Sequence[StoredResult]) -> list[str]:
    """Return a name for each result: that of its car, with its folder where several have the same."""
    cars = [car_name(result.figures) for result in results]
    often = Counter(cars)
    return [
        car if often[car] == 1 else f"{car} ({result.folder.resolve().name})"
        for car, result in zip(cars, results, strict=True)
    ]


def doubts(results: Sequence[StoredResult]) -> list[str]:
    """Return why the figures do not compare, in one line each."""
    first, found = results[0], []
    for other in results[1:]:
        between = f"{first.folder} and {other.folder}"
        if not first.same_safe(other):
            found.append(f"{between} are of different φ: their deformations do not compare")
        for name, what in (("eta_max", "η_max"), ("simulations", "budgets of the planner")):
            if first.figures[name] != other.figures[name]:
                values: tuple[Any, Any] = (first.figures[name], other.figures[name])
                found.append(f"{between} have different {what}, {values[0]:g} and {values[1]:g}")
        ran = [next(iter(one.figures["objectives"])) for one in (first, other)]
        if ran[0] != ran[1]:
            found.append(f"{between} are of kamikazes of different objectives, {ran[0]} and {ran[1]}")
    return found
