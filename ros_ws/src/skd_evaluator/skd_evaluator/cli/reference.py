"""`skd scenarios reference`: margins of basic cars in a scenario, and the equivalent multiplier of a car in it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.table import Table
from skd_adversary.safe_trajectories.sources import count_safe_trajectories
from skd_sim.errors import UsageError
from skd_sim.options.adversary import Objective
from skd_sim.scenario.scenario import load_scenario
from skd_sim.scenario.scenario_file import REGULATORY

from skd_evaluator.assessment.files.assessment_json import ASSESSMENT
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.assessment.options import SYNTHETIC
from skd_evaluator.assessment.plan import Plan, Progress, safe_trajectories
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.cli.arguments import result_folder, runner_of
from skd_evaluator.cli.output import print_json
from skd_evaluator.margin.assessment_margin import warm_up_margins
from skd_evaluator.margin.reference import MULTIPLIERS, Asked, asked_of_result, equivalent_in, reference_sweep
from skd_evaluator.metrics.equivalent_multiplier import equivalent_entries
from skd_evaluator.metrics.margins import Margins
from skd_evaluator.report.formats import bounded, spoken_interval
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.report.terminal import narrow_table, print_table

RESULT = "reference.json"
_SYNTHETIC = 5
"""φ where a scenario has no protocol."""


def run(arguments: argparse.Namespace) -> int:
    """Run the action; return its exit code."""
    multipliers = sorted(set(arguments.multipliers or MULTIPLIERS))
    if arguments.margin_limit == 0:
        raise UsageError("--margin-limit 0: without margins there is no reference")
    results = [Path(name) for name in arguments.names if (Path(name) / ASSESSMENT).is_file()]
    for name in arguments.names:
        if Path(name) not in results:
            load_scenario(name)
    out = result_folder(arguments)
    entries, tables = [], []
    with runner_of(arguments) as runner:
        warm_up_margins()
        runner.start()
        with progress_bar(quiet=arguments.quiet) as progress:
            for name in arguments.names:
                asked = _asked(name, arguments, runner, progress)
                found = reference_sweep(asked, multipliers, runner, progress, arguments.margin_limit)
                entries.append(_entry(asked, found))
                tables.append(_table(found))
    content: dict[str, Any] = {"references": entries}
    out.write(lambda folder: write_json(folder / RESULT, content))
    if arguments.json:
        print_json(content)
        return 0
    for entry, table in zip(entries, tables, strict=True):
        print(f"{entry['name']}: basic cars, {entry['safe']} φ × {entry['trials']} trials")
        print_table(table)
        if text := entry.get("equivalent_multiplier_text"):
            text = bounded(entry, text)
            span = spoken_interval(entry, "equivalent_multiplier_ci95_text") or "(one φ, no interval)"
            print(f"The car has the margin of the basic car with C = {text} {span}")
    print(f"results in {out.path}")
    return 0


def _asked(name: str, arguments: argparse.Namespace, runner: Workers, progress: Progress) -> Asked:
    """Return where basic cars are compared: in the trials of an assessment, or on a scenario's own φ."""
    if (Path(name) / ASSESSMENT).is_file():
        result = read_result(Path(name))
        for line in result.remarks:
            print(f"skd scenarios: warning: {line}", file=sys.stderr)
        return asked_of_result(result)
    scenario = load_scenario(name)
    regulatory = scenario.protocol is not None
    plan = Plan(
        scenario,
        objective=Objective.DEVIATION,
        safe=REGULATORY if regulatory else SYNTHETIC,
        safe_count=count_safe_trajectories(REGULATORY, scenario) if regulatory else _SYNTHETIC,
        kamikaze_count=arguments.trials,
        seed=arguments.seed,
    )
    return Asked(name, plan, safe_trajectories(plan, runner, progress))


def _entry(asked: Asked, found: Mapping[float, Margins]) -> dict[str, Any]:
    rows = [
        {"multiplier": multiplier, **margins.figures(), "margins": [one.tolist() for one in margins.per_phi]}
        for multiplier, margins in found.items()
    ]
    about = {"name": asked.name, "scenario": asked.plan.scenario.name, "seed": asked.plan.seed}
    compared: dict[str, Any] = {}
    if asked.result is not None:
        compared = {"margin_converged": asked.result.figures["margin_converged"]}
        compared |= equivalent_entries(equivalent_in(asked, found))
    return {**about, "safe": len(asked.safe), "trials": asked.plan.kamikaze_count, "rows": rows, **compared}


def _table(found: Mapping[float, Margins]) -> Table:
    table = narrow_table("")
    table.title = None  # which would be no wider than these columns
    for name in ("C", "margin (m)", "95 % by φ", "never hit", ""):
        table.add_column(name, justify="right" if name else "left")
    for multiplier, margins in found.items():
        span = margins.ci95
        around = "–" if span is None else f"[{span[0]:.2f}, {span[1]:.2f}]"
        how = "exact" if margins.exact else "" if margins.converged else "not converged: an upper bound"
        table.add_row(f"{multiplier:g}", f"{margins.mean:.2f}", around, f"{margins.beyond}", f" {how}")
    return table
