"""Node `vehicle_simulator`: SKD's own world in the graph, or the simulator that an episode names.

`lockstep`: publishes the state of tick k and advances when both commands stamped t_k have arrived. `real_time`: ticks
on its own and holds the last commands. A command source that stays silent ends the episode as ABORTED, by name.
"""

from __future__ import annotations

from collections.abc import Sequence

from skd_sim.ros.simulator_node import SIMULATOR_SETTINGS, GraphSimulator
from skd_sim.ros.support import GraphNode, declare, run_node
from skd_sim.simulators.named_simulator import NamedSimulator

_SETTINGS = SIMULATOR_SETTINGS


class VehicleSimulator(GraphNode):
    """The world, and its clock."""

    def __init__(self) -> None:
        """Declare parameters; then wait for an episode."""
        super().__init__("vehicle_simulator")
        self.simulator = GraphSimulator(self, NamedSimulator(), declare(self, _SETTINGS))


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_node(VehicleSimulator, args)


if __name__ == "__main__":
    raise SystemExit(main())
