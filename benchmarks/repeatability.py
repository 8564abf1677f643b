"""How repeatable a car of somebody else's is: the same episodes twice through the graph, and how many are identical.

Takes the options of the node graph that `skd episode` has, as in docs/your_controller.md, section Real time.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from skd_evaluator.assessing.asked import with_asked_period
from skd_evaluator.assessing.graph_options import GraphOptions
from skd_evaluator.campaign.judge.command_age import command_age
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.cli.arguments import add_graph_arguments, whole_number
from skd_evaluator.cli.commands.assess import graph_options
from skd_evaluator.ros.session import graph_session, prepare_ros
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.geometry.trajectory import Trajectory


def episodes(count: int, options: GraphOptions) -> list[Episode]:
    """Return runs along a straight φ, each with draws of its own; nobody plans."""
    scenario = with_asked_period(load_scenario("crossing"), options.control_period)
    x = np.minimum(-3.5 + 0.75 * np.arange(11), 2.5)
    phi = Trajectory(np.column_stack([x, np.zeros_like(x)]), scenario.time_step, "straight")
    plan = Plan(scenario, controller="external")
    return [plan.episode(Mode.REPLAY, 0, number, phi) for number in range(count)]


def run(wanted: list[Episode], options: GraphOptions) -> list[EpisodeLog]:
    """Return what becomes of episodes in a graph of their own."""
    with (
        tempfile.TemporaryDirectory() as logs,
        graph_session(
            options, controller="external", campaign="repeatability", log_folder=Path(logs), record_to=None
        ) as evaluator,
    ):
        return list(evaluator.run(wanted))


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=whole_number(1), default=30, metavar="N")
    add_graph_arguments(parser, "episode", optional=False)
    arguments = parser.parse_args()
    options = graph_options(arguments)
    prepare_ros(options)
    wanted = episodes(arguments.episodes, options)
    first, second = run(wanted, options), run(wanted, options)
    pairs = [
        (one, other)
        for one, other in zip(first, second, strict=True)
        if Outcome.ABORTED not in (one.outcome, other.outcome)
    ]
    same = sum(one.car.tobytes() == other.car.tobytes() for one, other in pairs)
    moved = [float(np.abs(one.car[: len(other.car), :2] - other.car[: len(one.car), :2]).max()) for one, other in pairs]
    print(f"{same} of {len(pairs)} episodes are identical ({len(wanted) - len(pairs)} were aborted in one of the runs)")
    if moved:
        print(f"greatest distance between the cars: median {np.median(moved):.3g} m, largest {max(moved):.3g} m")
    print(f"age of the commands: {command_age([*first, *second])}")


if __name__ == "__main__":
    main()
