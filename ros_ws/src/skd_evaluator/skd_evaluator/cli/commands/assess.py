"""`skd assess`: the safety margin, nominal collision rate and risk of one car."""

from __future__ import annotations

import argparse
import os
import shlex
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skd_sim.errors import UsageError

from skd_evaluator.cli.arguments import (
    DETAILS,
    add_campaign_arguments,
    add_car_arguments,
    add_flag,
    add_graph_arguments,
    add_value,
    graph_options,
    positive_number,
    result_folder,
    runner_of,
)
from skd_evaluator.cli.gate import Gate, add_gate_arguments, gate_of
from skd_evaluator.cli.output import print_json, say
from skd_evaluator.cli.parser import EXIT_INTERRUPTED, Parser, rare
from skd_evaluator.errors import AssessmentError
from skd_evaluator.files import PREFIX

if TYPE_CHECKING:  # help reads this module, and they take time
    from skd_evaluator.assessment.assessment import Assessment
    from skd_evaluator.assessment.context import Runner
    from skd_evaluator.assessment.files.result_folder import ResultFolder
    from skd_evaluator.assessment.plan import Plan


def add(parser: Parser) -> None:
    """Rate one car: its safety margin, nominal collision rate and risk.

    Rate one car. Pedestrians cross on safe trajectories φ. The safety margin is the least deviation from φ with which
    the moving car hits. Kamikazes are pedestrians that plan to be hit with what they know: their distance from φ is the
    Safe-Kamikaze Distance (SKD).
    """
    parser.set_defaults(group="rate")
    add_car_arguments(parser, "assess")
    add_graph_arguments(parser, "assess", optional=True)
    add_campaign_arguments(parser, "assess")
    add_gate_arguments(parser)
    add_flag(parser, "--resume", "go on with the assessment in --out that was interrupted")
    add_flag(parser, "--details", DETAILS)
    add_flag(parser, "--no-pictures", rare("draw no pictures, which saves about a second"))
    text = "add --safe-count trajectories at a time, at most 10 times, until the planned deviation's interval is W wide"
    add_value(parser, "--until-width", rare(text), type=positive_number, metavar="W")


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    gate = gate_of(arguments)
    with gate.watch(arguments.controller):
        return _run(arguments, gate)


def _run(arguments: argparse.Namespace, gate: Gate) -> int:
    from skd_sim.simulators.simulator import make_simulator

    from skd_evaluator.assessment.assessment import Assessment
    from skd_evaluator.assessment.from_options import check_car, plan_of, scenario_for
    from skd_evaluator.cli.results import print_result
    from skd_evaluator.provenance import provenance
    from skd_evaluator.ros.session import prepare_ros

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
    _check_resume(arguments)
    out = result_folder(arguments)
    command = arguments.controller_command or ""
    assessment = Assessment(plan, provenance=provenance(arguments.command_line, plan.car, controller_command=command))
    kept = _KeptEpisodes(arguments, assessment, out.path)
    done = True
    try:
        assess = _through_graph if arguments.graph else _in_process
        assessment, problem = assess(arguments, assessment, request, out, begin, kept)
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


def _kept_in(out: Path) -> Path:
    """Return the hidden file beside the results in which episodes are kept until these are written."""
    return out.with_name(f"{PREFIX}{out.name}.sqlite")


def _check_resume(arguments: argparse.Namespace) -> None:
    """Refuse to resume what is not there or complete, and to begin anew without a word what was interrupted."""
    if arguments.out is None:
        if arguments.resume:
            raise UsageError("--resume needs --out: the folder of the assessment to go on with")
        return
    out = Path(arguments.out)
    kept = os.path.isfile(_kept_in(out))  # noqa: PTH113 - which is false of a name that no file can have
    if arguments.resume and not kept:
        complete = (out / "assessment.json").is_file() and not arguments.overwrite
        why = "it is complete" if complete else "no interrupted assessment is kept"
        raise UsageError(f"--resume: nothing to go on with in --out {out}: {why}")
    if kept and not (arguments.resume or arguments.overwrite):
        raise UsageError(f"--out {out}: was interrupted; --resume goes on with it, --overwrite begins anew")


def requested(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what the options request of the stages, as arguments of `Context`."""
    from skd_sim.options.adversary import objectives_named

    from skd_evaluator.assessment.stages.risk import risk_request

    return {
        "objectives": objectives_named(arguments.objective),
        "margin_limit": arguments.margin_limit,
        "curve": arguments.curve,
        "reference": arguments.reference,
        "until_width": arguments.until_width,
        "risk": risk_request(arguments.behaviour, arguments.risk_runs, subset=arguments.risk_subset),
        "say": partial(say, arguments.command),
    }


def _in_process(
    arguments: argparse.Namespace,
    assessment: Assessment,
    request: dict[str, Any],
    out: ResultFolder,
    begin: float,
    kept: _KeptEpisodes,
) -> tuple[Assessment, str | None]:
    """Return the assessment, and why it could not be written, if so."""
    from skd_evaluator.assessment.context import Context
    from skd_evaluator.assessment.stages.checks import fresh_process
    from skd_evaluator.assessment.stages.pipeline import assess_in_process
    from skd_evaluator.report.progress import progress_bar

    workers = runner_of(arguments, isolated=assessment.plan.runs_others_code, answer_limit=arguments.startup_timeout)
    fresh = partial(fresh_process, arguments.startup_timeout)
    with progress_bar(quiet=arguments.quiet, steps=_steps(assessment.plan, request)) as progress:
        context = Context(kept.runner(workers), workers, progress=progress, fresh=fresh, **request)
        assessment = assess_in_process(context, assessment)
    assessment = replace(assessment, seconds=time.perf_counter() - begin)
    return assessment, out.save(lambda folder: _write(folder, assessment, arguments, may_fork=True))


def _through_graph(
    arguments: argparse.Namespace,
    assessment: Assessment,
    request: dict[str, Any],
    out: ResultFolder,
    begin: float,
    kept: _KeptEpisodes,
) -> tuple[Assessment, str | None]:
    from skd_evaluator.assessment.stages.pipeline import compile_for_graph
    from skd_evaluator.report.presentation import with_scratch
    from skd_evaluator.report.progress import progress_bar
    from skd_evaluator.ros.processes import GraphSetting
    from skd_evaluator.ros.session import assess_through_graph

    plan = assessment.plan
    compile_for_graph(plan, request["objectives"])
    with out.scratch() as scratch:
        bags = scratch.folder / "bags" if arguments.record else None
        setting = GraphSetting(
            options=graph_options(arguments), car=plan.car, log_folder=scratch.logs, simulator=plan.simulator,
            record_to=bags,
        )  # fmt: skip
        with progress_bar(quiet=arguments.quiet, steps=_steps(plan, request)) as progress:
            assessment = assess_through_graph(assessment, setting, {**request, "progress": progress}, kept.runner)
        assessment = replace(assessment, seconds=time.perf_counter() - begin)
        problem = out.save(with_scratch(scratch.folder, lambda folder: _write(folder, assessment, arguments)))
    return assessment, problem


def _steps(plan: Plan, request: Mapping[str, Any]) -> list[str]:
    """Return how the labels of each step of an assessment begin, in order."""
    from skd_evaluator.assessment.options import GENERATED
    from skd_evaluator.assessment.stages.car_model import needs_learning

    steps = ["learning the car"] if needs_learning(plan) else []
    steps += ["safe trajectories"] if plan.safe in GENERATED else []
    steps += ["nominal runs", "kamikazes", *(["margin"] if request["margin_limit"] else [])]
    steps += ["risk"] if request["risk"].behaviour is not None else []
    return [*steps, "price of caution"]


def _write(folder: Path, assessment: Assessment, arguments: argparse.Namespace, *, may_fork: bool = False) -> None:
    """Write an assessment, with its pictures if they are requested."""
    from skd_evaluator.assessment.files.results import write_assessment
    from skd_evaluator.report.presentation import fill

    if arguments.pictures:
        fill(folder, assessment, may_fork=may_fork)
    else:
        write_assessment(folder, assessment)


class _KeptEpisodes:
    """Episodes that are kept as soon as they have run, until the results are written."""

    def __init__(self, arguments: argparse.Namespace, assessment: Assessment, out: Path) -> None:
        """Open the file, or begin it.

        Raises:
            UsageError: --resume is given, and what is kept is of another request, car or version.
        """
        from skd_evaluator.assessment.files.episode_store import EpisodeStore, digest_of, remove_files
        from skd_evaluator.provenance import code_digests, environment

        self._arguments, self._out = arguments, out
        path, plan = _kept_in(out), assessment.plan
        if not arguments.resume:
            remove_files(path)
        files = code_digests(plan.car, arguments.controller_command or "")
        request = {key: str(value) for key, value in vars(plan).items() if key != "scenario"}
        request["scenario"] = digest_of(plan.scenario.as_dict()).hex()
        self._key = digest_of({"files": files, "environment": dict(environment()), "request": request})
        self._store = EpisodeStore(path)
        if self._store.cells() not in ([], [self._key]):
            self._store.close()
            raise UsageError(f"--resume: {out} was begun with other options, another SKD or other files of the car")

    def runner(self, runner: Runner) -> Runner:
        """Return a runner that reads what there is, and keeps what it runs."""
        from skd_evaluator.assessment.files.episode_store import StoringRunner

        return StoringRunner(runner, self._store, self._key, threading.Event())

    def _count(self) -> str:
        number = self._store.count()
        return f"{number} episode{'s' if number != 1 else ''} kept" if number else ""

    def interrupted(self) -> int:
        """Say in one line how to go on, and return the exit code."""
        from skd_evaluator.report.repeat import program

        words = [word for word in self._arguments.command_line if word != "--resume"]
        words += [] if self._arguments.out else ["--out", str(self._out)]
        go_on = shlex.join([program(), *words[1:], "--resume"])
        if self._arguments.json:
            print_json({"interrupted": True, "episodes": self._store.count(), "resume": go_on})
        kept = self._count()
        anew = "" if self._arguments.graph else ", but for the margin's search"
        again = f"{kept}{anew}; go on with: {go_on}" if kept else "nothing to keep yet"
        say(self._arguments.command, f"interrupted; {again}")
        return EXIT_INTERRUPTED

    def failed(self, error: AssessmentError) -> AssessmentError:
        """Return the error with how to go on."""
        kept = self._count()
        return type(error)(f"{error}; {kept}: --out {self._out} --resume goes on") if kept else error

    def close(self, *, done: bool) -> None:
        """Let go of the file; remove it when the results are written, or nothing is in it."""
        if done or not self._store.count():
            self._store.remove()
        else:
            self._store.close()
