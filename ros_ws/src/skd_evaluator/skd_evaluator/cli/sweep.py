"""`skd sweep`: the paper's experiment, SKD and contact rate against the multiplier C."""

from __future__ import annotations

import argparse
import csv
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from skd_sim.controllers.basic import PAPER_MULTIPLIERS
from skd_sim.errors import UsageError
from skd_sim.options.adversary import objectives_named

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context
from skd_evaluator.assessment.figure_table import columns
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.from_options import plan_of, scenario_for
from skd_evaluator.assessment.options import OWN, SYNTHETIC, WALKERS
from skd_evaluator.assessment.stages.pipeline import run_stages, start_workers
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.cli.arguments import result_folder, runner_of
from skd_evaluator.cli.assess import EXIT_INTERRUPTED
from skd_evaluator.cli.output import print_json
from skd_evaluator.provenance import provenance
from skd_evaluator.report.presentation import fill, warnings_of, why_failed
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.report.tables import sweep_table
from skd_evaluator.report.terminal import print_table

_RECORDED = "recorded"
_COLUMNS = ("kind", "multiplier", *columns("sweep"))
_SPEARMAN = {
    "margin": "margin",
    "deviation": "deviation", "skd": "SKD", "skd_prefix": "prefix distance", "contact_rate": "contact rate",
}  # fmt: skip


def _row(kind: str, assessment: Assessment) -> dict[str, Any]:
    result = assessment.as_dict()
    return {"kind": kind, **{name: result[name] for name in _COLUMNS[1:]}}


def _spearman(rows: list[dict[str, Any]], value: str) -> float | None:
    """Return Spearman's ρ between C and a figure; none where fewer than three are known, or all are the same."""
    known = [(row["multiplier"], row[value]) for row in rows if row[value] is not None]
    if len(known) < 3 or len({figure for _, figure in known}) == 1:
        return None
    from scipy.stats import spearmanr  # slow to import

    multipliers, values = zip(*known, strict=True)
    return float(spearmanr(multipliers, values).statistic)


def _folder_name(multiplier: float) -> str:
    return f"C_{multiplier:.12g}"


def _write_csv(path: Path, rows: list[dict[str, Any]]) -> None:
    flat = [
        {key: " ".join(map(repr, cell)) if isinstance(cell, (list, tuple)) else cell for key, cell in row.items()}
        for row in rows
    ]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, _COLUMNS)
        writer.writeheader()
        writer.writerows(flat)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    begin = time.perf_counter()
    multipliers = arguments.multipliers or PAPER_MULTIPLIERS
    if len(set(map(_folder_name, multipliers))) < len(multipliers):
        raise UsageError("--multipliers: a value is given twice")
    if arguments.safe == OWN:
        raise UsageError("--safe own goes with skd assess, for one car; give a path to recorded safe trajectories")
    kinds = {"synthetic": SYNTHETIC}
    if arguments.safe not in (None, SYNTHETIC):
        kinds[WALKERS if arguments.safe == WALKERS else _RECORDED] = arguments.safe
    plans = {
        kind: plan_of(vars(arguments), scenario_for(None, safe), safe=safe, multiplier=multipliers[0])
        for kind, safe in kinds.items()
    }
    out = result_folder(arguments)
    objectives = objectives_named(arguments.objective)
    asked = plans["synthetic"]
    origin = provenance(arguments.command_line, asked.car)
    risk = risk_request(arguments.behaviour, arguments.risk_runs, subset=arguments.risk_subset)
    assessments: list[tuple[str, Assessment]] = []
    try:
        with runner_of(arguments) as runner:
            # Recorded ones are read first: bad input is said before anything is compiled.
            safe_by_kind = {kind: safe_trajectories(plans[kind], runner) for kind in kinds if kind == _RECORDED}
            context = Context(runner, runner, objectives, arguments.margin_limit, risk=risk)
            start_workers(context, asked)
            with progress_bar(quiet=arguments.quiet) as progress:
                for kind, plan in plans.items():
                    safe = safe_by_kind.get(kind) or safe_trajectories(plan, runner, progress)
                    for number, value in enumerate(multipliers, start=1):
                        label = f"{kind} {number}/{len(multipliers)}"

                        def labelled(stage: str, done: int, total: int, label: str = label) -> None:
                            progress(f"{label} {stage.split()[0]}", done, total)

                        car = replace(plan, multiplier=value)
                        begun = Assessment(car, tuple(safe), provenance=origin)
                        assessments.append((kind, run_stages(replace(context, progress=labelled), begun)))
    except KeyboardInterrupt:
        if not assessments:
            raise
        print_table(sweep_table([_row(kind, assessment) for kind, assessment in assessments]))
        cars = f"{len(assessments)} of {len(plans) * len(multipliers)} cars"
        print(
            f"skd sweep: interrupted; nothing was written. What is above is of {cars}; the same command begins anew "
            "and gives the same",
            file=sys.stderr,
        )
        return EXIT_INTERRUPTED
    rows = [_row(kind, assessment) for kind, assessment in assessments]
    spearman = {
        kind: {value: _spearman([row for row in rows if row["kind"] == kind], value) for value in _SPEARMAN}
        for kind in kinds
    }
    seconds = time.perf_counter() - begin
    summary = {
        "rows": rows,
        "spearman_with_multiplier": spearman,
        "seed": arguments.seed,
        "seconds": round(seconds, 3),
        "provenance": origin,
    }

    def write(folder: Path) -> None:
        from skd_evaluator.report.charts import save_sweep

        for kind, assessment in assessments:
            part = folder / kind / _folder_name(assessment.plan.multiplier)
            part.mkdir(parents=True)
            fill(part, assessment)
        write_json(folder / "sweep.json", summary)
        _write_csv(folder / "sweep.csv", rows)
        save_sweep(folder / "sweep.png", rows)

    problem = out.save(write)
    if arguments.json:
        print_json(summary)
    else:
        print_table(sweep_table(rows))
        for kind, rho in spearman.items():
            known = [f"{name} {rho[key]:.3f}" for key, name in _SPEARMAN.items() if rho[key] is not None]
            if known:
                print(f"{kind}: Spearman's ρ with C: {', '.join(known)}")
        if _RECORDED not in kinds:
            print("Recorded safe trajectories were not asked for: add --safe PATH (docs/validation.md).")
        taken = f"{seconds:.1f} s"
        print(taken if problem else f"{taken}; results in {out.path}")
    for kind, assessment in assessments:
        for line in warnings_of(assessment, planned=False):
            print(f"skd sweep: warning: {kind}, C = {assessment.plan.multiplier:g}: {line}", file=sys.stderr)
    failures = [problem] if problem else []
    for kind, assessment in assessments:
        failures += [
            f"{kind}, C = {assessment.plan.multiplier:g}: {why}"
            for why in why_failed(assessment, arguments.max_aborted)
        ]
    for why in failures:
        print(f"skd sweep: {why}", file=sys.stderr)
    return 1 if failures else 0
