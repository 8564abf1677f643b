"""How to run the graph."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GraphOptions:
    """How to run the graph.

    Attributes:
        pacing: `lockstep` or `real_time`.
        rate_factor: simulated seconds per second in real time.
        controller_command: command line of an external controller; empty: it is started by somebody else.
        command_type: what the controller publishes; see the simulator's parameter of that name.
        restart_controller: start the controller anew for each episode.
        command_timeout: wall seconds of silence that end an episode.
        startup_timeout: the same for an episode's first command.
    """

    pacing: str = "lockstep"
    rate_factor: float = 1.0
    controller_command: str = ""
    command_type: str = "accel_stamped"
    restart_controller: bool = False
    command_timeout: float = 5.0
    startup_timeout: float = 60.0
