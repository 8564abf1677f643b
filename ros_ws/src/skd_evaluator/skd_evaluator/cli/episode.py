"""`skd episode`: one episode through the node graph, recorded."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from functools import partial

from skd_sim.errors import UsageError
from skd_sim.world.episode import Mode, Outcome

from skd_evaluator.assessment.files.results import episode_summary
from skd_evaluator.assessment.from_options import check_car, plan_of, scenario_for
from skd_evaluator.assessment.stages.car_model import graph_settings, learned
from skd_evaluator.assessment.stages.pipeline import compile_for_graph
from skd_evaluator.assessment.stages.risk import single_crossing, unchanged_behaviour
from skd_evaluator.assessment.stages.safe_trajectories import single_episode
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.assess import graph_options, say
from skd_evaluator.cli.output import print_json
from skd_evaluator.report.presentation import episode_line, fill_episode, write_with_scratch
from skd_evaluator.ros.processes import GraphSetting, log_of
from skd_evaluator.ros.session import graph_session, prepare_ros


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    plan = plan_of(vars(arguments), scenario_for(arguments.scenario, arguments.safe))
    plan = replace(plan, scenario=check_car(vars(arguments), plan.scenario, graph=True))
    if arguments.safe_number >= plan.safe_count:
        raise UsageError(
            f"--safe-number {arguments.safe_number}: there are {plan.safe_count} safe trajectories, numbered from 0; "
            "--safe-count says how many"
        )
    prepare_ros(graph_options(arguments))
    out = result_folder(arguments)
    number, trial = arguments.safe_number, arguments.trial
    if arguments.mode == "risk":
        episode = single_crossing(plan, unchanged_behaviour(arguments.behaviour), number, trial, arguments.scale)
    else:
        episode = single_episode(plan, Mode[arguments.mode.upper()], trial, safe_number=number)
    compile_for_graph(plan, [plan.objective])
    with out.scratch() as scratch:
        setting = GraphSetting(
            options=graph_options(arguments),
            car=plan.car,
            log_folder=scratch.logs,
            simulator=plan.simulator,
            record_to=scratch.folder / "bags",
        )
        with graph_session(setting) as evaluator:
            if episode.mode == Mode.KAMIKAZE:  # nobody else plans against the car
                graph = graph_options(arguments)
                plan = learned(
                    plan,
                    evaluator,
                    say=partial(say, arguments.command),
                    graph=graph_settings(graph),
                )
                episode = replace(episode, car_model=plan.car_model)
            log = evaluator.run_episode(episode)
        write_with_scratch(out, scratch.folder, lambda folder: fill_episode(folder, log))
    if arguments.json:
        print_json(episode_summary(log))
    else:
        print(f"{episode_line(log)}; bag and logs in {out.path}")
    if log.outcome == Outcome.ABORTED:
        log_file = log_of(out.path / "logs", log.reason)
        print(f"skd episode: aborted: {log.reason}; log: {log_file}", file=sys.stderr)
        return 1
    return 0
