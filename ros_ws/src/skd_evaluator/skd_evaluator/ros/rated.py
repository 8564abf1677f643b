"""An assessment through graphs that SKD runs, and whether the car in them is the one that its episodes show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path

from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.graph_options import LOCKSTEP
from skd_sim.choices.objective import Objective
from skd_sim.choices.simulators import is_own_world

from skd_evaluator.assessing.again import DoubtsOfLearning, Fresh
from skd_evaluator.assessing.again_graph import Graph, doubts_of_the_stack, groups_of
from skd_evaluator.assessing.graph_options import GraphOptions
from skd_evaluator.assessing.pipeline import Further, Runners, assessed, learned_plan
from skd_evaluator.campaign.judge.rating import Rating
from skd_evaluator.campaign.plan.plan import EpisodeRunner, Plan, Progress
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.ros.session import campaign_name, graphs_session


def fresh_process(car: CarUnderTest, simulator: str, options: GraphOptions) -> Fresh | None:
    """Return what makes a process in which episodes of a graph are run again, to the last bit; None where none are.

    Args:
        car: what is rated: only a Python class runs in a process, too.
        simulator: name of the simulator.
        options: how the graph is run.
    """
    if car.is_own or car.is_external or not repeats(simulator, options):
        return None
    return partial(InProcessRunner, 1, isolated=True, answer_limit=options.startup_timeout)


def repeats(simulator: str, options: GraphOptions) -> bool:
    """Whether an episode that is run again goes as before, if the car answers by what it hears."""
    return options.pacing == LOCKSTEP and is_own_world(simulator)


def graph_anew(car: CarUnderTest, simulator: str, options: GraphOptions, log_folder: Path) -> Graph:
    """Return what runs a graph of its own, with a stack that is started for it, after another one has ended.

    Args:
        car: what is rated.
        simulator: name of the simulator.
        options: how the other graph was run.
        log_folder: folder with the output of that graph's processes; this one's goes below it.
    """

    def run() -> AbstractContextManager[EpisodeRunner]:
        folder = log_folder / "again"
        folder.mkdir(exist_ok=True)
        return graphs_session(
            replace(options, graphs=1),
            controller=car.controller,
            simulator=simulator,
            campaign=campaign_name(car),
            log_folder=folder,
            record_to=None,
        )

    return run


def graph_there_is(evaluator: EpisodeRunner) -> Graph:
    """Return what runs the graph of an evaluator, which goes on with the same stack."""
    return lambda: nullcontext(evaluator)


def rated_through_graph(
    plan: Plan,
    objectives: Sequence[Objective],
    options: GraphOptions,
    further: Further,
    *,
    log_folder: Path,
    record_to: Path | None,
    progress: Progress,
    say: Callable[[str], None],
    kept_by: Callable[[EpisodeRunner], EpisodeRunner] = lambda evaluator: evaluator,
) -> Rating:
    """Return the assessment of a plan, for which kernels have been compiled (`compile_for_graph`).

    Args:
        plan: what to assess.
        objectives: the objectives of the kamikazes.
        options: how the graph is run.
        further: what the assessment has besides the figures of its kamikazes.
        log_folder: folder for the output of the graph's processes.
        record_to: folder for one bag per episode; none: do not record.
        progress: called with how far the work is.
        say: called with one line about what was done.
        kept_by: makes of the runner of the graph's episodes one that keeps those of which figures are.

    Raises:
        UsageError: a process cannot be started.
        AssessmentError: the graph cannot go on; says where the logs are.
    """
    car, simulator = plan.car, plan.simulator
    fresh = fresh_process(car, simulator, options)
    learning = DoubtsOfLearning(car, fresh)
    session = graphs_session(
        options,
        controller=car.controller,
        simulator=simulator,
        campaign=campaign_name(car),
        log_folder=log_folder,
        record_to=record_to,
    )
    run_again = car.is_external and repeats(simulator, options)
    started_here = bool(options.controller_command)
    found: tuple[str, ...] = ()
    with session as evaluator:
        plan = learned_plan(plan, evaluator, progress, say, options, learning.believed)
        # Only nodes that wait for one another can walk a way again.
        ways = evaluator if options.pacing == LOCKSTEP else None
        runners = Runners.of_graph(plan, kept_by(evaluator), ways, fresh)
        rating = assessed(plan, objectives, runners, progress, further)
        if run_again and not started_here:
            groups, graph = groups_of(rating), graph_there_is(evaluator)
            found = doubts_of_the_stack(car.controller, groups, graph, progress, anew=False)
        evaluator.publish_assessment(rating)
    if run_again and started_here:
        graph = graph_anew(car, simulator, options, log_folder)
        found = doubts_of_the_stack(car.controller, groups_of(rating), graph, progress, anew=True)
    return replace(rating, warnings=(*rating.warnings, *learning.found, *found))
