"""Assessments from Python: what `skd assess` does in process, and results read back, with tables for notebooks."""

from __future__ import annotations

import threading
import time
import warnings
from contextlib import closing, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from skd_sim.options.car_and_adversary import objectives_named
from skd_sim.options.options import option, options_of, read_options

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Progress, silent
from skd_evaluator.assessment.files.result_folder import ResultFolder
from skd_evaluator.assessment.files.results import StoredResult, read_result
from skd_evaluator.assessment.from_options import check_car, plan_of, scenario_for
from skd_evaluator.assessment.options import (
    MAXIMUM_ABORTED,
    MOST_WORKERS,
    AssessmentOptions,
    CampaignOptions,
    GraphOptions,
)
from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers
from skd_evaluator.assessment.stages.checks import fresh_process
from skd_evaluator.assessment.stages.pipeline import assess_in_process
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.metrics.aborted import aborted_lines, not_credible
from skd_evaluator.provenance import provenance
from skd_evaluator.report.presentation import fill
from skd_evaluator.report.warnings import why_failed, with_failures

_COMMAND = ("skd_evaluator.assess",)
_ONE_AT_A_TIME = threading.RLock()
"""Held by the assessment that runs: one forks workers, which would inherit what another one is in the middle of."""


@dataclass(frozen=True)
class _CallOptions:
    """The table of what a call has beside the options of an assessment."""

    scenario: str | None = option(None, "name or file of the scenario", str)
    workers: int | None = option(None, "number of processes", int, within=(1, MOST_WORKERS))
    max_aborted: float = option(100.0 * MAXIMUM_ABORTED, "percentage that may be aborted", within=(0.0, 100.0))


def assess(
    controller: str = "basic",
    *,
    scenario: str | None = None,
    out: str | Path | None = None,
    workers: int | None = None,
    max_aborted: float = 100.0 * MAXIMUM_ABORTED,
    progress: Progress | None = None,
    **options: Any,
) -> Assessment:
    """Assess a car in process, as `skd assess` does: the same options give the same numbers.

    Worker processes are started: a script calls this below `if __name__ == "__main__":`. Asked by several threads,
    assessments run one after another; what makes one faster is `workers`.

    Args:
        controller: a shipped one, or `package.module:Class` of yours, importable.
        scenario: a shipped one or a YAML file; by default the one that goes with the safe trajectories.
        out: folder for the results, which is not there yet; by default nothing is written.
        workers: number of processes; by default one for each core.
        max_aborted: percentage of the episodes that may be aborted, of all and of those of each figure. An aborted
            episode says nothing about the car; if more are aborted, the figures are not credible.
        progress: called with what is being done, how much of it is done, and out of how much; by default nothing is
            called.
        options: others of `skd assess` that say what is assessed, under their names with `_` for `-`: `multiplier`,
            `safe`, `safe_count`, `kamikaze_count`, `collision_runs`, `adversary_model`, `seed`, `margin_limit`,
            `curve`, `behaviour`, …

    Returns:
        The assessment; `as_dict()` has the figures of assessment.json under their names. Why these may be those of
        another car, what aborted episodes may hide, and whatever else makes `skd assess` end with exit code 1, is a
        warning of Python's, and one of its `warnings`.

    Raises:
        UsageError: an argument is not allowed, or does not go with the others, or an option does not exist.
        AssessmentError: the car could not be assessed.
    """
    given = {**options, "controller": controller, "scenario": scenario, "workers": workers, "max_aborted": max_aborted}
    tables = (CampaignOptions, AssessmentOptions, _CallOptions)
    read = read_options(given, "assess", *tables)
    values = {one.name: one.unsaid for table in (*tables, GraphOptions) for one in options_of(table)}
    values |= {name: value for name, value in read.items() if value is not None}
    with _ONE_AT_A_TIME:
        begin = time.perf_counter()
        plan = plan_of(values, scenario_for(scenario, values["safe"]))
        origin = provenance(_COMMAND, plan.car)
        plan = replace(plan, scenario=check_car(values, plan.scenario, graph=False))
        objectives = objectives_named(values["objective"])
        risk = risk_request(values["behaviour"], values["risk_runs"], subset=values["risk_subset"])
        with nullcontext() if out is None else closing(ResultFolder(Path(out).expanduser())) as folder:
            runner = InProcessRunner(workers or available_workers(), isolated=plan.runs_others_code)
            context = Context(
                runner,
                runner,
                objectives,
                values["margin_limit"],
                values["curve"],
                values["reference"],
                risk=risk,
                progress=progress or silent,
                fresh=fresh_process,
                earlier=load_result(values["warm_start"]) if values["warm_start"] else None,
            )
            assessment = assess_in_process(context, Assessment(plan, provenance=origin))
            seconds, failed = time.perf_counter() - begin, with_failures(assessment, values["max_aborted"] / 100.0)
            assessment = replace(failed, seconds=seconds)
            if folder is not None:
                folder.write(lambda where: fill(where, assessment))
    said = [*not_credible(assessment.warnings), *why_failed(assessment, 1.0), *aborted_lines(assessment.as_dict())]
    for line in dict.fromkeys(said):
        warnings.warn(line, stacklevel=2)
    return assessment


def load_result(folder: str | Path) -> StoredResult:
    """Read an assessment from its folder; it is refused unless its figures follow from its episodes.

    `to_dataframe()` has its episodes, `to_xarray()` their trajectories, and a notebook shows its figures.

    Raises:
        UsageError: there is none, or it contradicts itself.
    """
    return read_result(Path(folder).expanduser())
