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

from skd_sim.errors import UsageError

from skd_evaluator.graph.domain import choose_domain
from skd_evaluator.graph.options import GraphOptions
from skd_evaluator.graph.processes import Supervisor, python_node, ros_parameters

if TYPE_CHECKING:
    from skd_evaluator.nodes.evaluator import Evaluator

CONTROLLER = "car_controller"


def campaign_name(controller: str, multiplier: float, seed: int) -> str:
    """Return a name for a campaign that no other has."""
    car = f"basic-C{multiplier:g}" if controller == "basic" else controller
    return f"{car}-seed{seed}-{uuid.uuid4().hex[:8]}"


def graph_commands(options: GraphOptions, controller: str) -> dict[str, list[str]]:
    """Return the commands of the graph's processes, beside the evaluator's own."""
    simulator = {
        "pacing": options.pacing,
        "rate_factor": float(options.rate_factor),
        "command_type": options.command_type,
        "command_timeout": float(options.command_timeout),
        "startup_timeout": float(options.startup_timeout),
    }
    commands = {
        "vehicle_simulator": python_node("skd_sim.start", "vehicle_simulator", *ros_parameters(simulator)),
        "pedestrian_adversary": python_node("skd_adversary.start", "pedestrian_adversary"),
    }
    if controller != "external":
        commands[CONTROLLER] = python_node("skd_sim.start", "car_controller")
    elif options.controller_command:
        try:
            commands[CONTROLLER] = shlex.split(options.controller_command)
        except ValueError as error:
            raise UsageError(f"--controller-command {options.controller_command!r}: {error}") from error
        if not commands[CONTROLLER]:
            raise UsageError("--controller-command is empty")
    return commands


def process_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the environment of the graph's processes.

    Where no ROS 2 is sourced, a controller's `python3` is the one of this environment, in which `import rclpy` works.
    With ROS 2 the PATH stays as it is: `python3` is then the one that the user's own stack runs on.
    """
    if environment.get("ROS_DISTRO"):
        return dict(environment)
    folders = [str(Path(sys.executable).parent), environment.get("PATH") or os.defpath]
    return {**environment, "PATH": os.pathsep.join(folders)}


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
        UsageError: the environment lacks ROS 2's messages, or a process cannot be started.
    """
    os.environ["ROS_DOMAIN_ID"] = str(choose_domain())
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    try:
        import rclpy  # only here: ROS reads its environment when it starts

        from skd_evaluator.nodes.evaluator import Evaluator
    except ModuleNotFoundError as error:
        raise UsageError(
            f"the node graph needs {error.name}, which is not found; with ROS 2 sourced, build and source the "
            "workspace first: cd ros_ws && colcon build && . install/setup.bash"
        ) from error

    with Supervisor(graph_commands(options, controller), log_folder, process_environment(os.environ)) as supervisor:
        rclpy.init(args=[], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        try:
            evaluator = Evaluator()
            evaluator.begin_campaign(
                campaign,
                record_to=record_to,
                silence_limit=options.startup_timeout + 30.0,
                check_processes=supervisor.check,
                before_episode=(lambda: supervisor.restart(CONTROLLER)) if options.restart_controller else lambda: None,
                command_type=options.command_type,
            )
            try:
                yield evaluator
            finally:
                evaluator.destroy_node()
        finally:
            rclpy.try_shutdown()
