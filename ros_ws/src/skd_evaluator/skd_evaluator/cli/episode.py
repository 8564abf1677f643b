"""`skd episode`: one episode through the node graph, recorded."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from skd_sim.episode import Mode, Outcome

from skd_evaluator.campaign import Plan, single_episode
from skd_evaluator.cli.arguments import output_path
from skd_evaluator.cli.assess import check_controller, graph_options, scenario_for
from skd_evaluator.results import ResultFolder, episode_summary, write_json


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    check_controller(arguments, graph=True)
    plan = Plan(
        scenario=scenario_for(arguments.scenario, arguments.safe),
        controller=arguments.controller,
        multiplier=arguments.multiplier,
        safe=arguments.safe,
        safe_count=1,
        seed=arguments.seed,
        simulations=arguments.simulations,
    )
    out = ResultFolder(output_path(arguments), overwrite=arguments.overwrite)
    episode = single_episode(plan, Mode[arguments.mode.upper()], arguments.attempt)
    from skd_evaluator.graph.session import campaign_name, graph_session  # imports ROS, or what stands for it

    with out.scratch() as scratch:
        session = graph_session(
            graph_options(arguments),
            controller=plan.controller,
            campaign=campaign_name(plan.controller, plan.multiplier, plan.seed),
            log_folder=scratch / "logs",
            record_to=scratch / "bags",
        )
        with session as evaluator:
            log = evaluator.run_episode(episode)
        summary = episode_summary(log)

        def write(folder: Path) -> None:
            write_json(folder / "episode.json", summary)
            for part in scratch.iterdir():
                part.rename(folder / part.name)

        out.write(write)
    if arguments.json:
        print(json.dumps(summary, indent=2, ensure_ascii=False))
    else:
        impact = ""
        if log.outcome == Outcome.COLLISION:
            impact = f" after {log.impact_time:.2f} s at {log.impact_speed:.2f} m/s"
        print(f"{log.outcome.name.lower()}{impact}; {len(log.pedestrian) - 1} ticks; bag and logs in {out.path}")
    if log.outcome == Outcome.ABORTED:
        print(f"skd episode: aborted: {log.reason}", file=sys.stderr)
        return 1
    return 0
