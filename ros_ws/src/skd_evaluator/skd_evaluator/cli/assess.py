"""`skd assess`: the Safe-Kamikaze Distance of one car."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.options.adversary import Objective, objectives_named
from skd_sim.options.options import values_of
from skd_sim.simulators.simulator import make_simulator
from skd_sim.world.episode import EpisodeLog, Mode, counts_in_words
from skd_sim.world.state import Trajectory

from skd_evaluator.assessment.assessment import Assessment, assessment_of
from skd_evaluator.assessment.context import Context, Recorder
from skd_evaluator.assessment.files.result_folder import ResultFolder
from skd_evaluator.assessment.files.results import write_assessment
from skd_evaluator.assessment.from_options import check_car, plan_of, scenario_for
from skd_evaluator.assessment.objective_result import kamikaze_set
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.assessment.plan import Plan, Stage, split_episode_id
from skd_evaluator.assessment.stages.checks import fresh_process
from skd_evaluator.assessment.stages.pipeline import assess_in_process, compile_for_graph
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.cli.arguments import result_folder, runner_of
from skd_evaluator.cli.gate import Gate, gate_of
from skd_evaluator.cli.output import print_json
from skd_evaluator.provenance import provenance
from skd_evaluator.report.presentation import fill, most_frequent, save_with_scratch, warnings_of, why_failed
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.report.terminal import (
    counted,
    details_table,
    few_safe_trajectories,
    headline,
    headline_table,
    interval_notes,
    print_table,
    safe_trajectory_table,
    surrogate_table,
)
from skd_evaluator.ros.processes import GraphSetting, log_of
from skd_evaluator.ros.session import assess_through_graph, prepare_ros

EXIT_INTERRUPTED = 130


def print_result(
    assessment: Assessment,
    out: ResultFolder,
    arguments: argparse.Namespace,
    gate: Gate,
    problem: str | None = None,
    said: Collection[str] = (),
) -> int:
    """Print an assessment and where it is, check the gate's conditions, and return the exit code.

    Args:
        assessment: what was found.
        out: folder to which the result was written.
        arguments: arguments of the command.
        gate: the conditions that it has to meet.
        problem: why the result is not where it was asked for; None if it is.
        said: warnings of the assessment that were printed before.
    """
    result = assessment.as_dict()
    if arguments.json:
        print_json(result)
    else:
        print_tables(result, details=arguments.details)
        seconds = f"{assessment.seconds:.1f} s"
        print(seconds if problem else f"{seconds}; results in {out.path}")
    for line in warnings_of(assessment, said=said):
        print(f"skd {arguments.command}: warning: {line}", file=sys.stderr)
    failures = [*([problem] if problem else []), *why_failed(assessment, arguments.max_aborted)]
    checks = gate.checks(result, None if problem else out.path, failures)
    if len(checks) > 1 and checks[0].error and not failures:
        failures.append(f"gate: nothing can be said of the car: {checks[0].text}")
    for one in checks[1:]:  # the first is of the failures above
        if one.passed and not arguments.json:
            print(f"gate: {one.name}: passed, {one.text}")
        elif not one.passed:
            failures.append(f"gate: {one.name}: {'error' if one.error else 'failed'}, {one.text}")
    if unwritten := gate.write(result, checks):
        failures.append(unwritten)
    for why in failures:
        print(f"skd {arguments.command}: {why}", file=sys.stderr)
    # How many of which is among the warnings, and the reason among the failures, if they are too many.
    logs = out.path / "logs"
    if assessment.reasons and (logs.is_dir() or not any(most_frequent(assessment.reasons) in why for why in failures)):
        print(
            f"skd {arguments.command}: why episodes were aborted: {_reasons(assessment.reasons, logs)}", file=sys.stderr
        )
    return 1 if failures else 0


def say_aborted(command: str, reasons: Sequence[str], episodes: int, out: ResultFolder) -> None:
    """Say how many episodes were aborted and why, and which log of a graph says more; nothing if none was."""
    if reasons:
        aborted = f"{len(reasons)} of {counted(episodes, 'episode')} aborted"
        print(f"skd {command}: {aborted}: {_reasons(reasons, out.path / 'logs')}", file=sys.stderr)


def _reasons(reasons: Sequence[str], logs: Path) -> str:
    """Return in words why episodes were aborted: which log of a graph says more, or else the most frequent reason."""
    first = most_frequent(reasons)
    more = f"log: {log_of(logs, first)}" if logs.is_dir() else f"the first one so: {first}"
    return f"{counts_in_words(reasons)}; {more}"


def print_tables(result: Mapping[str, Any], *, details: bool) -> None:
    """Print what was found, in a sentence and a few rows, or with all details, from the content of assessment.json."""
    print(headline(result))
    print_table(headline_table(result))
    if result["equivalent_multiplier_note"]:
        print(f"Equivalent multiplier: {result['equivalent_multiplier_note']}")
    if (few := few_safe_trajectories(result)) is not None:
        print(few)
    if not details:
        return
    print_table(details_table(result))
    if (surrogates := surrogate_table(result)) is not None:
        print_table(surrogates)
    print_table(safe_trajectory_table(result))
    for note in interval_notes(result):
        print(f"Interval of {note}")
    if result["until_width"]:
        print(f"Stopped {result['until_width']['text']}")


def print_what_there_is(plan: Plan, recorder: Recorder, begin: float, arguments: argparse.Namespace) -> int:
    """Print what an interrupted assessment has found so far, and how much of it is missing; return the exit code."""
    objectives = objectives_named(arguments.objective)
    safe: dict[int, Trajectory] = {}
    tried: dict[tuple[Objective, int], dict[int, EpisodeLog]] = {}
    runs: list[EpisodeLog] = []
    for log in recorder.logs:
        stage, index, trial = split_episode_id(log.episode.episode_id)
        phi = log.episode.safe_trajectory
        if phi is not None and log.episode.mode == Mode.KAMIKAZE and stage == Stage.KAMIKAZE:
            safe.setdefault(index, phi)
            tried.setdefault((log.episode.objective, index), {}).setdefault(trial, log)  # later ones are bounded
        elif stage == Stage.NOMINAL:
            runs.append(log)
    sets = {
        objective: [kamikaze_set(safe[index], tried.get((objective, index), {}).values()) for index in sorted(safe)]
        for objective in objectives
    }
    assessment = replace(
        assessment_of(plan, [safe[index] for index in sorted(safe)], sets, runs),
        seconds=time.perf_counter() - begin,
        margin_note="interrupted before it was searched",
    )
    result = assessment.as_dict()
    if arguments.json:
        print_json({"interrupted": True, **result})
    else:
        print_tables(result, details=True)
    requested = plan.kamikaze_count * plan.safe_count * len(objectives)
    print(
        f"skd {arguments.command}: interrupted; nothing was written. What is above is of {assessment.successes} of "
        f"{requested} kamikaze trajectories and {len(runs)} of {plan.collision_runs} runs along φ; the same command "
        "begins anew and gives the same",
        file=sys.stderr,
    )
    return EXIT_INTERRUPTED


def graph_options(arguments: argparse.Namespace) -> GraphOptions:
    """Return how to run the graph."""
    return GraphOptions(**values_of(GraphOptions, vars(arguments)))


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    gate = gate_of(arguments)
    with gate.watch(arguments.controller):
        return _run(arguments, gate)


def _run(arguments: argparse.Namespace, gate: Gate) -> int:
    begin = time.perf_counter()
    plan = plan_of(vars(arguments), scenario_for(arguments.scenario, arguments.safe))
    plan = replace(plan, scenario=check_car(vars(arguments), plan.scenario, graph=arguments.graph))
    make_simulator(plan.simulator)
    request = requested(arguments)
    for option in ("curve", "until_width", "scheduler"):
        if arguments.graph and getattr(arguments, option):
            raise UsageError(f"--{option.replace('_', '-')} goes with assessments in process: leave out --graph")
    if arguments.record and not arguments.graph:
        raise UsageError("--record keeps the bags of the node graph: add --graph")
    if arguments.graph:
        prepare_ros(graph_options(arguments))
    out = result_folder(arguments)
    command = arguments.controller_command or ""
    origin = provenance(arguments.command_line, plan.car, controller_command=command)
    assessment = Assessment(plan, provenance=origin)
    if arguments.graph:
        assessment, problem = _assess_graph(arguments, assessment, request, out, begin)
        return print_result(assessment, out, arguments, gate, problem)
    workers = runner_of(arguments, isolated=plan.runs_others_code, answer_limit=arguments.startup_timeout)
    recorder = Recorder(workers)
    fresh = partial(fresh_process, arguments.startup_timeout)
    try:
        with progress_bar(quiet=arguments.quiet) as progress:
            context = Context(recorder, workers, progress=progress, fresh=fresh, **request)
            assessment = assess_in_process(context, assessment)
    except KeyboardInterrupt:
        if not any(log.episode.mode == Mode.KAMIKAZE for log in recorder.logs):
            raise
        return print_what_there_is(plan, recorder, begin, arguments)
    assessment = replace(assessment, seconds=time.perf_counter() - begin)
    problem = out.save(lambda folder: _write(folder, assessment, arguments, may_fork=True))
    return print_result(assessment, out, arguments, gate, problem)


def _write(folder: Path, assessment: Assessment, arguments: argparse.Namespace, *, may_fork: bool = False) -> None:
    """Write an assessment, with its pictures if they are requested."""
    if arguments.pictures:
        fill(folder, assessment, may_fork=may_fork)
    else:
        write_assessment(folder, assessment)


def requested(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what the options request of the stages, as arguments of `Context`."""
    return {
        "objectives": objectives_named(arguments.objective),
        "margin_limit": arguments.margin_limit,
        "curve": arguments.curve,
        "until_width": arguments.until_width,
        "risk": risk_request(arguments.behaviour, arguments.risk_runs, subset=arguments.risk_subset),
        "say": partial(say, arguments.command),
    }


def say(command: str, line: str) -> None:
    """Say something to the user that is no result."""
    print(f"skd {command}: {line}", file=sys.stderr, flush=True)


def _assess_graph(
    arguments: argparse.Namespace, assessment: Assessment, request: dict[str, Any], out: ResultFolder, begin: float
) -> tuple[Assessment, str | None]:
    compile_for_graph(assessment.plan, request["objectives"])
    with out.scratch() as scratch:
        setting = GraphSetting(
            options=graph_options(arguments),
            car=assessment.plan.car,
            log_folder=scratch.logs,
            simulator=assessment.plan.simulator,
            record_to=scratch.folder / "bags" if arguments.record else None,
        )
        with progress_bar(quiet=arguments.quiet) as progress:
            assessment = assess_through_graph(assessment, setting, {**request, "progress": progress})
        assessment = replace(assessment, seconds=time.perf_counter() - begin)
        problem = save_with_scratch(out, scratch.folder, lambda folder: _write(folder, assessment, arguments))
    return assessment, problem
