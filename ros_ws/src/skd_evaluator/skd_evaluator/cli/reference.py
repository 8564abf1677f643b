"""`skd scenarios reference`: margins of basic cars of several C, and the equivalent multiplier of a car among them.

Where these margins are exact the equivalent multiplier needs none of it (`basic_margins.py`). Elsewhere they are
searched for, as that of the car under test is: both are upper bounds, found by the same search. The basic cars are the
paper's, which decide once a tick; on a road with curves they move as the car under test.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table
from skd_adversary.safe_trajectories.sources import count_safe_trajectories
from skd_sim.errors import UsageError
from skd_sim.options.adversary import Objective
from skd_sim.scenario.scenario import load_scenario, scenario_from_dict
from skd_sim.scenario.scenario_file import REGULATORY
from skd_sim.world.episode import Mode
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.context import Progress
from skd_evaluator.assessment.files.assessment_json import ASSESSMENT
from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.files.results import StoredResult, read_result
from skd_evaluator.assessment.options import SYNTHETIC
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import Workers
from skd_evaluator.assessment.stages.margin import minimal_deviations, warm_up_margins
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.cli.arguments import result_folder, runner_of
from skd_evaluator.cli.output import print_json
from skd_evaluator.margin.basic_margins import yardstick
from skd_evaluator.metrics.equivalent_multiplier import EquivalentMultiplier, equivalent_entries, equivalent_multiplier
from skd_evaluator.metrics.margins import Margins
from skd_evaluator.report.formats import bounded, spoken_interval
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.report.terminal import narrow_table, print_table

MULTIPLIERS = (0.5, 0.75, 1.0, 1.25, 1.5)


@dataclass(frozen=True, eq=False)
class ReferenceTrials:
    """Where basic cars are compared.

    Attributes:
        name: of the scenario, or the folder of the assessment.
        plan: of the trials; its `kamikaze_count` is how many there are on each φ.
        safe: Φ.
        result: the assessment whose car is compared with them; None: no car is.
    """

    name: str
    plan: Plan
    safe: Sequence[Trajectory]
    result: StoredResult | None = None


def asked_of_result(result: StoredResult) -> ReferenceTrials:
    """Return the trials in which an assessment has margins.

    Raises:
        UsageError: it has none.
    """
    groups = result.groups.get("margin", ())
    if not groups:
        raise UsageError(f"{result.folder}: has no margin to compare with those of basic cars")
    scenario = scenario_from_dict(result.figures["scenario"], f"scenario in {result.folder / ASSESSMENT}")
    count = min(len(one) for one in groups)
    plan = Plan(scenario, objective=Objective.DEVIATION, seed=int(result.figures["seed"]), kamikaze_count=count)
    safe = [Trajectory(one, scenario.time_step, f"φ {number}") for number, one in enumerate(result.safe)]
    return ReferenceTrials(str(result.folder), plan, safe, result)


def reference_sweep(
    asked: ReferenceTrials, multipliers: Sequence[float], runner: Workers, progress: Progress, limit: int
) -> dict[float, Margins]:
    """Return the margins of the basic cars with some C.

    Args:
        asked: where.
        multipliers: the C.
        runner: computes margins, in several processes.
        progress: called with how far the work is.
        limit: candidates that may be driven in a trial.
    """
    found = {}
    for multiplier in multipliers:
        plan = yardstick(asked.plan, multiplier)
        count = plan.kamikaze_count
        episodes = [
            plan.episode(Mode.KAMIKAZE, index, trial, phi)
            for index, phi in enumerate(asked.safe)
            for trial in range(count)
        ]

        def told(_label: str, done: int, total: int, multiplier: float = multiplier) -> None:
            progress(f"{asked.name}, C = {multiplier:g}", done, total)

        hits, search = minimal_deviations(episodes, {}, runner, told, limit)
        grouped = tuple(tuple(hits[start : start + count]) for start in range(0, len(episodes), count))
        found[multiplier] = Margins(grouped, plan.scenario.eta_max, search)
    return found


def equivalent_in(asked: ReferenceTrials, basic: Mapping[float, Margins]) -> EquivalentMultiplier | None:
    """Return the C of the basic car that has the margin of the assessment's car; None without an assessment."""
    if asked.result is None or len(basic) < 2:
        return None
    return equivalent_multiplier(asked.result.groups["margin"], {one: found.per_phi for one, found in basic.items()})


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


def _asked(name: str, arguments: argparse.Namespace, runner: Workers, progress: Progress) -> ReferenceTrials:
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
    return ReferenceTrials(name, plan, safe_trajectories(plan, runner, progress))


def _entry(asked: ReferenceTrials, found: Mapping[float, Margins]) -> dict[str, Any]:
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
