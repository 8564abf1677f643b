"""`skd replay`: the assessment from recorded episodes, offline."""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

from skd_sim.errors import UsageError

from skd_evaluator.assessment.options import AssessmentOptions
from skd_evaluator.cli.arguments import DETAILS, Parser, positive_number, rare, result_folder
from skd_evaluator.cli.gate import Gate, add_gate_arguments, gate_of


def add(parser: Parser) -> None:
    """Rate a car from recorded episodes (MCAP logs).

    Rate a car from recorded episodes, offline, recorded by SKD or by ros2 bag record.
    """
    parser.set_defaults(group="rate")
    parser.add_paths("PATH", "a bag folder, an .mcap file, or a folder of them")
    parser.add_value("--campaign", "which campaign to rate, if the bags hold several", metavar="NAME")
    text = "leave out each kamikaze that ended further than this many metres from its safe trajectory"
    parser.add_value("--maximum-distance", rare(text), type=positive_number, metavar="M")
    parser.add_max_aborted()
    parser.add_options(table=AssessmentOptions)
    parser.add_skip_damaged()
    parser.add_flag("--details", DETAILS)
    add_gate_arguments(parser)
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    gate = gate_of(arguments)
    with gate.watch("recordings"):
        return _run(arguments, gate)


def _run(arguments: argparse.Namespace, gate: Gate) -> int:
    from skd_evaluator.assessment.context import Context
    from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers
    from skd_evaluator.assessment.stages import margin
    from skd_evaluator.bags.checks import Damage
    from skd_evaluator.bags.read import assessment_from_logs, read_bags
    from skd_evaluator.cli.assessment import print_result, say_damage, say_left_out
    from skd_evaluator.margin.actions import has_exact_margin
    from skd_evaluator.provenance import provenance
    from skd_evaluator.report.presentation import fill
    from skd_evaluator.report.progress import progress_bar

    begin = time.perf_counter()
    out = result_folder(arguments)
    damage = Damage(skip=arguments.skip_damaged)
    recorded = read_bags(arguments.paths, damage)
    try:
        assessment = assessment_from_logs(
            recorded,
            campaign=arguments.campaign,
            maximum_distance=arguments.maximum_distance,
            seconds=time.perf_counter() - begin,
            damage=damage,
        )
    except UsageError:
        say_left_out("replay", damage)  # where nothing is left to assess, it says why
        raise
    say_damage("replay", damage)
    plan = assessment.plan
    if has_exact_margin(plan.car, plan.scenario) or plan.car.is_own:
        if arguments.margin_limit:
            margin.warm_up_margins()
        with InProcessRunner(available_workers()) as runner, progress_bar(quiet=arguments.quiet) as progress:
            runner.start(())
            context = Context(runner, runner, margin_limit=arguments.margin_limit, progress=progress, repeats=False)
            assessment = margin.run(context, assessment)
    else:
        assessment = replace(assessment, margin_note=margin.NEEDS_THE_CAR)
    origin = provenance(arguments.command_line, assessment.plan.car)
    assessment = replace(assessment, provenance=origin, seconds=time.perf_counter() - begin)
    problem = out.save(lambda folder: fill(folder, assessment))
    return print_result(assessment, out, arguments, gate, problem, damage.warnings)
