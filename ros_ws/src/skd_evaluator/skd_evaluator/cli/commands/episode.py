"""`skd episode`: one episode through the node graph, recorded."""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial

from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import OBJECTIVES

from skd_evaluator.assessment.options import AssessmentOptions, CampaignOptions
from skd_evaluator.cli.arguments import Parser, graph_options, positive_number, rare, result_folder
from skd_evaluator.cli.output import finish, say


def add(parser: Parser) -> None:
    """Run one episode through the node graph and record it.

    Run one episode through the node graph and record it as a bag.
    """
    parser.set_defaults(group="rate")
    parser.add_car()
    text = "the adversary crosses safely, is hit, follows φ, or walks φ with natural variation"
    parser.add_value("--mode", text, choices=("safe", "kamikaze", "replay", "risk"), default="kamikaze")
    parser.add_options(table=AssessmentOptions, hidden=("behaviour",))
    text = rare("with --mode risk, by what the deviations of people are multiplied (default: 1)")
    parser.add_value("--scale", text, type=positive_number, default=1.0, metavar="S")
    parser.add_count("--trial", 0, 2**63 - 1, "which trial of the assessment to repeat, from 0", default=0)
    # A single episode has one objective, and one φ: that of a campaign with as many.
    text = "what the kamikaze is rewarded for: deviation, paper or frechet (default: %(default)s)"
    single = {"default": str(CampaignOptions.objective), "choices": OBJECTIVES, "metavar": "NAME", "help": text}
    parser.add_options("campaign", hidden=("simulations",), objective=single)
    text = "how many safe trajectories the assessment has to which this episode belongs"
    parser.add_count("--safe-count", 1, 65_535, text, default=1)
    parser.add_count("--safe-number", 0, 65_534, "which of them the episode is about, from 0", default=0)
    parser.add_graph(optional=False)
    parser.add_parameters()
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_sim.world.episode import Mode, Outcome

    from skd_evaluator.assessment.files.results import episode_summary
    from skd_evaluator.assessment.from_options import check_car, plan_of, scenario_for
    from skd_evaluator.assessment.stages.car_model import graph_settings, learned
    from skd_evaluator.assessment.stages.pipeline import compile_for_graph
    from skd_evaluator.assessment.stages.risk import single_crossing, unchanged_behaviour
    from skd_evaluator.assessment.stages.safe_trajectories import single_episode
    from skd_evaluator.report.presentation import episode_line, fill_episode, with_scratch
    from skd_evaluator.ros.processes import GraphSetting, log_of
    from skd_evaluator.ros.session import graph_session, prepare_ros

    plan = plan_of(vars(arguments), scenario_for(arguments.scenario, arguments.safe))
    plan = replace(plan, scenario=check_car(vars(arguments), plan.scenario, graph=True))
    number, trial, graph = arguments.safe_number, arguments.trial, graph_options(arguments)
    if number >= plan.safe_count:
        there = f"there are {plan.safe_count} safe trajectories, numbered from 0; --safe-count says how many"
        raise UsageError(f"--safe-number {number}: {there}")
    prepare_ros(graph)
    out = result_folder(arguments)
    if arguments.mode == "risk":
        episode = single_crossing(plan, unchanged_behaviour(arguments.behaviour), number, trial, arguments.scale)
    else:
        episode = single_episode(plan, Mode[arguments.mode.upper()], trial, safe_number=number)
    compile_for_graph(plan, [plan.objective])
    with out.scratch() as scratch:
        bags = scratch.folder / "bags"
        setting = GraphSetting(
            options=graph, car=plan.car, log_folder=scratch.logs, simulator=plan.simulator, record_to=bags
        )
        with graph_session(setting) as evaluator:
            if episode.mode == Mode.KAMIKAZE:  # no other mode plans against the car
                plan = learned(plan, evaluator, say=partial(say, "episode"), graph=graph_settings(graph))
                episode = replace(episode, car_model=plan.car_model)
            log = evaluator.run_episode(episode)
        out.write(with_scratch(scratch.folder, lambda folder: fill_episode(folder, log)))
    aborted = None
    if log.outcome == Outcome.ABORTED:
        aborted = f"aborted: {log.reason}; log: {log_of(out.path / 'logs', log.reason)}"
    where = f"{episode_line(log)}; bag and logs in {out.path}"
    return finish(arguments, episode_summary(log), lambda: print(where), failures=[aborted])
