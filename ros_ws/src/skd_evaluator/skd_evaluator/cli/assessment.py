"""The work of `skd assess`: in process or through a graph, kept episode by episode, resumed, written.

Commands that rate a car print an assessment, and fail, by the same function.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shlex
import shutil
import threading
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from skd_sim.errors import AssessmentError, OutOfReachError, UsageError
from skd_sim.inputs.files import from_here
from skd_sim.options.car_and_adversary import OBJECTIVES, is_own_world, objectives_named
from skd_sim.options.options import options_of
from skd_sim.simulators.simulator import make_simulator
from skd_sim.world.episode import counts_in_words

from skd_evaluator.assessment import options
from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Runner
from skd_evaluator.assessment.files.episode_store import EpisodeStore, StoringRunner, changes, remove_files
from skd_evaluator.assessment.files.result_folder import ResultFolder, Scratch, write_json
from skd_evaluator.assessment.files.results import StoredResult, read_checked, read_result, write_assessment
from skd_evaluator.assessment.from_options import check_car, plan_of, scenario_for
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.stages.car_model import needs_learning
from skd_evaluator.assessment.stages.checks import fresh_process
from skd_evaluator.assessment.stages.pipeline import assess_in_process, compile_for_graph
from skd_evaluator.assessment.stages.risk import risk_request
from skd_evaluator.bags.checks import Damage
from skd_evaluator.cli.arguments import graph_options, result_folder, runner_of
from skd_evaluator.cli.gate import Gate
from skd_evaluator.cli.output import EXIT_INTERRUPTED, print_json, say, warn
from skd_evaluator.files import is_unfinished, unfinished
from skd_evaluator.margin.common_trajectories import check_repeats
from skd_evaluator.metrics.margins import reference_text
from skd_evaluator.provenance import MOST_FILES, code_files, environment, provenance, sums_of
from skd_evaluator.report import terminal
from skd_evaluator.report.formats import counted
from skd_evaluator.report.presentation import fill, with_scratch
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.report.repeat import program
from skd_evaluator.report.warnings import most_frequent, warnings_of, why_failed
from skd_evaluator.ros.processes import GraphSetting, log_of
from skd_evaluator.ros.session import assess_through_graph, prepare_ros


def run_assessment(arguments: argparse.Namespace, gate: Gate) -> int:
    """Run what is requested, or go on with it; return the exit code."""
    begin = time.perf_counter()
    if arguments.resume is not None:
        arguments.command_line = ["skd", *arguments.begun]
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
    if arguments.resume is None and arguments.out and not arguments.overwrite and is_unfinished(arguments.out):
        raise UsageError(f"--out {arguments.out}: was interrupted; --resume goes on with it, --overwrite begins anew")
    out = result_folder(arguments)
    begun = begun_with(arguments, plan)
    origin = provenance(arguments.command_line, plan.car, controller_command=arguments.controller_command or "")
    origin |= {"inputs_sha256": digest_of_inputs(begun, arguments)}
    assessment = Assessment(plan, provenance=origin)
    if (earlier := request["earlier"]) is not None and origin["inputs_sha256"] and "margin" in earlier.groups:
        before = earlier.figures.get("provenance") or {}
        if before.get("inputs_sha256") == origin["inputs_sha256"]:
            return _confirmed(earlier, arguments, origin, out, gate, begin)
    kept = KeptEpisodes(arguments, begun, out.path)
    done = True
    try:
        if arguments.graph:
            compile_for_graph(plan, request["objectives"])
        with out.scratch() if arguments.graph else nullcontext() as scratch:
            with progress_bar(quiet=arguments.quiet, steps=_steps(plan, request)) as progress:
                assessment = _run_stages(arguments, assessment, {**request, "progress": progress}, kept, scratch)
            assessment = replace(assessment, seconds=time.perf_counter() - begin)
            problem = out.save(lambda folder: _write(folder, assessment, arguments, scratch))
        done = problem is None
    except KeyboardInterrupt:
        done = False
        return kept.interrupted()
    except (AssessmentError, OutOfReachError) as error:
        done = not (arguments.graph or arguments.scheduler)  # else it is likely not the car's fault
        raise error if done else kept.failed(error) from error
    finally:
        kept.close(done=done)
    return print_result(assessment, out, arguments, gate, problem)


def _confirmed(
    earlier: StoredResult,
    arguments: argparse.Namespace,
    now: Mapping[str, Any],
    out: ResultFolder,
    gate: Gate,
    begin: float,
) -> int:
    """Write an earlier result again, of which every hit of the margin comes again, and return the exit code.

    Raises:
        AssessmentError: a hit does not.
    """
    with progress_bar(quiet=arguments.quiet) as progress:
        check_repeats(earlier, progress)
    how = f"as in {earlier.folder}: the same car and options, and each hit came again"
    stored = replace(read_checked(earlier.folder)[2], seconds=time.perf_counter() - begin)
    figures = {**earlier.figures, "provenance": now, "margin_how": how, "seconds": stored.seconds}

    def write(folder: Path) -> None:
        shutil.copytree(earlier.folder, folder, dirs_exist_ok=True)
        write_json(folder / "assessment.json", figures)

    problem = out.save(write)
    return print_result(stored, out, arguments, gate, problem, result=figures)


def requested(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what the options request of the stages, as arguments of `Context`."""
    return {
        "objectives": objectives_named(arguments.objective),
        "margin_limit": arguments.margin_limit,
        "earlier": read_result(Path(arguments.warm_start)) if arguments.warm_start else None,
        "curve": arguments.curve,
        "reference": arguments.reference,
        "until_width": arguments.until_width,
        "risk": risk_request(arguments.behaviour, arguments.risk_runs, subset=arguments.risk_subset),
        "say": partial(say, arguments.command),
    }


def _run_stages(
    arguments: argparse.Namespace,
    assessment: Assessment,
    request: dict[str, Any],
    kept: KeptEpisodes,
    scratch: Scratch | None,
) -> Assessment:
    """Return the assessment with all stages run in process, or through a graph, which has a scratch folder."""
    plan = assessment.plan
    if scratch is None:
        limit = arguments.startup_timeout
        workers = runner_of(arguments, isolated=plan.runs_others_code, answer_limit=limit)
        context = Context(kept.runner(workers), workers, fresh=partial(fresh_process, limit), **request)
        return assess_in_process(context, assessment)
    bags = scratch.folder / "bags" if arguments.record else None
    options, simulator = graph_options(arguments), plan.simulator
    setting = GraphSetting(options=options, car=plan.car, log_folder=scratch.logs, simulator=simulator, record_to=bags)
    return assess_through_graph(assessment, setting, request, kept.runner)


def _steps(plan: Plan, request: Mapping[str, Any]) -> list[str]:
    """Return how the labels of each step of an assessment begin, in order."""
    steps = ["learning the car"] if needs_learning(plan) else []
    steps += ["safe trajectories"] if plan.safe in options.GENERATED else []
    steps += ["nominal runs", "kamikazes", *(["margin"] if request["margin_limit"] else [])]
    steps += ["risk"] if request["risk"].behaviour is not None else []
    return [*steps, "price of caution"]


def _write(folder: Path, assessment: Assessment, arguments: argparse.Namespace, scratch: Scratch | None) -> None:
    """Write an assessment, with its pictures if they are requested, and what a graph left."""

    def write(where: Path) -> None:
        if arguments.pictures:
            fill(where, assessment, may_fork=scratch is None)
        else:
            write_assessment(where, assessment)

    (write if scratch is None else with_scratch(scratch.folder, write))(folder)


class KeptEpisodes:
    """Episodes that are kept as soon as they have run, until the results are written."""

    def __init__(self, arguments: argparse.Namespace, begun: Mapping[str, Any], out: Path) -> None:
        """Open the file, or begin it.

        Args:
            arguments: of the command.
            begun: what the episodes follow from; see `begun_with`.
            out: folder of the results.

        Raises:
            UsageError: --resume is given, and what is kept is of other options, files or versions; says which.
        """
        self._arguments, self._out, self._path = arguments, out, unfinished(out)
        if arguments.resume is None:
            remove_files(self._path)
        self._store = EpisodeStore(self._path)
        if not (then := self._store.about()):
            self._store.write_about(begun)
            return
        try:
            _check_the_same(then, begun)
        except UsageError:
            self._store.close()
            raise

    def runner(self, runner: Runner) -> Runner:
        """Return a runner that reads what there is, and keeps what it runs."""
        return StoringRunner(runner, self._store, b"", threading.Event())

    def _count(self) -> str:
        number = self._store.count()
        return f"{number} episode{'s' if number != 1 else ''} kept in {self._path}" if number else ""

    def _go_on(self) -> str:
        """Return the command that goes on."""
        return shlex.join([program(), "assess", "--resume", str(self._out)])

    def interrupted(self) -> int:
        """Say in one line how to go on, and return the exit code."""
        if self._arguments.json:
            print_json({"interrupted": True, "episodes": self._store.count(), "resume": self._go_on()})
        kept = self._count()
        anew = "" if self._arguments.graph else "; margin, risk and price begin anew"
        again = f"{kept}{anew}; go on with: {self._go_on()}" if kept else "nothing was written"
        say(self._arguments.command, f"interrupted; {again}")
        return EXIT_INTERRUPTED

    def failed(self, error: AssessmentError | OutOfReachError) -> AssessmentError | OutOfReachError:
        """Return the error with how to go on."""
        kept = self._count()
        return type(error)(f"{error}; {kept}; go on with: {self._go_on()}") if kept else error

    def close(self, *, done: bool) -> None:
        """Let go of the file; remove it when the results are written, or nothing is in it."""
        if done or not self._store.count():
            self._store.remove()
        else:
            self._store.close()


def begun_with(arguments: argparse.Namespace, plan: Plan) -> dict[str, Any]:
    """Return what the episodes of an assessment follow from, as plain data, and how it was begun."""
    tables = (options.CampaignOptions, options.AssessmentOptions, options.GraphOptions)
    names = {one.name for table in tables for one in options_of(table) if "assess" in one.commands}
    names = (names | {"graph", "scenario", "until_width"}) - options.OF_NO_RESULT - {"name"}
    return {
        "words": arguments.command_line[2:],
        "folder": str(Path.cwd()),
        "options": {name: str(getattr(arguments, name)) for name in sorted(names)},
        "scenario": plan.scenario.as_dict(),
        "files": code_files(plan.car, arguments.controller_command or ""),
        "inputs": sums_of(map(str, filter(None, (arguments.safe, arguments.behaviour, arguments.car_model)))),
        "environment": dict(environment()),
    }


def digest_of_inputs(begun: Mapping[str, Any], arguments: argparse.Namespace) -> str | None:
    """Return the SHA-256 of all that an assessment follows from; None where that is not known, or need not repeat.

    So it is of a graph, and of plug-ins beside the car.
    """
    own = all(name in OBJECTIVES.own for name in objectives_named(arguments.objective))
    known = begun["files"] is not None and len(begun["inputs"]) < MOST_FILES
    if arguments.graph or not (known and own and is_own_world(arguments.simulator)):
        return None
    options = {**begun["options"], "warm_start": "", "max_aborted": arguments.max_aborted}
    content = {**begun, "words": [], "options": options}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _check_the_same(then: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Refuse to go on where an option, a file or a version has changed, and say which.

    New files are named and accepted: what ran before did not read them.

    Raises:
        UsageError: something has changed.
    """
    new = []
    for key, (first, second) in changes({**then, "words": 0}, {**now, "words": 0}).items():
        part, _, name = key.partition(".")
        name = from_here(name)
        what, advice = f"{name} was {first} and is now {second}", "put it back"
        if part == "options":
            what, advice = f"--{name.replace('_', '-')} was {first} and is now {second}", "leave it out"
        elif part in ("files", "inputs") and first is None:
            new.append(name)
            continue
        elif part in ("files", "inputs"):
            what = f"{name} {'has gone' if second is None else 'has changed'}"
        raise UsageError(f"--resume: {what}; {advice}, or begin anew with --overwrite")
    if new:
        more = f" and {len(new) - 1} more" if len(new) > 1 else ""
        say("assess", f"--resume: new since then, and not taken for a part of the car: {new[0]}{more}")


_SHOWN = 10


def print_result(
    assessment: Assessment,
    out: ResultFolder,
    arguments: argparse.Namespace,
    gate: Gate,
    problem: str | None = None,
    said: Collection[str] = (),
    result: Mapping[str, Any] | None = None,
) -> int:
    """Print an assessment and where it is, check the gate's conditions, and return the exit code.

    Args:
        assessment: what was found.
        out: folder to which the result was written.
        arguments: arguments of the command.
        gate: the conditions that it has to meet.
        problem: why the result is not where it was requested; None if it is.
        said: warnings of the assessment that were printed before.
        result: content of assessment.json, where the assessment is of its episodes alone, which are not all.
    """
    result = result or assessment.as_dict()
    if arguments.json:
        print_json(result)
    else:
        print_tables(result, details=arguments.details)
        seconds = f"{result['seconds']:.1f} s"
        more = "" if arguments.details else "; --details prints every figure, SKD among them"
        print(seconds if problem else f"{seconds}; results in {out.path}{more}")
    warn(arguments.command, warnings_of(assessment, said=said))
    failures = [*([problem] if problem else []), *why_failed(assessment, arguments.max_aborted, result)]
    checks = gate.checks(result, None if problem else out.path, failures)
    if len(checks) > 1 and checks[0].error and not failures:
        failures.append(f"gate: nothing can be said of the car: {checks[0].text}")
    for one in checks[1:]:  # the first is of the failures above
        lines = [f"gate: {one.name}: {one.state}, {one.text}", *(f"  {line}" for line in one.remarks)]
        if not (arguments.json or arguments.quiet):
            print(*lines, sep="\n")
        elif not one.passed:
            failures += lines
    if unmet := [one.name for one in checks[1:] if not one.passed]:
        failures.append(f"gate: {len(unmet)} of {len(checks) - 1} conditions not passed: {', '.join(unmet)}")
    if unwritten := gate.write(result, checks):
        failures.append(unwritten)
    say(arguments.command, *failures)
    # How many of which is among the warnings, and the reason among the failures, if they are too many.
    logs = out.path / "logs"
    if assessment.reasons and (logs.is_dir() or not any(most_frequent(assessment.reasons) in why for why in failures)):
        say(arguments.command, f"why episodes were aborted: {why_aborted(assessment.reasons, logs)}")
    return 1 if failures else 0


def why_aborted(reasons: Sequence[str], logs: Path) -> str:
    """Return in words why episodes were aborted: which log of a graph says more, or else the most frequent reason."""
    first = most_frequent(reasons)
    more = f"log: {log_of(logs, first)}" if logs.is_dir() else f"the first one so: {first}"
    return f"{counts_in_words(reasons)}; {more}"


def print_tables(result: Mapping[str, Any], *, details: bool) -> None:
    """Print what was found, in a sentence and a few rows, or with all details, from the content of assessment.json."""
    print(terminal.headline(result))
    if (table := terminal.headline_table(result)).row_count:
        terminal.print_table(table)
    beside = reference_text(result.get("reference") or ())
    said = [*terminal.missing_figures(result), beside and f"Reference drivers: {beside}."]
    for line in filter(None, (*said, terminal.command_ages(result), terminal.few_safe_trajectories(result))):
        print(line)
    if not details:
        return
    if result["equivalent_multiplier_note"]:
        print(f"Equivalent multiplier: {result['equivalent_multiplier_note']}")
    for table_of in (terminal.details_table, terminal.surrogate_table, terminal.safe_trajectory_table):
        if further := table_of(result):
            terminal.print_table(further)
    for note in terminal.interval_notes(result):
        print(f"Interval of {note}")
    if result["until_width"]:
        print(f"Stopped {result['until_width']['text']}")


def say_damage(command: str, damage: Damage) -> None:
    """Say what was left out of recordings, and what is to be known of the rest."""
    say_left_out(command, damage)
    warn(command, damage.warnings)
    if damage.unchecked:
        files = counted(len(damage.unchecked), "file")
        first = f"{damage.unchecked[0]}, …" if len(damage.unchecked) > 1 else f"{damage.unchecked[0]}"
        why = "damage that leaves a possible episode cannot be noticed there"
        warn(command, [f"{files} without checksums ({first}): {why}"])


def say_left_out(command: str, damage: Damage) -> None:
    """Say what was left out of recordings, the first of it in full."""
    lines = [f"left out: {line}" for line in damage.left_out[:_SHOWN]]
    if len(damage.left_out) > _SHOWN:
        lines.append(f"left out: {len(damage.left_out) - _SHOWN} more")
    warn(command, lines)
