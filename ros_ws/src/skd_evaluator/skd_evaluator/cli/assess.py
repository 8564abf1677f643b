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

from skd_evaluator.assessment.assessment import Assessment, judge_all
from skd_evaluator.assessment.files.result_folder import ResultFolder
from skd_evaluator.assessment.files.results import write_assessment
from skd_evaluator.assessment.from_options import check_car, plan_of, scenario_for
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.assessment.plan import Plan, Recorder, Stage, kamikaze_set, split_episode_id
from skd_evaluator.assessment.repeatability import fresh_process
from skd_evaluator.assessment.stages.pipeline import (
    Further,
    Runners,
    assess_in_process,
    compile_for_graph,
)
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
from skd_evaluator.risk.assessment_risk import risk_asked
from skd_evaluator.ros.processes import log_of
from skd_evaluator.ros.session import prepare_ros, rated_through_graph

EXIT_INTERRUPTED = 130


def print_result(
    rating: Assessment,
    out: ResultFolder,
    arguments: argparse.Namespace,
    gate: Gate,
    problem: str | None = None,
    said: Collection[str] = (),
) -> int:
    """Print an assessment and where it is, check the gate's conditions, and return the exit code.

    Args:
        rating: what was found.
        out: folder to which the result was written.
        arguments: arguments of the command.
        gate: the conditions that it has to meet.
        problem: why the result is not where it was asked for; None if it is.
        said: warnings of the rating that were printed before.
    """
    result = rating.as_dict()
    if arguments.json:
        print_json(result)
    else:
        print_tables(result, details=arguments.details)
        seconds = f"{rating.seconds:.1f} s"
        print(seconds if problem else f"{seconds}; results in {out.path}")
    for line in warnings_of(rating, said=said):
        print(f"skd {arguments.command}: warning: {line}", file=sys.stderr)
    failures = [*([problem] if problem else []), *why_failed(rating, arguments.max_aborted)]
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
    if rating.reasons and (logs.is_dir() or not any(most_frequent(rating.reasons) in why for why in failures)):
        print(f"skd {arguments.command}: why episodes were aborted: {_reasons(rating.reasons, logs)}", file=sys.stderr)
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


def print_what_there_is(
    plan: Plan, safe: Sequence[Trajectory], recorder: Recorder, begin: float, arguments: argparse.Namespace
) -> int:
    """Print what an interrupted assessment has found so far, and how much of it is missing; return the exit code."""
    objectives = objectives_named(arguments.objective)
    tried: dict[tuple[Objective, int], list[EpisodeLog]] = {}
    for log in recorder.logs:
        if log.episode.mode == Mode.KAMIKAZE:
            index = split_episode_id(log.episode.episode_id)[1]
            tried.setdefault((log.episode.objective, index), []).append(log)
    sets = {
        objective: [kamikaze_set(one, tried.get((objective, index), ())) for index, one in enumerate(safe)]
        for objective in objectives
    }
    along = [log for log in recorder.logs if log.episode.mode == Mode.REPLAY]
    replays = [log for log in along if split_episode_id(log.episode.episode_id)[0] == Stage.NOMINAL]
    rating = judge_all(plan, safe, sets, replays, time.perf_counter() - begin)
    rating = replace(rating, margin_note="interrupted before it was searched")
    result = rating.as_dict()
    if arguments.json:
        print_json({"interrupted": True, **result})
    else:
        print_tables(result, details=True)
    wanted = plan.kamikaze_count * len(safe) * len(objectives)
    print(
        f"skd {arguments.command}: interrupted; nothing was written. What is above is of {rating.successes} of "
        f"{wanted} kamikaze trajectories and {len(replays)} of {plan.collision_runs} runs along φ; the same command "
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
    objectives = objectives_named(arguments.objective)
    plan = replace(plan, scenario=check_car(vars(arguments), plan.scenario, graph=arguments.graph))
    make_simulator(plan.simulator)
    further = further_of(arguments)
    for option in ("curve", "until_width", "scheduler"):
        if arguments.graph and getattr(arguments, option):
            raise UsageError(f"--{option.replace('_', '-')} goes with assessments in process: leave out --graph")
    if arguments.record and not arguments.graph:
        raise UsageError("--record keeps the bags of the node graph: add --graph")
    if arguments.graph:
        prepare_ros(graph_options(arguments))
    out = result_folder(arguments)
    if arguments.graph:
        rating, problem = _assess_graph(arguments, plan, further, out, begin)
        return print_result(rating, out, arguments, gate, problem)
    safe: list[Trajectory] = []
    runner = runner_of(arguments, isolated=plan.runs_others_code, answer_limit=arguments.startup_timeout)
    recorder = Recorder(runner)
    runners = Runners.in_process(runner, recorder, fresh=partial(fresh_process, arguments.startup_timeout))
    origin, tell = partial(origin_of, arguments), partial(say, arguments.command)
    try:
        with progress_bar(quiet=arguments.quiet) as progress:
            rating = assess_in_process(plan, objectives, runners, progress, further, origin, tell, safe)
    except KeyboardInterrupt:
        if not recorder.logs:
            raise
        return print_what_there_is(plan, safe, recorder, begin, arguments)
    rating = replace(rating, seconds=time.perf_counter() - begin)
    problem = out.save(lambda folder: _write(folder, rating, arguments, may_fork=True))
    return print_result(rating, out, arguments, gate, problem)


def _write(folder: Path, rating: Assessment, arguments: argparse.Namespace, *, may_fork: bool = False) -> None:
    """Write an assessment, with its pictures if they are asked for."""
    if arguments.pictures:
        fill(folder, rating, may_fork=may_fork)
    else:
        write_assessment(folder, rating)


def further_of(arguments: argparse.Namespace) -> Further:
    """Return what else the assessment is to have, as the options say."""
    risk = risk_asked(arguments.behaviour, arguments.risk_runs, subset=arguments.risk_subset)
    return Further(arguments.margin_limit, arguments.curve, arguments.until_width, risk)


def origin_of(arguments: argparse.Namespace, plan: Plan) -> dict[str, Any]:
    """Return where an assessment comes from; see `provenance`."""
    command = arguments.controller_command or ""
    return provenance(arguments.command_line, plan.car, controller_command=command, car_model=plan.car_model)


def say(command: str, line: str) -> None:
    """Say something to the user that is no result."""
    print(f"skd {command}: {line}", file=sys.stderr, flush=True)


def _assess_graph(
    arguments: argparse.Namespace, plan: Plan, further: Further, out: ResultFolder, begin: float
) -> tuple[Assessment, str | None]:
    objectives = objectives_named(arguments.objective)
    compile_for_graph(plan, objectives)
    with out.scratch() as scratch:
        with progress_bar(quiet=arguments.quiet) as progress:
            rating = rated_through_graph(
                plan,
                objectives,
                graph_options(arguments),
                further,
                log_folder=scratch.logs,
                record_to=scratch.folder / "bags" if arguments.record else None,
                progress=progress,
                say=partial(say, arguments.command),
            )
        rating = replace(rating, provenance=origin_of(arguments, rating.plan), seconds=time.perf_counter() - begin)
        problem = save_with_scratch(out, scratch.folder, lambda folder: _write(folder, rating, arguments))
    return rating, problem
