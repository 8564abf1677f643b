"""The options of a graph that SKD starts: those of its nodes, and how it is started."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.options.car_under_test import CarUnderTest, is_own_world
from skd_sim.options.options import LOCKSTEP, CommandOptions, Lists, Names, SimulatorOptions, graph_option, options_of

JUMP, INITIAL_POSE, LIFECYCLE, RESTART = "jump", "initialpose", "lifecycle", "restart"
COMPOSED, SEPARATE = "composed", "separate"
OF_NO_RESULT = frozenset({"graphs", "nodes"})
"""Options that change how long it takes, and no number of what comes out."""
RESETS = (JUMP, INITIAL_POSE, LIFECYCLE, RESTART)


@dataclass(frozen=True, kw_only=True)
class EvaluatorOptions(CommandOptions):
    """The table of what the evaluator is told of the car under test."""

    control_period: float | None = graph_option(
        None,
        "time between two decisions of an external controller, s. The car's state is published, and a command taken, "
        "once in each such period. It must divide the time step of the scenario",
        float,
        low=0.0,
        high=10.0,
        metavar="S",
        external_only=True,
        unset="as the scenario says",
    )
    lifecycle_nodes: str = graph_option(
        "",
        "names of the controller's managed (lifecycle) nodes, with commas in between, in the order in which they are "
        "started, such as /planner,/guard",
        metavar="NAMES",
        unset="none",
    )


@dataclass(frozen=True, kw_only=True)
class GraphOptions(SimulatorOptions, EvaluatorOptions):
    """The table of how to run the graph. Light: every command begins with it."""

    controller_command: str | None = graph_option(
        None,
        "the shell command that starts the controller's node",
        str,
        metavar="COMMAND",
        external_only=True,
        unset="you start the controller yourself",
        launches=(),
    )
    message_folder: tuple[str, ...] | None = graph_option(
        None,
        "folder with packages of message definitions (.msg files) that no sourced workspace has. They are built once. "
        "The option can be given several times",
        tuple,
        metavar="DIR",
        unset="none",
        external_only=True,
        launches=(),
    )
    reset: str = graph_option(
        JUMP,
        "how the controller learns that a new episode begins; several ways are given with commas in between: jump (the "
        "car's pose jumps, while time stamps go on), initialpose (the start pose is published on /initialpose), "
        "lifecycle (the --lifecycle-nodes are deactivated, cleaned up, configured and activated), restart (its command "
        "is started anew)",
        choices=Lists(RESETS),
        metavar="HOW",
        launches=(),
    )
    graphs: int = graph_option(
        1,
        "how many node graphs run side by side, each in a ROS domain of its own. With --reset restart one runs while "
        "another starts",
        low=1,
        high=16,
        metavar="N",
        commands=("assess", "probe"),
        launches=(),
    )
    nodes: str = graph_option(
        COMPOSED,
        "where simulator and adversary run: composed (in the process of the command, so that what they say to each "
        "other does not go through the network, which is faster), or separate (each in a process of its own). They are "
        "separate anyway in real time, with a quiet time, with several graphs and with a simulator that is not SKD's",
        choices=Names((COMPOSED, SEPARATE)),
        launches=(),
        commands=("assess", "episode", "probe"),
    )

    @property
    def resets(self) -> tuple[str, ...]:
        """How the controller learns that a new episode begins."""
        return tuple(self.reset.split(","))

    @property
    def answers_each_state(self) -> bool:
        """Whether every state certainly gets a command of its own."""
        return self.pacing == LOCKSTEP and self.quiet_time is None

    def composes(self, simulator: str) -> bool:
        """Return whether simulator and adversary share the evaluator's process, if that is a simulator's name."""
        # Planning would keep a clock waiting, one graph another, and nobody knows what code of others does.
        alone = self.graphs == 1 and is_own_world(simulator)
        return self.nodes == COMPOSED and self.answers_each_state and alone

    def simulator_parameters(self) -> dict[str, Any]:
        """Return the parameters of the simulator's node by name."""
        values = {one.name: one.plain(getattr(self, one.name)) for one in options_of(SimulatorOptions)}
        return {**values, "initial_pose": self.initial_pose or INITIAL_POSE in self.resets}

    def check(self, car: CarUnderTest) -> None:
        """Refuse options that do not go together.

        Args:
            car: the car under test.

        Raises:
            UsageError: some do not.
        """
        started_here = not car.is_external or self.controller_command is not None
        if RESTART in self.resets and not started_here:
            raise UsageError("--reset restart needs --controller-command: SKD restarts only what it has started")
        if self.graphs > 1 and not started_here:
            raise UsageError("--graphs needs --controller-command: a controller that you start is in one graph only")
        if (LIFECYCLE in self.resets) != bool(managed_nodes(self.lifecycle_nodes)):
            raise UsageError("--reset lifecycle and --lifecycle-nodes /name,/other go together: give both or neither")


def managed_nodes(names: str) -> tuple[str, ...]:
    """Return the full names of the nodes in the text of option lifecycle_nodes."""
    return tuple(f"/{name.strip().lstrip('/')}" for name in names.split(",") if name.strip())
