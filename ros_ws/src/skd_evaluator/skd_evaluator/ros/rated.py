"""An assessment through graphs that SKD runs, and whether the car in them is the one that its episodes show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path

from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.options.graph_options import LOCKSTEP
from skd_sim.options.objective import Objective

from skd_evaluator.assessment.judge.rating import Rating
from skd_evaluator.assessment.judge.repeatability import Fresh
from skd_evaluator.assessment.plan.plan import EpisodeRunner, Plan, Progress
from skd_evaluator.assessment.stages.graph_options import GraphOptions
from skd_evaluator.assessment.stages.pipeline import Further, Runners, assessed, learned_plan, with_repeatability
from skd_evaluator.ros.session import campaign_name, graphs_session


def repeats(car: CarUnderTest, options: GraphOptions) -> bool:
    """Tell whether a user's car is run again through a graph: in real time no episode goes as before."""
    return not car.is_own and options.pacing == LOCKSTEP


def fresh_graph(
    evaluator: EpisodeRunner | None, car: CarUnderTest, simulator: str, options: GraphOptions, log_folder: Path
) -> Fresh | None:
    """Return what runs episodes again: a new graph, or the one that there is where somebody else started the car.

    Args:
        evaluator: runs the graph that there is; None: it has ended.
        car: what is rated.
        simulator: name of the simulator.
        options: how the graph that there is is run.
        log_folder: folder with the output of its processes; that of the new graph goes below it.

    Returns:
        None where it is to be asked again after the graph has ended, or before, or no episode is run again.
    """
    awaited = car.is_external and not options.controller_command
    if not repeats(car, options) or awaited == (evaluator is None):
        return None
    if evaluator is not None:
        return lambda: nullcontext(evaluator)
    folder = log_folder / "again"
    folder.mkdir(parents=True, exist_ok=True)
    return partial(
        graphs_session,
        replace(options, graphs=1),
        controller=car.controller,
        simulator=simulator,
        campaign=campaign_name(car),
        log_folder=folder,
        record_to=None,
    )


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
    session = graphs_session(
        options,
        controller=car.controller,
        simulator=simulator,
        campaign=campaign_name(car),
        log_folder=log_folder,
        record_to=record_to,
    )
    with session as evaluator:
        plan = learned_plan(plan, evaluator, progress, say, options)
        # Only nodes that wait for one another can walk a way again.
        ways = evaluator if options.pacing == LOCKSTEP else None
        fresh = fresh_graph(evaluator, car, simulator, options, log_folder)
        runners = Runners.of_graph(plan, kept_by(evaluator), ways, fresh)
        rating = assessed(plan, objectives, runners, progress, further)
        evaluator.publish_assessment(rating)
    fresh = fresh_graph(None, car, simulator, options, log_folder)
    return rating if fresh is None else with_repeatability(rating, fresh)
