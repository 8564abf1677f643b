"""The processes of a graph beside the evaluator's own: their commands and their environments."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Mapping
from pathlib import Path

from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.errors import UsageError
from skd_sim.ros_environment import foreign_variables, is_sourced, node_variables

from skd_evaluator.assessing.graph_options import GraphOptions
from skd_evaluator.ros.programs.node_logs import ADVERSARY, CONTROLLER, SIMULATOR
from skd_evaluator.ros.programs.processes import Program, python_node, ros_parameters


def graph_programs(
    options: GraphOptions, controller: str, environment: Mapping[str, str], secret: bytes | None
) -> dict[str, Program]:
    """Return the graph's processes, beside the evaluator's own.

    Args:
        options: how to run the graph.
        controller: name of the car under test.
        environment: variables that they inherit.
        secret: that simulator and adversary are handed; None: they are none of these processes.

    Raises:
        UsageError: the controller's command is no command line.
    """
    simulator = options.simulator_parameters()
    ours = node_variables(environment)
    programs = {}
    if secret is not None:
        command = python_node("skd_sim.start", "vehicle_simulator", *ros_parameters(simulator))
        programs[SIMULATOR] = Program(command, ours, secret)
        programs[ADVERSARY] = Program(python_node("skd_adversary.start", "adversary"), ours, secret)
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
