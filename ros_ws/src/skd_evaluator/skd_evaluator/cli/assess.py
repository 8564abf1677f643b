"""`skd assess`: the Safe-Kamikaze Distance of one car."""

from __future__ import annotations

import argparse
import shlex
import sys
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.options.adversary import objectives_named
from skd_sim.options.options import values_of
from skd_sim.simulators.simulator import make_simulator
from skd_sim.world.episode import counts_in_words

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Progress, Runner
from skd_evaluator.assessment.files.episode_store import EpisodeStore, StoringRunner, digest_of, remove_files
from skd_evaluator.assessment.files.result_folder import ResultFolder
from skd_evaluator.assessment.files.results import write_assessment
from skd_evaluator.assessment.from_options import check_car, plan_of, scenario_for
from skd_evaluator.assessment.options import GENERATED, GraphOptions
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.stages.car_model import needs_learning
from skd_evaluator.assessment.stages.checks import fresh_process
from skd_evaluator.assessment.stages.pipeline import assess_in_process, compile_for_graph
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.cli.arguments import result_folder, runner_of
from skd_evaluator.cli.gate import Gate, gate_of
from skd_evaluator.cli.output import print_json
from skd_evaluator.errors import AssessmentError
from skd_evaluator.files import PREFIX
from skd_evaluator.provenance import code_digests, environment, provenance
from skd_evaluator.report.presentation import fill, most_frequent, save_with_scratch, warnings_of, why_failed
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.report.repeat import program
from skd_evaluator.report.terminal import (
    command_ages,
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
        more = "" if arguments.details else "; --details prints every figure, SKD among them"
        print(seconds if problem else f"{seconds}; results in {out.path}{more}")
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
    for line in (command_ages(result), few_safe_trajectories(result)):
        if line is not None:
            print(line)
    if not details:
        return
    if result["equivalent_multiplier_note"]:
        print(f"Equivalent multiplier: {result['equivalent_multiplier_note']}")
    print_table(details_table(result))
    if (surrogates := surrogate_table(result)) is not None:
        print_table(surrogates)
    print_table(safe_trajectory_table(result))
    for note in interval_notes(result):
        print(f"Interval of {note}")
    if result["until_width"]:
        print(f"Stopped {result['until_width']['text']}")


class _KeptEpisodes:
    """Episodes that are kept as soon as they have run, in a hidden file beside the results, until these are written."""

    def __init__(self, arguments: argparse.Namespace, assessment: Assessment, out: Path) -> None:
        """Open the file, or begin it.

        Raises:
            UsageError: --resume is given, and there is none, or it is of another car or version.
        """
        self._path, self._arguments, self._out = _place_of_episodes(out), arguments, out
        if arguments.resume and not self._path.is_file():
            raise UsageError(f"--resume: no interrupted assessment is kept for --out {out}")
        if not arguments.resume:
            remove_files(self._path)
        car = assessment.plan.car
        files = code_digests(car, arguments.controller_command or "")
        self._key = digest_of({"files": files, "environment": dict(environment())})
        self._store = EpisodeStore(self._path)
        self.count = self._store.count()
        self._store.keep_only([self._key])
        if self.count and not self._store.count():
            self._store.close()
            remove_files(self._path)
            raise UsageError(f"--resume: {out} was begun with other files of the car or another SKD; begin anew")

    def runner(self, runner: Runner) -> Runner:
        """Return a runner that reads what there is, and keeps what it runs."""
        return StoringRunner(runner, self._store, self._key, threading.Event())

    def interrupted(self) -> int:
        """Say in one line how to go on, and return the exit code."""
        self.count = self._store.count()
        words = [word for word in self._arguments.command_line if word not in ("--overwrite", "--resume")]
        words += [] if self._arguments.out else ["--out", str(self._out)]
        go_on = shlex.join([program(), *words[1:], "--resume"])
        if self._arguments.json:
            print_json({"interrupted": True, "episodes": self.count, "resume": go_on})
        then = (
            f"; {counted(self.count, 'episode')} kept, go on with: {go_on}" if self.count else "; nothing to keep yet"
        )
        print(f"skd {self._arguments.command}: interrupted{then}", file=sys.stderr)
        return EXIT_INTERRUPTED

    def failed(self, error: AssessmentError) -> AssessmentError:
        """Return the error with how to go on."""
        if not self._store.count():
            return error
        kept = counted(self._store.count(), "episode")
        return type(error)(f"{error}; {kept} kept: --out {self._out} --resume goes on")

    def close(self, *, done: bool) -> None:
        """Let go of the file; remove it when the results are written, or nothing is in it."""
        done = done or not self._store.count()
        self._store.close()
        if done:
            remove_files(self._path)


def _place_of_episodes(out: Path) -> Path:
    return out.with_name(f"{PREFIX}{out.name}.sqlite")


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
    if arguments.resume and arguments.out is None:
        raise UsageError("--resume needs --out: the folder of the assessment to go on with")
    out = result_folder(arguments)
    command = arguments.controller_command or ""
    origin = provenance(arguments.command_line, plan.car, controller_command=command)
    assessment = Assessment(plan, provenance=origin)
    kept = _KeptEpisodes(arguments, assessment, out.path)
    done = True
    try:
        work = _Work(arguments, request, out, begin, kept)
        assessment, problem = (work.through_graph if arguments.graph else work.in_process)(assessment)
        done = problem is None
    except KeyboardInterrupt:
        done = False
        return kept.interrupted()
    except AssessmentError as error:
        done = not (arguments.graph or arguments.scheduler)  # else it is likely not the car's fault
        raise error if done else kept.failed(error) from error
    finally:
        kept.close(done=done)
    return print_result(assessment, out, arguments, gate, problem)


@dataclass(frozen=True)
class _Work:
    """An assessment that a command runs and writes; both ways return it, and why it could not be written, if so.

    Attributes:
        arguments: of the command.
        request: what they request of the stages, as arguments of `Context`.
        out: where the results go.
        begin: when the command began, s on the clock of `time.perf_counter`.
        kept: the episodes of an interrupted command.
    """

    arguments: argparse.Namespace
    request: Mapping[str, Any]
    out: ResultFolder
    begin: float
    kept: _KeptEpisodes

    def in_process(self, assessment: Assessment) -> tuple[Assessment, str | None]:
        """Run the episodes in processes of this machine or of a cluster."""
        limit = self.arguments.startup_timeout
        workers = runner_of(self.arguments, isolated=assessment.plan.runs_others_code, answer_limit=limit)
        with self._progress(assessment.plan) as progress:
            fresh = partial(fresh_process, limit)
            context = Context(self.kept.runner(workers), workers, progress=progress, fresh=fresh, **self.request)
            assessment = self._timed(assess_in_process(context, assessment))
        return assessment, self.out.save(lambda folder: self._write(folder, assessment, may_fork=True))

    def through_graph(self, assessment: Assessment) -> tuple[Assessment, str | None]:
        """Run the episodes through the node graph."""
        compile_for_graph(assessment.plan, self.request["objectives"])
        with self.out.scratch() as scratch:
            setting = GraphSetting(
                options=graph_options(self.arguments),
                car=assessment.plan.car,
                log_folder=scratch.logs,
                simulator=assessment.plan.simulator,
                record_to=scratch.folder / "bags" if self.arguments.record else None,
            )
            with self._progress(assessment.plan) as progress:
                request = {**self.request, "progress": progress}
                assessment = self._timed(assess_through_graph(assessment, setting, request, self.kept.runner))
            problem = save_with_scratch(self.out, scratch.folder, lambda folder: self._write(folder, assessment))
        return assessment, problem

    def _progress(self, plan: Plan) -> AbstractContextManager[Progress]:
        return progress_bar(quiet=self.arguments.quiet, steps=_steps(plan, self.request))

    def _timed(self, assessment: Assessment) -> Assessment:
        return replace(assessment, seconds=time.perf_counter() - self.begin)

    def _write(self, folder: Path, assessment: Assessment, *, may_fork: bool = False) -> None:
        """Write an assessment, with its pictures if they are requested."""
        if self.arguments.pictures:
            fill(folder, assessment, may_fork=may_fork)
        else:
            write_assessment(folder, assessment)


def _steps(plan: Plan, request: Mapping[str, Any]) -> list[str]:
    """Return how the labels of each step of an assessment begin, in order."""
    steps = ["learning the car"] if needs_learning(plan) else []
    steps += ["safe trajectories"] if plan.safe in GENERATED else []
    steps += ["kamikazes", "nominal runs", *(["margin"] if request["margin_limit"] else [])]
    return [*steps, *(["risk"] if request["risk"].behaviour is not None else [])]


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
