"""The options of a graph that is started here: those of its nodes, and what belongs to starting it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skd_sim.graph_options import CommandOptions, SimulatorOptions, graph_option
from skd_sim.options import options_of


@dataclass(frozen=True, kw_only=True)
class EvaluatorOptions(CommandOptions):
    """The table of what the evaluator is told of the car under test."""

    control_period: float | None = graph_option(
        None,
        "how often an external controller decides, s: states come, and commands are taken, so often; it has to divide "
        "the time step",
        float,
        low=0.0,
        high=10.0,
        metavar="S",
        absent=0.0,
        external_only=True,
        unset="as the scenario says",
    )


@dataclass(frozen=True, kw_only=True)
class GraphOptions(SimulatorOptions, EvaluatorOptions):
    """The table of how to run the graph. Light: every command begins with it."""

    controller_command: str | None = graph_option(
        None,
        "command line of an external controller node",
        str,
        metavar="COMMAND",
        absent="",
        external_only=True,
        unset="the controller is started by you",
        launches=(),
    )
    message_folder: tuple[str, ...] | None = graph_option(
        None,
        "where packages of .msg files lie that no sourced workspace has; they are built once; can be given several "
        "times",
        str,
        metavar="DIR",
        many=True,
        unset="none",
        external_only=True,
        launches=(),
    )
    restart_controller: bool = graph_option(False, "start the controller anew for each episode", launches=())

    def simulator_parameters(self) -> dict[str, Any]:
        """Return the parameters of the simulator's node by name."""
        return {one.name: one.plain(getattr(self, one.name)) for one in options_of(SimulatorOptions)}
