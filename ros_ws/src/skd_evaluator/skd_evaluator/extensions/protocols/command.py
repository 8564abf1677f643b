"""`skd protocol`: the regulator's view, test speeds × impact places with a colour and the margin beside each."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from skd_sim.errors import UsageError

from skd_evaluator.assessment.options import AssessmentOptions
from skd_evaluator.cli.arguments import CAR_GROUP, Parser, result_folder, runner_of, speeds
from skd_evaluator.cli.output import EXIT_FAILED, EXIT_INTERRUPTED, finish, say
from skd_evaluator.extensions.protocols.matrices import NCAP, REGULATIONS, ProtocolMatrix, known_scenarios

if TYPE_CHECKING:
    from skd_evaluator.extensions.protocols.evaluation import ProtocolRequest
    from skd_evaluator.extensions.protocols.result import Grid, ProtocolResult

SCENARIOS = "cpna,cpfa,cpnco"
TRIALS = 5


def add_protocol(parser: Parser) -> None:
    """Run the tests of Euro NCAP, UN R152 or FMVSS 127: passed or failed, and the margin of each.

    Run a protocol's static tests, test speeds × impact places, in which the target does what the protocol prescribes.
    Each cell has the impact speed, its colour or verdict, and the safety margin. So a test that is passed with little
    room stands out. The exit code is 1 where a regulation is failed. This is no official rating (docs/campaigns.md).
    """
    parser.set_defaults(group="rate")
    names = "ncap (Euro NCAP 2026), r152, r152_first (UN R152: second and first step) or fmvss127"
    parser.add_argument("protocol", choices=(NCAP, *REGULATIONS), metavar="NAME", help=names)
    tests = parser.add_argument_group(CAR_GROUP)
    cars = "the car under test: basic, cal, carla, a registered name, file.py:Class or package.module:Class"
    tests.add_options(CAR_GROUP, controller={"help": f"{cars} (default: basic)"})
    text = f"of ncap: scenarios with impact places, names or files, with commas in between (default: {SCENARIOS})"
    scenarios = tests.add_argument("--scenarios", metavar="LIST", help=text)
    scenarios.names = known_scenarios  # type: ignore[attr-defined]  # which a shell completes
    text = "test speeds of the car, km/h, as 10:60:10 (default: those of each table)"
    tests.add_argument("--speeds", type=speeds, metavar="FROM:TO:STEP", help=text)
    margins = parser.add_argument_group("margins")
    margins.add_options(table=AssessmentOptions)
    trials = f"how many trials there are in each cell, each with draws of its own (default: {TRIALS})"
    margins.add_options("campaign", kamikaze_count={"default": TRIALS, "help": trials})
    parser.add_runner()
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.assessment.stages.checks import fresh_process, repeatability
    from skd_evaluator.assessment.stages.margin import warm_up_margins
    from skd_evaluator.extensions.protocols.evaluation import evaluated_grid, log_warnings
    from skd_evaluator.extensions.protocols.page import print_result
    from skd_evaluator.extensions.protocols.result import PAGE, RESULT, as_data
    from skd_evaluator.metrics.aborted import not_credible
    from skd_evaluator.provenance import provenance
    from skd_evaluator.report.progress import progress_bar

    sources = sources_of(arguments)
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
        print_result(_found(arguments.protocol, request, grids))
        shown = f"{len(grids)} of {len(sources)} scenarios"
        say("protocol", f"interrupted; nothing was written. What is above is of {shown}; the same command begins anew")
        return EXIT_INTERRUPTED
    warnings = log_warnings(logs)
    if not (car := request.plan.car).is_own:
        warnings = [*repeatability(car.controller, logs, fresh_process), *warnings]
    found = replace(_found(arguments.protocol, request, grids), warnings=tuple(warnings))
    content = {**as_data(found), "provenance": provenance(arguments.command_line, request.plan.car)}

    def write(folder: Path) -> None:
        from skd_evaluator.extensions.protocols.page import render  # slow to import, and needed only now

        write_json(folder / RESULT, content)
        (folder / PAGE).write_text(render(found), encoding="utf-8")

    problem = out.save(write)

    def show() -> None:
        print_result(found)
        if not problem:
            print(f"results in {out.path}")

    touched = [cell.touched for grid in grids for cell in grid.cells]
    failures = [problem, "no test could be evaluated" if set(touched) <= {None} else None]
    code = finish(arguments, content, show, found.warnings, failures)
    return EXIT_FAILED if not_credible(found.warnings) or found.is_failed else code


def sources_of(arguments: argparse.Namespace) -> Sequence[str | ProtocolMatrix]:
    """Return the scenarios of Euro NCAP that are requested, or the series of a regulation that have a test.

    Raises:
        UsageError: there are none, or scenarios of another protocol.
    """
    name, speeds = arguments.protocol, arguments.speeds
    if name == NCAP:
        return names_in(SCENARIOS if arguments.scenarios is None else arguments.scenarios)
    if arguments.scenarios is not None:
        raise UsageError(f"--scenarios goes with {NCAP}: {name} has its own")
    every = REGULATIONS[name][1]
    series = [one for one in every if speeds is None or any(point.speed in speeds for point in one.points)]
    if not series:
        raise UsageError(f"--speeds: {name} has no test at these speeds")
    return series


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


def request_of(arguments: argparse.Namespace, sources: Sequence[str | ProtocolMatrix]) -> ProtocolRequest:
    """Return what is requested of every scenario, after all checks that can be made before any work.

    Raises:
        UsageError: there is no such scenario or car, or they do not go together.
    """
    from skd_sim.options.options import options_of, values_of
    from skd_sim.scenario.scenario_file import REGULATORY

    from skd_evaluator.assessment.from_options import check_car
    from skd_evaluator.assessment.options import CampaignOptions, GraphOptions
    from skd_evaluator.assessment.plan import Plan
    from skd_evaluator.extensions.protocols.evaluation import (
        ProtocolRequest,
        requested_tests,
        scenario_of,
        series_tests,
    )

    every = [
        (source.scenario, source, series_tests(source, arguments.speeds))
        if isinstance(source, ProtocolMatrix)
        else (source, *requested_tests(source, arguments.speeds))
        for source in sources
    ]
    source, matrix, cells = every[0]
    scenario = scenario_of(source, cells[0], matrix)
    unsaid = {one.name: one.unsaid for one in (*options_of(CampaignOptions), *options_of(GraphOptions))}
    values = {**unsaid, **vars(arguments), "objective": "deviation", "safe": REGULATORY, "safe_count": 1}
    checked = check_car(values, scenario, graph=False)
    period = None if checked.control_period == scenario.control_period else checked.control_period
    plan = Plan(scenario, **values_of(CampaignOptions, values))
    return ProtocolRequest(plan, period, arguments.speeds, arguments.margin_limit)


def _found(protocol: str, request: ProtocolRequest, grids: Sequence[Grid]) -> ProtocolResult:
    from skd_sim.start import installing

    from skd_evaluator.extensions.protocols.result import ProtocolResult, points_of, with_calculator
    from skd_evaluator.version import version

    plan, counts = request.plan, protocol == NCAP and with_calculator()
    return ProtocolResult(
        protocol=protocol,
        skd=version(),
        car=plan.car.label,
        seed=plan.seed,
        trials=plan.kamikaze_count,
        margin_limit=request.margin_limit,
        grids=tuple(grids),
        points=tuple(points_of(grids)) if counts else (),
        points_why=""
        if counts or protocol != NCAP
        else f"Euro NCAP's own calculator counts them, and is not installed: {installing('ncap')}",
    )
