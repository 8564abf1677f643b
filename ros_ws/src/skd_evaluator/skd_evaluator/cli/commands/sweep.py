"""`skd sweep`: the paper's experiment, SKD and contact rate against the multiplier C."""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skd_sim.errors import UsageError

from skd_evaluator.assessment.options import OWN, SYNTHETIC, WALKERS
from skd_evaluator.cli.arguments import CAR_GROUP, Parser, real_number, result_folder, runner_of
from skd_evaluator.cli.output import EXIT_INTERRUPTED, finish, say

if TYPE_CHECKING:
    from skd_evaluator.assessment.assessment import Assessment

_RECORDED = "recorded"
_SPEARMAN = {
    "margin": "margin",
    "deviation": "deviation", "skd": "SKD", "skd_prefix": "prefix distance", "contact_rate": "contact rate",
}  # fmt: skip


def _row(kind: str, assessment: Assessment) -> dict[str, Any]:
    from skd_evaluator.assessment.figure_table import columns

    result = assessment.as_dict()
    return {"kind": kind, **{name: result[name] for name in ("multiplier", *columns("sweep"))}}


def add(parser: Parser) -> None:
    """Repeat the paper's experiment: rate the basic car with nine multipliers C.

    Repeat the paper's experiment: margin, SKD and contact rate of the basic car with each multiplier C. The safe
    trajectories are synthetic ones, and those of --safe, if given.
    """
    parser.set_defaults(group="research", rare=True)
    text = "walkers, or recorded ones: CITR's vci_lat_uni, a csv file with columns t, x, y, or a folder"
    parser.add_value("--safe", text, metavar="SOURCE")
    text = "rate the basic car with these multipliers C instead of the paper's nine (0.5 to 1.15)"
    parser.add_value("--multipliers", text, type=real_number(0.0, 100.0), nargs="+", metavar="C")
    parser.add_options(CAR_GROUP)
    # The paper's numbers; for a rating more φ say more than more trials on each.
    counts = {"safe_count": (5, "safe trajectories (φ) there are of each kind")}
    counts["kamikaze_count"] = 100, "kamikazes are planned for each safe trajectory"
    paper = {
        name: {"default": count, "help": f"how many {what} (default: {count})"}
        for name, (count, what) in counts.items()
    }
    parser.add_campaign(**paper)


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


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_sim.controllers.basic import PAPER_MULTIPLIERS
    from skd_sim.options.car_and_adversary import objectives_named

    from skd_evaluator.assessment.assessment import Assessment
    from skd_evaluator.assessment.context import Context
    from skd_evaluator.assessment.files.result_folder import csv_text, write_json
    from skd_evaluator.assessment.from_options import plan_of, scenario_for
    from skd_evaluator.assessment.stages.pipeline import run_stages, start_workers
    from skd_evaluator.assessment.stages.risk import risk_request
    from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
    from skd_evaluator.provenance import provenance
    from skd_evaluator.report.presentation import fill
    from skd_evaluator.report.progress import progress_bar
    from skd_evaluator.report.terminal import print_table, sweep_table
    from skd_evaluator.report.warnings import warnings_of, why_failed

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
        say("sweep", f"interrupted; nothing was written. What is above is of {cars}; the same command begins anew")
        return EXIT_INTERRUPTED
    rows = [_row(kind, assessment) for kind, assessment in assessments]
    spearman = {
        kind: {value: _spearman([row for row in rows if row["kind"] == kind], value) for value in _SPEARMAN}
        for kind in kinds
    }
    summary = {
        "rows": rows,
        "spearman_with_multiplier": spearman,
        "seed": arguments.seed,
        "seconds": round(time.perf_counter() - begin, 3),
        "provenance": origin,
    }

    def write(folder: Path) -> None:
        from skd_evaluator.report.charts import save_sweep

        for kind, assessment in assessments:
            part = folder / kind / _folder_name(assessment.plan.multiplier)
            part.mkdir(parents=True)
            fill(part, assessment)
        write_json(folder / "sweep.json", summary)
        (folder / "sweep.csv").write_text(csv_text(rows, list(rows[0])), encoding="utf-8")
        save_sweep(folder / "sweep.png", rows)

    def show() -> None:
        print_table(sweep_table(rows))
        for kind, rho in spearman.items():
            known = [f"{name} {rho[key]:.3f}" for key, name in _SPEARMAN.items() if rho[key] is not None]
            if known:
                print(f"{kind}: Spearman's ρ with C: {', '.join(known)}")
        if _RECORDED not in kinds:
            print("Recorded safe trajectories were not requested: add --safe PATH (docs/validation.md).")

    saved = out.save(write), f"results in {out.path}"
    warnings, failures = list[str](), list[str | None]()
    for kind, one in assessments:
        name = f"{kind}, C = {one.plan.multiplier:g}"
        warnings += [f"{name}: {line}" for line in warnings_of(one)]
        failures += [f"{name}: {why}" for why in why_failed(one, arguments.max_aborted)]
    return finish(arguments, summary, show, warnings, failures, saved=saved, since=begin)
