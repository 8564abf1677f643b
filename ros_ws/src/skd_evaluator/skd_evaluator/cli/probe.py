"""`skd probe`: episodes that show how a car reacts, for `skd fit`."""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from skd_sim.options.car_under_test import CarUnderTest, is_own_world
from skd_sim.scenario.scenario import load_scenario
from skd_sim.simulators.simulator import make_simulator
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Outcome

from skd_evaluator.assessment.context import Progress, Recorder, Runner
from skd_evaluator.assessment.files.episodes_npz import EPISODES, write_probes
from skd_evaluator.assessment.files.result_folder import ResultFolder, write_json
from skd_evaluator.assessment.from_options import check_car
from skd_evaluator.assessment.plan import probe_episodes
from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers
from skd_evaluator.assessment.stages.checks import fresh_process, repeatability
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.assess import EXIT_INTERRUPTED, graph_options, say_aborted
from skd_evaluator.cli.output import print_json
from skd_evaluator.metrics.aborted import not_credible
from skd_evaluator.report.presentation import write_with_scratch
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.ros.processes import GraphSetting
from skd_evaluator.ros.session import fresh_graph, graph_session, prepare_ros
from skd_evaluator.version import version


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    begin = time.perf_counter()
    scenario = load_scenario(arguments.scenario or "crossing")
    scenario = check_car(vars(arguments), scenario, graph=arguments.graph)
    make_simulator(arguments.simulator)
    probes = probe_episodes(
        scenario,
        arguments.episodes,
        seed=arguments.seed,
        controller=arguments.controller,
        multiplier=arguments.multiplier,
    )
    episodes = [replace(one, simulator=arguments.simulator) for one in probes]
    if arguments.graph:
        prepare_ros(graph_options(arguments))
    out = result_folder(arguments)
    problem: str | None = None
    warnings: tuple[str, ...] = ()
    if arguments.graph:
        logs, warnings = _through_graph(arguments, episodes, out)
    else:
        car = _car(arguments)
        workers = arguments.workers or available_workers()
        isolated = not (car.is_own and is_own_world(arguments.simulator))
        runner = InProcessRunner(workers, isolated=isolated, answer_limit=arguments.startup_timeout)
        recorder = Recorder(runner)
        try:
            with runner:
                runner.start()
                with progress_bar(quiet=arguments.quiet) as progress:
                    logs = _collect(recorder, episodes, progress)
        except KeyboardInterrupt:
            done = f"{len(recorder.logs)} of {len(episodes)} episodes"
            print(f"skd probe: interrupted after {done}; nothing was written", file=sys.stderr)
            return EXIT_INTERRUPTED
        if not car.is_own:
            warnings = repeatability(car.controller, logs, fresh_process)
        problem = out.save(lambda folder: _fill(folder, arguments, logs, warnings))
    aborted = [log for log in logs if log.outcome == Outcome.ABORTED]
    summary = _summary(arguments, logs, warnings)
    if arguments.json:
        print_json(summary)
    else:
        ends = ", ".join(f"{count} {name}" for name, count in summary["outcomes"].items())
        print(f"episodes: {len(logs)} ({ends}), ticks: {summary['ticks']}")
        seconds = f"{time.perf_counter() - begin:.1f} s"
        print(seconds if problem else f"{seconds}; logs in {out.path}; next: skd fit {out.path}")
    for line in warnings:
        print(f"skd probe: {'' if not_credible([line]) else 'warning: '}{line}", file=sys.stderr)
    if problem:
        print(f"skd probe: {problem}", file=sys.stderr)
    if problem or not_credible(warnings):
        return 1
    say_aborted("probe", [log.reason for log in aborted], len(logs), out)
    if len(aborted) == len(logs):
        print(f"skd probe: all episodes were aborted: {aborted[0].reason}", file=sys.stderr)
        return 1
    return 0


def _car(arguments: argparse.Namespace) -> CarUnderTest:
    return CarUnderTest(arguments.controller, arguments.multiplier)


def _collect(runner: Runner, episodes: Sequence[EpisodeSpec], progress: Progress) -> list[EpisodeLog]:
    logs = []
    for log in runner.run(episodes):
        logs.append(log)
        progress("probe", len(logs), len(episodes))
    return logs


def _through_graph(
    arguments: argparse.Namespace, episodes: Sequence[EpisodeSpec], out: ResultFolder
) -> tuple[list[EpisodeLog], tuple[str, ...]]:
    car = _car(arguments)
    warnings: tuple[str, ...] = ()
    with out.scratch() as scratch, progress_bar(quiet=arguments.quiet) as progress:
        setting = GraphSetting(
            options=graph_options(arguments),
            car=car,
            log_folder=scratch.logs,
            simulator=arguments.simulator,
            record_to=scratch.folder / "bags",
        )
        with graph_session(setting) as evaluator:
            logs = _collect(evaluator, episodes, progress)
            if (fresh := fresh_graph(evaluator, setting)) is not None:
                warnings = repeatability(car.controller, logs, fresh)
        if (fresh := fresh_graph(None, setting)) is not None:
            warnings = repeatability(car.controller, logs, fresh)
        write_with_scratch(out, scratch.folder, lambda folder: _fill(folder, arguments, logs, warnings))
    return logs, warnings


def _summary(arguments: argparse.Namespace, logs: Sequence[EpisodeLog], warnings: Sequence[str] = ()) -> dict[str, Any]:
    return {
        "episodes": len(logs),
        "ticks": sum(len(log.adversary) - 1 for log in logs),
        "outcomes": dict(sorted(Counter(log.outcome.name.lower() for log in logs).items())),
        "controller": arguments.controller,
        "multiplier": _car(arguments).stated_multiplier,
        "seed": arguments.seed,
        "scenario": logs[0].episode.scenario.as_dict(),
        "version": version(),
        "warnings": list(warnings),
    }


def _fill(
    folder: Path, arguments: argparse.Namespace, logs: Sequence[EpisodeLog], warnings: Sequence[str] = ()
) -> None:
    write_json(folder / "probe.json", _summary(arguments, logs, warnings))
    if not arguments.graph:  # the graph leaves bags
        write_probes(folder / EPISODES, logs)
