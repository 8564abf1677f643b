"""Node `vehicle_simulator`: SKD's own world in the graph, or the simulator that an episode names.

`lockstep`: publishes the state of tick k and advances when both commands stamped t_k have arrived. `real_time`: ticks
on its own and holds the last commands. A command source that stays silent ends the episode as ABORTED, by name.
"""

from __future__ import annotations

from collections.abc import Sequence

from skd_sim.nodes.composition.place import Place
from skd_sim.nodes.simulator_node import SIMULATOR_SETTINGS, SimulatorNode
from skd_sim.nodes.support import run_node
from skd_sim.simulation.named_simulator import NamedSimulator

_SETTINGS = SIMULATOR_SETTINGS


class VehicleSimulator(SimulatorNode):
    """The world, and its clock."""

    def __init__(self, place: Place | None = None) -> None:
        """Make the simulator at a place, by default in a process of its own; then wait for an episode."""
        super().__init__("vehicle_simulator", lambda _values: NamedSimulator(), _SETTINGS, place=place)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_node(VehicleSimulator, args)


if __name__ == "__main__":
    raise SystemExit(main())
