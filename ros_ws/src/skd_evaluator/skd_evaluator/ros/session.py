"""A running graph as an episode runner: processes, domain and evaluator together."""

from __future__ import annotations

import os
import shlex
import sys
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from skd_sim.car_under_test import CarUnderTest
from skd_sim.commands import command_format
from skd_sim.errors import UsageError
from skd_sim.graph_options import LOCKSTEP
from skd_sim.ros_environment import (
    ensure_messages,
    ensure_ros,
    enter_ros,
    foreign_variables,
    is_sourced,
    message_variables,
    node_variables,
)

from skd_evaluator.errors import AssessmentError
from skd_evaluator.ros.domain import choose_domain
from skd_evaluator.ros.node_logs import ADVERSARY, CONTROLLER, SIMULATOR, concerned, keep_logs, log_of
from skd_evaluator.ros.options import GraphOptions
from skd_evaluator.ros.processes import Program, Supervisor, python_node, ros_parameters

if TYPE_CHECKING:
    from skd_evaluator.ros.evaluator import Evaluator

_LOCKSTEP_SETTLE = 2.0  # s: a command of each tick is certain to come, unless its sender has not found us yet


def campaign_name(car: CarUnderTest, seed: int) -> str:
    """Return a name for a campaign that no other has."""
    return f"{car.file_name}-seed{seed}-{uuid.uuid4().hex[:8]}"


def prepare_ros(options: GraphOptions) -> None:
    """See that this process can import ROS 2 and what the car publishes: it may add both, and begin this process anew.

    To be called before a command has done anything but look at its arguments.

    Raises:
        UsageError: ROS 2 cannot be had here, or the messages cannot.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")  # a wrong type in a field is an error, not garbage
    ensure_ros()
    if options.message_folder:
        prefix = ensure_messages(options.message_folder, command_format(options).package)
        os.environ.update(message_variables(os.environ, prefix))
    enter_ros()


def graph_programs(options: GraphOptions, controller: str, environment: Mapping[str, str]) -> dict[str, Program]:
    """Return the graph's processes, beside the evaluator's own.

    Args:
        options: how to run the graph.
        controller: name of the car under test.
        environment: variables that they inherit.

    Raises:
        UsageError: the controller's command is no command line.
    """
    simulator = options.simulator_parameters()
    ours = node_variables(environment)
    programs = {
        SIMULATOR: Program(python_node("skd_sim.start", "vehicle_simulator", *ros_parameters(simulator)), ours),
        ADVERSARY: Program(python_node("skd_adversary.start", "pedestrian_adversary"), ours),
    }
    if not CarUnderTest(controller).is_external:
        programs[CONTROLLER] = Program(python_node("skd_sim.start", "car_controller"), ours)
    elif options.controller_command:
        try:
            command = shlex.split(options.controller_command)
        except ValueError as error:
            raise UsageError(f"--controller-command {options.controller_command!r}: {error}") from error
        if not command:
            raise UsageError("--controller-command is empty")
        programs[CONTROLLER] = Program(command, controller_environment(environment))
    return programs


def controller_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of a controller that is not ours.

    Where no ROS 2 is sourced, its `python3` is the one of this environment, in which `import rclpy` works. With ROS 2
    the PATH stays as it is: `python3` is then the one that the user's own stack runs on. Where our libraries lie is
    none of its business: it may be built against others.
    """
    if is_sourced(environment):
        return dict(environment)
    folders = [str(Path(sys.executable).parent), environment.get("PATH") or os.defpath]
    return {**foreign_variables(environment), "PATH": os.pathsep.join(folders)}


@contextmanager
def graph_session(
    options: GraphOptions,
    *,
    controller: str,
    campaign: str,
    log_folder: Path,
    record_to: Path | None,
) -> Iterator[Evaluator]:
    """Run a graph and yield its evaluator; all processes are gone afterwards, whatever happened.

    Args:
        options: how to run it.
        controller: name of the car under test, as in `Plan`.
        campaign: name of the campaign.
        log_folder: for the processes' output.
        record_to: folder for one bag per episode; none: do not record.

    Raises:
        UsageError: a process cannot be started.
        AssessmentError: the graph cannot go on; says where the logs are kept.
    """
    os.environ["ROS_DOMAIN_ID"] = str(choose_domain())
    import rclpy  # only here: ROS reads its environment when it starts
    from skd_sim.nodes.command_messages import car_commands

    from skd_evaluator.ros.evaluator import SETTLE, Evaluator

    commands = car_commands(options)  # before anything is started: what is wrong with it is the user's to mend

    def replace_silent(reason: str) -> None:
        for name in concerned(reason):
            supervisor.restart(name)

    with Supervisor(graph_programs(options, controller, os.environ), log_folder) as supervisor:
        rclpy.init(args=[], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        try:
            evaluator = Evaluator()
            evaluator.begin_campaign(
                campaign,
                record_to=record_to,
                silence_limit=options.startup_timeout + 30.0,
                check_processes=supervisor.check,
                before_episode=(lambda: supervisor.restart(CONTROLLER)) if options.restart_controller else lambda: None,
                after_silence=replace_silent,
                commands=options,
                own_world=True,
                settle=_LOCKSTEP_SETTLE if options.pacing == LOCKSTEP and commands.stamped else SETTLE,
            )
            if CarUnderTest(controller).is_external and not options.controller_command:
                _say_what_is_awaited(evaluator, options.command_topic)
            try:
                yield evaluator
            except AssessmentError as error:
                log = log_of(keep_logs(log_folder), str(error))
                raise AssessmentError(f"{error}; log: {log}") from error
            finally:
                evaluator.destroy_node()
        finally:
            rclpy.try_shutdown()


def _say_what_is_awaited(evaluator: Evaluator, command_topic: str) -> None:
    """Say, once, that the controller is to be started by somebody else, and where."""
    topic = evaluator.resolve_topic_name(command_topic)
    if not evaluator.count_publishers(topic):
        domain = os.environ["ROS_DOMAIN_ID"]
        print(f"skd: waiting for a publisher of {topic} (ROS_DOMAIN_ID={domain})", file=sys.stderr)
