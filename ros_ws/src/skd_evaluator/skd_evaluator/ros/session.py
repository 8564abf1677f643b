"""Graphs as an episode runner for as long as a campaign lasts, and an assessment through them."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.options.graph_options import LOCKSTEP
from skd_sim.options.objective import Objective
from skd_sim.options.simulators import WORLD
from skd_sim.ros.commands import command_format
from skd_sim.ros_environment import ensure_messages, ensure_ros, enter_ros, is_sourced, message_variables
from skd_sim.world.aborts import counts_in_words

from skd_evaluator.assessment.judge.rating import Rating
from skd_evaluator.assessment.judge.repeatability import Fresh
from skd_evaluator.assessment.plan.plan import EpisodeRunner, Plan, Progress
from skd_evaluator.assessment.stages.graph_options import GraphOptions
from skd_evaluator.assessment.stages.pipeline import Further, Runners, assessed, learned_plan, with_repeatability
from skd_evaluator.errors import AssessmentError
from skd_evaluator.ros.processes import Failures, log_of

if TYPE_CHECKING:
    from skd_evaluator.ros.driving import Watched
    from skd_evaluator.ros.evaluator import Evaluator
    from skd_evaluator.ros.graph import GraphPool, GraphSetting


def campaign_name(car: CarUnderTest) -> str:
    """Return a name for a campaign that no other has; the car under test may hear it, so it does not tell the seed."""
    return f"{car.file_name}-{uuid.uuid4().hex[:8]}"


def prepare_ros(options: GraphOptions) -> None:
    """See that this process can import ROS 2 and what the car publishes: it may add both, and begin this process anew.

    To be called before a command has done anything but look at its arguments.

    Raises:
        UsageError: ROS 2 cannot be had here, or the messages cannot.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")  # a wrong type in a field is an error, not garbage
    ensure_ros()
    if os.environ.get("ROS_SECURITY_ENABLE") == "true" and not is_sourced(os.environ):
        raise UsageError(
            "ROS_SECURITY_ENABLE=true needs a Fast DDS with security libraries, which ROS 2 as SKD brings it has not: "
            "unset it, or source a ROS 2 that has them"
        )
    if options.message_folder:
        prefix = ensure_messages(options.message_folder, command_format(options).package)
        os.environ.update(message_variables(os.environ, prefix))
    enter_ros()


@contextmanager
def graph_session(
    options: GraphOptions,
    *,
    controller: str,
    simulator: str = WORLD,
    campaign: str,
    log_folder: Path,
    record_to: Path | None,
    say: Callable[[str], None] | None = None,
    watched: Watched | None = None,
) -> Iterator[Evaluator]:
    """Run one graph and yield its evaluator; all processes are gone afterwards, whatever happened.

    Args:
        options: how to run it.
        controller: name of the car under test, as in `Plan`.
        simulator: name of the simulator, likewise.
        campaign: name of the campaign.
        log_folder: folder for the processes' output.
        record_to: folder for one bag per episode; none: do not record.
        say: called with each line for the user; by default it is printed to standard error.
        watched: who takes part as the adversary, and watches.

    Raises:
        UsageError: a process cannot be started.
        AssessmentError: the graph cannot go on; says where the logs are.
    """
    from skd_evaluator.ros.graph import (
        GraphSetting,
        choose_domain,  # only here: ROS may be added by `prepare_ros`
        running_graph,
    )

    domain = choose_domain()
    say = say or _say
    setting = GraphSetting(options, controller, simulator, campaign, record_to, say, watched)
    with running_graph(setting, domain, log_folder) as evaluator:
        if CarUnderTest(controller).is_external and not options.controller_command:
            _say_what_is_awaited(evaluator, options.command_topic, domain, say)
        with _telling_of_logs(log_folder, evaluator.failures):
            yield evaluator


@contextmanager
def graphs_session(
    options: GraphOptions,
    *,
    controller: str,
    simulator: str = WORLD,
    campaign: str,
    log_folder: Path,
    record_to: Path | None,
) -> Iterator[Evaluator | GraphPool]:
    """Run as many graphs as the options say and yield what runs episodes in them; otherwise as `graph_session`."""
    try:
        if options.graphs == 1:
            with graph_session(
                options,
                controller=controller,
                simulator=simulator,
                campaign=campaign,
                log_folder=log_folder,
                record_to=record_to,
            ) as evaluator:
                yield evaluator
        else:
            with _pool(options, controller, simulator, campaign, log_folder, record_to) as pool:
                yield pool
    finally:
        _give_back_memory()


@contextmanager
def _pool(
    options: GraphOptions, controller: str, simulator: str, campaign: str, log_folder: Path, record_to: Path | None
) -> Iterator[GraphPool]:
    from skd_evaluator.ros.graph import GraphPool, GraphSetting, choose_domain, free_domain, without_echo

    domains = [choose_domain()]
    while len(domains) < options.graphs:
        domains.append(free_domain(domains))
    setting = GraphSetting(options, controller, simulator, campaign, record_to, without_echo(_say))
    failures = Failures(_say, log_folder)
    make = partial(_graph_of_pool, setting, domains, log_folder)
    with (
        _telling_of_logs(log_folder, failures),
        GraphPool(options.graphs, make, failures, options.startup_timeout) as pool,
    ):
        yield pool


def _graph_of_pool(
    setting: GraphSetting, domains: list[int], log_folder: Path, number: int, refuse_to_go_on: Callable[[], None]
) -> AbstractContextManager[Evaluator]:
    from skd_evaluator.ros.graph import running_graph

    which = f"{number + 1}" if number else ""  # the first is as if it were alone
    folder = log_folder / f"graph{which}" if which else log_folder
    folder.mkdir(exist_ok=True)
    return running_graph(setting, domains[number], folder, f"evaluator{which}", refuse_to_go_on)


def _say(line: str) -> None:
    print(f"skd: {line}", file=sys.stderr, flush=True)


@contextmanager
def _telling_of_logs(log_folder: Path, failures: Failures) -> Iterator[None]:
    """Say of an error that ends a campaign what was aborted before, and where the logs are."""
    try:
        yield
    except AssessmentError as error:
        log = log_of(log_folder, str(error))
        counts = f"; aborted were {counts_in_words(failures.reasons)}" if failures.reasons else ""
        error.args = (f"{error}{counts}; log: {log}",)  # whoever catches it goes by its kind
        raise


def _say_what_is_awaited(evaluator: Evaluator, command_topic: str, domain: int, say: Callable[[str], None]) -> None:
    """Say, once, that the controller is to be started by somebody else, and where."""
    topic = evaluator.resolve_topic_name(command_topic)
    if not evaluator.count_publishers(topic):
        say(f"waiting for a publisher of {topic} (ROS_DOMAIN_ID={domain})")


def _give_back_memory() -> None:
    """Give back what is free in all arenas of the C library (`malloc_trim(3)`); nothing where it is not glibc.

    A graph's threads, Python's and those of its middleware, have arenas of their own, in which what a graph has used is
    kept when it is over; the next one finds some of it, and asks for more.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


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
