"""`skd ncap`: the regulator's view, test speeds × impact places with 2026's colours and the margin beside each."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from skd_sim.errors import UsageError
from skd_sim.options.options import options_of, values_of
from skd_sim.scenario.scenario_file import REGULATORY
from skd_sim.start import installing
from skd_sim.world.episode import EpisodeLog

from skd_evaluator.assessment.files.result_folder import write_json
from skd_evaluator.assessment.from_options import check_car
from skd_evaluator.assessment.options import CampaignOptions, GraphOptions
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.stages.checks import fresh_process, repeatability
from skd_evaluator.assessment.stages.margin import warm_up_margins
from skd_evaluator.cli.arguments import result_folder, runner_of
from skd_evaluator.cli.output import finish, say
from skd_evaluator.cli.parser import EXIT_INTERRUPTED
from skd_evaluator.extensions.ncap.evaluation import (
    NcapRequest,
    evaluated_grid,
    log_warnings,
    requested_tests,
    scenario_of,
)
from skd_evaluator.extensions.ncap.layout import print_ncap
from skd_evaluator.extensions.ncap.result import (
    PAGE,
    RESULT,
    Grid,
    Ncap,
    as_data,
    points_of,
    with_calculator,
)
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.provenance import provenance
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.version import version


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    sources = names_in(arguments.scenarios)
    request = request_of(arguments, sources)
    out = result_folder(arguments)
    grids: list[Grid] = []
    logs: list[EpisodeLog] = []
    try:
        with runner_of(arguments, isolated=request.plan.runs_others_code) as runner:
            if request.margin_limit:
                warm_up_margins()
            runner.start()
            with progress_bar(quiet=arguments.quiet) as progress:
                for source in sources:
                    grid, tests = evaluated_grid(source, request, runner, progress)
                    grids.append(grid)
                    logs += tests
    except KeyboardInterrupt:
        if not grids:
            raise
        print_ncap(_found(request, grids))
        shown = f"{len(grids)} of {len(sources)} scenarios"
        say("ncap", f"interrupted; nothing was written. What is above is of {shown}; the same command begins anew")
        return EXIT_INTERRUPTED
    warnings = log_warnings(logs)
    if not (car := request.plan.car).is_own:
        warnings = [*repeatability(car.controller, logs, fresh_process), *warnings]
    found = replace(_found(request, grids), warnings=tuple(warnings))
    content = {**as_data(found), "provenance": provenance(arguments.command_line, request.plan.car)}

    def write(folder: Path) -> None:
        from skd_evaluator.extensions.ncap.page import render  # slow to import, and needed only now

        write_json(folder / RESULT, content)
        (folder / PAGE).write_text(render(found), encoding="utf-8")

    problem = out.save(write)

    def show() -> None:
        print_ncap(found)
        if not problem:
            print(f"results in {out.path}")

    failures = [problem, None if any(_is_evaluated(grid) for grid in grids) else "no test could be evaluated"]
    code = finish(arguments, content, show, found.warnings, failures)
    return 1 if not_credible(found.warnings) else code


def names_in(text: str) -> list[str]:
    """Return the scenarios of a list with commas in between.

    Raises:
        UsageError: it is empty, or one is there twice.
    """
    (names,) = csv.reader([text]) if text.strip() else ([],)
    found = [name.strip() for name in names]
    if not found or not all(found) or len(set(found)) < len(found):
        raise UsageError(f"--scenarios must be different names with commas in between, as cpna,cpnco; got {text!r}")
    return found


def request_of(arguments: argparse.Namespace, sources: Sequence[str]) -> NcapRequest:
    """Return what is requested of every scenario, after all checks that can be made before any work.

    Raises:
        UsageError: there is no such scenario or car, or they do not go together.
    """
    every = [(source, *requested_tests(source, arguments.speeds)) for source in sources]
    source, matrix, cells = every[0]
    scenario = scenario_of(source, cells[0], matrix)
    unsaid = {one.name: one.unsaid for one in (*options_of(CampaignOptions), *options_of(GraphOptions))}
    values = {**unsaid, **vars(arguments), "objective": "deviation", "safe": REGULATORY, "safe_count": 1}
    checked = check_car(values, scenario, graph=False)
    period = None if checked.control_period == scenario.control_period else checked.control_period
    plan = Plan(scenario, **values_of(CampaignOptions, values))
    return NcapRequest(plan, period, arguments.speeds, arguments.margin_limit)


def _is_evaluated(grid: Grid) -> bool:
    return any(cell.touched is not None for cell in grid.cells)


def _found(request: NcapRequest, grids: Sequence[Grid]) -> Ncap:
    plan, counts = request.plan, with_calculator()
    car = f"{plan.controller}, C = {plan.multiplier:g}" if plan.car.has_multiplier else plan.controller
    return Ncap(
        skd=version(),
        car=car,
        seed=plan.seed,
        trials=plan.kamikaze_count,
        margin_limit=request.margin_limit,
        grids=tuple(grids),
        points=tuple(points_of(grids)) if counts else (),
        points_why=""
        if counts
        else f"Euro NCAP's own calculator counts them, and is not installed: {installing('ncap')}",
    )
