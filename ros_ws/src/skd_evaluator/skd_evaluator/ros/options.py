"""The options of a graph that is started here: those of its nodes, and what belongs to starting it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from skd_sim.graph_options import SimulatorOptions, graph_option
from skd_sim.options import options_of


@dataclass(frozen=True, kw_only=True)
class GraphOptions(SimulatorOptions):
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
    restart_controller: bool = graph_option(False, "start the controller anew for each episode", launches=())

    def simulator_parameters(self) -> dict[str, Any]:
        """Return the parameters of the simulator's node by name."""
        return {one.name: one.plain(getattr(self, one.name)) for one in options_of(SimulatorOptions)}
