"""`skd probe`: episodes that show how a car reacts, for `skd fit`."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from skd_sim.options.car_and_adversary import CarUnderTest, is_own_world

from skd_evaluator.cli.arguments import Parser, graph_options, result_folder, runner_of
from skd_evaluator.cli.output import EXIT_INTERRUPTED, finish, say
from skd_evaluator.version import version

if TYPE_CHECKING:
    from skd_sim.world.episode import EpisodeLog

    from skd_evaluator.assessment.context import Runner
    from skd_evaluator.assessment.files.result_folder import Scratch


def add(parser: Parser) -> None:
    """Run episodes that show how a car reacts, for skd fit.

    Run varied crossings that show when and how a car brakes. They are kept for skd fit: as episodes.npz, with --graph
    as bags.
    """
    parser.set_defaults(group="research", rare=True)
    parser.add_car()
    parser.add_count("--episodes", 1, 1_000_000, "how many episodes to run", default=1000)
    parser.add_options("campaign")
    parser.add_workers()
    parser.add_graph()
    parser.add_parameters()
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_sim.scenario.scenario import load_scenario
    from skd_sim.simulators.simulator import make_simulator
    from skd_sim.world.episode import Outcome

    from skd_evaluator.assessment.files.episodes_npz import EPISODES, write_probes
    from skd_evaluator.assessment.files.result_folder import write_json
    from skd_evaluator.assessment.from_options import check_car
    from skd_evaluator.assessment.plan import probe_episodes
    from skd_evaluator.cli.assessment import why_aborted
    from skd_evaluator.metrics.aborted import not_credible
    from skd_evaluator.report.formats import counted
    from skd_evaluator.report.presentation import with_scratch
    from skd_evaluator.report.progress import progress_bar
    from skd_evaluator.ros.session import prepare_ros

    begin = time.perf_counter()
    scenario = check_car(vars(arguments), load_scenario(arguments.scenario or "crossing"), graph=arguments.graph)
    make_simulator(arguments.simulator)
    car = CarUnderTest(arguments.controller, arguments.multiplier)
    whose = {"seed": arguments.seed, "controller": car.controller, "multiplier": car.multiplier}
    probes = probe_episodes(scenario, arguments.episodes, **whose)
    episodes = [replace(one, simulator=arguments.simulator) for one in probes]
    if arguments.graph:
        prepare_ros(graph_options(arguments))
    out = result_folder(arguments)
    logs: list[EpisodeLog] = []

    def collect(runner: Runner) -> None:
        with progress_bar(quiet=arguments.quiet) as progress:
            for log in runner.run(episodes):
                logs.append(log)
                progress("probe", len(logs), len(episodes))

    def write(folder: Path) -> None:
        write_json(folder / "probe.json", summary)
        if not arguments.graph:  # the graph leaves bags
            write_probes(folder / EPISODES, logs)

    with out.scratch() if arguments.graph else nullcontext() as scratch:
        try:
            warnings = _run(arguments, car, collect, logs, scratch)
        except KeyboardInterrupt:
            say("probe", f"interrupted after {len(logs)} of {len(episodes)} episodes; nothing was written")
            return EXIT_INTERRUPTED
        summary = {
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
        problem = out.save(write if scratch is None else with_scratch(scratch.folder, write))
    aborted = [log.reason for log in logs if log.outcome == Outcome.ABORTED]

    def show() -> None:
        ends = ", ".join(f"{count} {name}" for name, count in summary["outcomes"].items())
        print(f"episodes: {len(logs)} ({ends}), ticks: {summary['ticks']}")

    failures = not_credible(warnings)
    other = [one for one in warnings if one not in failures]
    every = f"all episodes were aborted: {aborted[0]}" if len(aborted) == len(logs) else None
    saved = problem, f"logs in {out.path}; next: skd fit {out.path}"
    code = finish(arguments, summary, show, other, [*failures, every], saved=saved, since=begin)
    if aborted:
        many = f"{len(aborted)} of {counted(len(logs), 'episode')} aborted"
        say("probe", f"{many}: {why_aborted(aborted, out.path / 'logs')}")
    return code


def _run(
    arguments: argparse.Namespace,
    car: CarUnderTest,
    collect: Callable[[Runner], None],
    logs: Sequence[EpisodeLog],
    scratch: Scratch | None,
) -> tuple[str, ...]:
    """Collect logs of this process, or of a graph, which has a scratch folder; return warnings."""
    from skd_evaluator.assessment.stages.checks import fresh_process, repeatability
    from skd_evaluator.ros.processes import GraphSetting
    from skd_evaluator.ros.session import fresh_graph, graph_session

    if scratch is None:
        isolated = not (car.is_own and is_own_world(arguments.simulator))
        with runner_of(arguments, isolated=isolated, answer_limit=arguments.startup_timeout) as runner:
            runner.start()
            collect(runner)
        return () if car.is_own else repeatability(car.controller, logs, fresh_process)
    warnings: tuple[str, ...] = ()
    setting = GraphSetting(
        options=graph_options(arguments), car=car, log_folder=scratch.logs, simulator=arguments.simulator,
        record_to=scratch.folder / "bags",
    )  # fmt: skip
    with graph_session(setting) as evaluator:
        collect(evaluator)
        if (fresh := fresh_graph(evaluator, setting)) is not None:
            warnings = repeatability(car.controller, logs, fresh)
    if (fresh := fresh_graph(None, setting)) is not None:
        warnings = repeatability(car.controller, logs, fresh)
    return warnings
