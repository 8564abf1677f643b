"""`skd ncap`: the regulator's view, test speeds × impact places with 2026's colours and the margin beside each."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from skd_sim.errors import UsageError

from skd_evaluator.assessment.options import AssessmentOptions
from skd_evaluator.cli.arguments import (
    CAR_GROUP,
    add_options,
    add_output_arguments,
    add_runner_arguments,
    result_folder,
    runner_of,
    steps_of,
)
from skd_evaluator.cli.output import finish, say
from skd_evaluator.cli.parser import EXIT_INTERRUPTED, Parser
from skd_evaluator.extensions.ncap.matrices import known_scenarios

if TYPE_CHECKING:
    from skd_evaluator.extensions.ncap.evaluation import NcapRequest
    from skd_evaluator.extensions.ncap.result import Grid, Ncap

SCENARIOS = "cpna,cpfa,cpnco"
TRIALS = 5


def add_ncap(parser: Parser) -> None:
    """Run a regulator's tests: colours of Euro NCAP 2026, and the margin of each.

    Run the static tests of Euro NCAP 2026, test speeds × impact places, in which the target does what the protocol
    prescribes. Each cell has the impact speed, its colour, and the safety margin. So a test that is passed with little
    room stands out. This is not an official rating (docs/campaigns.md).
    """
    parser.set_defaults(group="rate")
    tests = parser.add_argument_group(CAR_GROUP)
    cars = "the car under test: basic, cal, carla, a registered name, file.py:Class or package.module:Class"
    add_options(tests, "ncap", CAR_GROUP, controller={"help": f"{cars} (default: basic)"})
    text = "scenarios with impact places, names or files, with commas in between (default: %(default)s)"
    scenarios = tests.add_argument("--scenarios", default=SCENARIOS, metavar="LIST", help=text)
    scenarios.names = known_scenarios  # type: ignore[attr-defined]  # which a shell completes
    text = "test speeds of the car, km/h, as 10:60:10 (default: those of each scenario's matrix)"
    tests.add_argument("--speeds", type=steps_of("km/h", 0.0, 200.0), metavar="FROM:TO:STEP", help=text)
    margins = parser.add_argument_group("margins")
    add_options(margins, "ncap", table=AssessmentOptions)
    trials = f"how many trials there are in each cell, each with draws of its own (default: {TRIALS})"
    add_options(margins, "ncap", "campaign", kamikaze_count={"default": TRIALS, "help": trials})
    add_runner_arguments(parser)
    add_output_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.assessment.stages.checks import fresh_process, repeatability
    from skd_evaluator.assessment.stages.margin import warm_up_margins
    from skd_evaluator.extensions.ncap.evaluation import evaluated_grid, log_warnings
    from skd_evaluator.extensions.ncap.layout import print_ncap
    from skd_evaluator.extensions.ncap.result import PAGE, RESULT, as_data
    from skd_evaluator.metrics.aborted import not_credible
    from skd_evaluator.provenance import provenance
    from skd_evaluator.report.progress import progress_bar

    sources = names_in(arguments.scenarios)
    request = request_of(arguments, sources)
    out = result_folder(arguments)
    grids: list[Grid] = []
    logs = []
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

    touched = [cell.touched for grid in grids for cell in grid.cells]
    failures = [problem, "no test could be evaluated" if set(touched) <= {None} else None]
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
    from skd_sim.options.options import options_of, values_of
    from skd_sim.scenario.scenario_file import REGULATORY

    from skd_evaluator.assessment.from_options import check_car
    from skd_evaluator.assessment.options import CampaignOptions, GraphOptions
    from skd_evaluator.assessment.plan import Plan
    from skd_evaluator.extensions.ncap.evaluation import NcapRequest, requested_tests, scenario_of

    every = [(source, *requested_tests(source, arguments.speeds)) for source in sources]
    source, matrix, cells = every[0]
    scenario = scenario_of(source, cells[0], matrix)
    unsaid = {one.name: one.unsaid for one in (*options_of(CampaignOptions), *options_of(GraphOptions))}
    values = {**unsaid, **vars(arguments), "objective": "deviation", "safe": REGULATORY, "safe_count": 1}
    checked = check_car(values, scenario, graph=False)
    period = None if checked.control_period == scenario.control_period else checked.control_period
    plan = Plan(scenario, **values_of(CampaignOptions, values))
    return NcapRequest(plan, period, arguments.speeds, arguments.margin_limit)


def _found(request: NcapRequest, grids: Sequence[Grid]) -> Ncap:
    from skd_sim.start import installing

    from skd_evaluator.extensions.ncap.result import Ncap, points_of, with_calculator
    from skd_evaluator.version import version

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
