"""One whole graph: its processes, its domain and its evaluator."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from skd_sim.ros.command_messages import car_commands

from skd_evaluator.assessment.stages.graph_options import RESTART, GraphOptions, managed_nodes
from skd_evaluator.ros.domains import context_of
from skd_evaluator.ros.driving import Watched
from skd_evaluator.ros.evaluator import Evaluator
from skd_evaluator.ros.processes import ADVERSARY, CONTROLLER, Supervisor, concerned, graph_programs
from skd_evaluator.ros.readiness.lifecycle import resetting

_CERTAIN = 1.0 / 3.0
"""Share of the time that a stack has to start after which commands that come elsewhere will not come here."""


@dataclass(frozen=True)
class GraphSetting:
    """What a graph runs.

    Attributes:
        options: how to run it.
        controller: name of the car under test, as in `Plan`.
        simulator: name of the simulator.
        campaign: name of the campaign.
        record_to: folder for one bag per episode; none: do not record.
        say: called with each line for the user.
        watched: who takes part as the adversary, and watches; by default SKD's own node is the adversary.
    """

    options: GraphOptions
    controller: str
    simulator: str
    campaign: str
    record_to: Path | None
    say: Callable[[str], None]
    watched: Watched | None = None


@contextmanager
def running_graph(
    setting: GraphSetting,
    domain: int,
    log_folder: Path,
    name: str = "evaluator",
    refuse_to_go_on: Callable[[], None] = lambda: None,
) -> Iterator[Evaluator]:
    """Run a graph and yield its evaluator; all processes are gone afterwards, whatever happened.

    Args:
        setting: what it runs.
        domain: ROS domain id.
        log_folder: folder for the processes' output.
        name: name of the evaluator's node.
        refuse_to_go_on: called while the evaluator waits; an exception that it raises ends the graph.

    Raises:
        UsageError: a process cannot be started, or there are no such commands as the options say.
        AssessmentError: the graph cannot go on.
    """
    options = setting.options
    car_commands(options)  # before anything is started: what is wrong with it is the user's to mend
    watched = setting.watched
    composed = watched is None and options.composes(setting.simulator)
    environment = {**os.environ, "ROS_DOMAIN_ID": str(domain)}
    programs = graph_programs(options, setting.controller, environment, composed=composed)
    if watched is not None:
        del programs[ADVERSARY]

    def check_processes() -> str | None:
        refuse_to_go_on()
        if watched is not None:
            watched.check()
        return supervisor.check()

    def replace_silent(reason: str) -> None:
        for name in concerned(reason):
            supervisor.restart(name)

    def before_episode() -> str | None:
        if RESTART in options.resets:
            supervisor.restart(CONTROLLER)
        return reset()

    with ExitStack() as stack:
        supervisor = stack.enter_context(Supervisor(programs, log_folder, setting.say))
        context, done = stack.enter_context(context_of(domain))
        evaluator = Evaluator(context, name, options if composed else None, start_parameter_services=False)
        done.append(evaluator)  # it goes later: its end may hang, and nothing is written yet
        if watched is not None:
            done.append(stack.enter_context(watched.adversary(context)))
        reset = stack.enter_context(
            resetting(
                context,
                managed_nodes(options.lifecycle_nodes),
                patience=options.startup_timeout,
                check_processes=check_processes,
            )
        )
        evaluator.begin_campaign(
            setting.campaign,
            record_to=setting.record_to,
            silence_limit=options.startup_timeout + 30.0,
            check_processes=check_processes,
            before_episode=before_episode,
            after_silence=replace_silent,
            commands=options,
            own_world=True,
            anew=RESTART in options.resets,
            answers_each_state=options.answers_each_state,
            say=setting.say,
            log_folder=log_folder,
            # Who has not started the stack here may be mending it in another terminal.
            patience=_CERTAIN * options.startup_timeout if options.controller_command else math.inf,
        )
        yield evaluator
