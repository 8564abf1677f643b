"""Graphs as an episode runner for as long as a campaign lasts, and an assessment through them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

from skd_sim.errors import UsageError
from skd_sim.options.options import LOCKSTEP
from skd_sim.ros.commands import command_format
from skd_sim.ros_environment.installation import ensure_messages, ensure_ros, enter_ros, is_sourced, message_variables

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, Fresh, Runner
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.checks import run_again
from skd_evaluator.assessment.stages.pipeline import run_stages
from skd_evaluator.ros.processes import GraphSetting

if TYPE_CHECKING:
    from skd_evaluator.ros.evaluator import Evaluator
    from skd_evaluator.ros.graph import Watched


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
        raise UsageError("ROS_SECURITY_ENABLE=true needs security libraries, which ROS 2 as SKD brings it has not")
    if options.message_folder:
        prefix = ensure_messages(options.message_folder, command_format(options).package)
        os.environ.update(message_variables(os.environ, prefix))
    enter_ros()


def graph_session(setting: GraphSetting, watched: Watched | None = None) -> AbstractContextManager[Evaluator]:
    """Run one graph; see `skd_evaluator.ros.graph.running_graph`, which is imported when ROS 2 is there."""
    from skd_evaluator.ros.graph import running_graph

    return running_graph(setting, watched)


def fresh_graph(evaluator: Runner | None, setting: GraphSetting) -> Fresh | None:
    """Return what runs episodes again: a new graph, or the one that there is where the user started the car.

    In real time no episode goes as before.

    Args:
        evaluator: runs the graph that there is; None: it has ended.
        setting: what that graph runs.

    Returns:
        None where it is to be called again after the graph has ended, or before, or no episode is run again.
    """
    repeats = not setting.car.is_own and setting.options.pacing == LOCKSTEP
    if not repeats or setting.awaits_car == (evaluator is None):
        return None
    if evaluator is not None:
        return lambda: nullcontext(evaluator)
    folder = setting.log_folder / "again"
    folder.mkdir(parents=True, exist_ok=True)
    silent = replace(setting, log_folder=folder, record_to=None, campaign="", say=lambda _line: None)
    return partial(graph_session, silent)


def assess_through_graph(
    assessment: Assessment,
    setting: GraphSetting,
    request: Mapping[str, Any],
    kept_by: Callable[[Runner], Runner] = lambda evaluator: evaluator,
) -> Assessment:
    """Return the assessment of a plan, for which kernels have been compiled (`compile_for_graph`).

    Margins are computed in this process: the graph's threads make it unsafe to fork.

    Args:
        assessment: what is known: at least the plan.
        setting: what the graph runs.
        request: further arguments of `Context`.
        kept_by: makes of the runner of the graph's episodes one that keeps them.

    Raises:
        UsageError: a process cannot be started.
        AssessmentError: the graph cannot go on; says where the logs are.
    """
    options = setting.options
    with graph_session(setting) as evaluator:
        context = Context(
            kept_by(evaluator),
            InProcessRunner(1),
            graph=options,
            repeats=options.pacing == LOCKSTEP,  # only nodes that wait for one another give the same again
            fresh=fresh_graph(evaluator, setting),
            **request,
        )
        assessment = run_stages(context, assessment)
        evaluator.publish_assessment(assessment)
    return run_again(replace(context, fresh=fresh_graph(None, setting)), assessment)
