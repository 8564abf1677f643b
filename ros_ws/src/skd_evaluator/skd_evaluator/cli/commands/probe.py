"""`skd probe`: episodes that show how a car reacts, for `skd fit`."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skd_sim.options.car_under_test import CarUnderTest, is_own_world

from skd_evaluator.cli.arguments import (
    add_car_arguments,
    add_count,
    add_graph_arguments,
    add_options,
    add_output_arguments,
    add_parameters,
    add_workers_argument,
    graph_options,
    result_folder,
    runner_of,
)
from skd_evaluator.cli.output import finish, say
from skd_evaluator.cli.parser import EXIT_INTERRUPTED, Parser

if TYPE_CHECKING:
    from skd_sim.world.episode import EpisodeLog, EpisodeSpec

    from skd_evaluator.assessment.context import Runner
    from skd_evaluator.assessment.files.result_folder import ResultFolder


def add(parser: Parser) -> None:
    """Run episodes that show how a car reacts, for skd fit.

    Run varied crossings that show when and how a car brakes. They are kept for skd fit: as episodes.npz, with --graph
    as bags.
    """
    parser.set_defaults(group="research")
    add_car_arguments(parser, "probe")
    add_count(parser, "--episodes", 1, 1_000_000, "how many episodes to run", default=1000)
    add_options(parser, "probe", "campaign")
    add_workers_argument(parser)
    add_graph_arguments(parser, "probe", optional=True, record=False)
    add_parameters(parser)
    add_output_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_sim.scenario.scenario import load_scenario
    from skd_sim.simulators.simulator import make_simulator
    from skd_sim.world.episode import Outcome

    from skd_evaluator.assessment.from_options import check_car
    from skd_evaluator.assessment.plan import probe_episodes
    from skd_evaluator.cli.results import say_aborted
    from skd_evaluator.metrics.aborted import not_credible
    from skd_evaluator.ros.session import prepare_ros

    begin = time.perf_counter()
    scenario = check_car(vars(arguments), load_scenario(arguments.scenario or "crossing"), graph=arguments.graph)
    make_simulator(arguments.simulator)
    car = CarUnderTest(arguments.controller, arguments.multiplier)
    probes = probe_episodes(
        scenario, arguments.episodes, seed=arguments.seed, controller=car.controller, multiplier=car.multiplier
    )
    episodes = [replace(one, simulator=arguments.simulator) for one in probes]
    if arguments.graph:
        prepare_ros(graph_options(arguments))
    out = result_folder(arguments)
    logs: list[EpisodeLog] = []
    try:
        warnings, problem = (_through_graph if arguments.graph else _in_process)(arguments, car, episodes, out, logs)
    except KeyboardInterrupt:
        say("probe", f"interrupted after {len(logs)} of {len(episodes)} episodes; nothing was written")
        return EXIT_INTERRUPTED
    aborted = [log.reason for log in logs if log.outcome == Outcome.ABORTED]
    summary = _summary(arguments, car, logs, warnings)

    def show() -> None:
        ends = ", ".join(f"{count} {name}" for name, count in summary["outcomes"].items())
        print(f"episodes: {len(logs)} ({ends}), ticks: {summary['ticks']}")
        seconds = f"{time.perf_counter() - begin:.1f} s"
        print(seconds if problem else f"{seconds}; logs in {out.path}; next: skd fit {out.path}")

    failures = [*not_credible(warnings), problem]
    every = f"all episodes were aborted: {aborted[0]}" if len(aborted) == len(logs) else None
    code = finish(arguments, summary, show, [one for one in warnings if one not in failures], [*failures, every])
    say_aborted("probe", aborted, len(logs), out)
    return code


def _collect(runner: Runner, episodes: Sequence[EpisodeSpec], logs: list[EpisodeLog], *, quiet: bool) -> None:
    """Run episodes, and add their logs to others, one by one."""
    from skd_evaluator.report.progress import progress_bar

    with progress_bar(quiet=quiet) as progress:
        for log in runner.run(episodes):
            logs.append(log)
            progress("probe", len(logs), len(episodes))


def _in_process(
    arguments: argparse.Namespace,
    car: CarUnderTest,
    episodes: Sequence[EpisodeSpec],
    out: ResultFolder,
    logs: list[EpisodeLog],
) -> tuple[tuple[str, ...], str | None]:
    """Return warnings, and why the logs could not be written, if so."""
    from skd_evaluator.assessment.stages.checks import fresh_process, repeatability

    isolated = not (car.is_own and is_own_world(arguments.simulator))
    with runner_of(arguments, isolated=isolated, answer_limit=arguments.startup_timeout) as runner:
        runner.start()
        _collect(runner, episodes, logs, quiet=arguments.quiet)
    warnings = () if car.is_own else repeatability(car.controller, logs, fresh_process)
    return warnings, out.save(lambda folder: _write(folder, arguments, car, logs, warnings))


def _through_graph(
    arguments: argparse.Namespace,
    car: CarUnderTest,
    episodes: Sequence[EpisodeSpec],
    out: ResultFolder,
    logs: list[EpisodeLog],
) -> tuple[tuple[str, ...], str | None]:
    from skd_evaluator.assessment.stages.checks import repeatability
    from skd_evaluator.report.presentation import save_with_scratch
    from skd_evaluator.ros.processes import GraphSetting
    from skd_evaluator.ros.session import fresh_graph, graph_session

    warnings: tuple[str, ...] = ()
    with out.scratch() as scratch:
        setting = GraphSetting(
            options=graph_options(arguments), car=car, log_folder=scratch.logs, simulator=arguments.simulator,
            record_to=scratch.folder / "bags",
        )  # fmt: skip
        with graph_session(setting) as evaluator:
            _collect(evaluator, episodes, logs, quiet=arguments.quiet)
            if (fresh := fresh_graph(evaluator, setting)) is not None:
                warnings = repeatability(car.controller, logs, fresh)
        if (fresh := fresh_graph(None, setting)) is not None:
            warnings = repeatability(car.controller, logs, fresh)
        problem = save_with_scratch(out, scratch.folder, lambda folder: _write(folder, arguments, car, logs, warnings))
    return warnings, problem


def _summary(
    arguments: argparse.Namespace, car: CarUnderTest, logs: Sequence[EpisodeLog], warnings: Sequence[str]
) -> dict[str, Any]:
    from skd_evaluator.version import version

    return {
        "episodes": len(logs),
        "ticks": sum(len(log.adversary) - 1 for log in logs),
        "outcomes": dict(sorted(Counter(log.outcome.name.lower() for log in logs).items())),
        "controller": car.controller,
        "multiplier": car.stated_multiplier,
        "seed": arguments.seed,
        "scenario": logs[0].episode.scenario.as_dict(),
        "version": version(),
        "warnings": list(warnings),
    }


def _write(
    folder: Path,
    arguments: argparse.Namespace,
    car: CarUnderTest,
    logs: Sequence[EpisodeLog],
    warnings: Sequence[str],
) -> None:
    from skd_evaluator.assessment.files.episodes_npz import EPISODES, write_probes
    from skd_evaluator.assessment.files.result_folder import write_json

    write_json(folder / "probe.json", _summary(arguments, car, logs, warnings))
    if not arguments.graph:  # the graph leaves bags
        write_probes(folder / EPISODES, logs)
