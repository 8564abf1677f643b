"""How the node graph is run: the options that a simulator's node needs, each in one place.

By its entry here an option is on the command line, a parameter of the simulator's node, and a launch argument; see
`skd_sim.choices.options`. What only the evaluator needs to start a graph stands in its own table, over this one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from skd_sim.choices.frames import FRAMES
from skd_sim.choices.options import GRAPH_COMMANDS, Names, option

graph_option = partial(option, group="node graph", commands=GRAPH_COMMANDS, graph_only=True)
_command_option = partial(graph_option, external_only=True)

LOCKSTEP = "lockstep"
REAL_TIME = "real_time"


@dataclass(frozen=True, kw_only=True)
class CommandOptions:
    """The table of what a car under test publishes, which whoever hears it needs. See `skd_sim.lockstep.commands`."""

    command_type: str = _command_option(
        "accel_stamped",
        "what the controller under test publishes: accel_stamped (linear.x in m/s²); a speed target (m/s) as "
        "twist_stamped, twist or ackermann; or any message type, as in my_msgs/msg/Command",
        metavar="TYPE",
    )
    command_field: str = _command_option(
        "",
        "the number in a message type of yours that commands the car, as in longitudinal.acceleration or axes[1]",
        metavar="FIELD",
        unset="that of the named types",
    )
    command_quantity: str = _command_option(
        "acceleration",
        "what that number is: an acceleration (m/s²), or a speed target (m/s)",
        choices=Names(("acceleration", "speed")),
    )
    command_topic: str = _command_option(
        "ego/acceleration_command", "topic on which the controller publishes that", metavar="TOPIC"
    )


@dataclass(frozen=True, kw_only=True)
class StateOptions:
    """The table of how a simulator's node says what it sees."""

    scan_rate: float = graph_option(
        0.0,
        "how many scans and clouds of points are published in a simulated second, as near as control periods allow; "
        "with 0 they come with every state",
        low=0.0,
        high=1000.0,
        metavar="HZ",
    )
    odom_frame: str = graph_option(FRAMES.odom, "name of the frame of the car's odometry", metavar="FRAME")
    base_frame: str = graph_option(FRAMES.base, "name of the frame of the car", metavar="FRAME")
    laser_frame: str = graph_option(FRAMES.laser, "name of the frame of the car's laser", metavar="FRAME")
    own_localisation: bool = graph_option(
        False, "the controller publishes the transform map → odom itself, so the simulator does not"
    )


@dataclass(frozen=True, kw_only=True)
class SimulatorOptions(CommandOptions, StateOptions):
    """The table of what every simulator's node is told."""

    pacing: str = graph_option(
        LOCKSTEP,
        "lockstep: the simulator advances when both commands have arrived, as fast as the nodes answer; real_time: it "
        "advances by the wall clock",
        choices=Names((LOCKSTEP, REAL_TIME)),
    )
    rate_factor: float = graph_option(
        1.0, "with real_time: how many simulated seconds pass in a second", low=0.01, high=100.0, metavar="F"
    )
    slip_limit: float = graph_option(
        0.05,
        "with real_time: how many wall seconds late the simulator may come to a control period (half a period where "
        "that is more). An episode in which it came later says nothing about the car and is aborted",
        low=0.001,
        high=3600.0,
        metavar="S",
    )
    quiet_time: float | None = graph_option(
        None,
        "with lockstep, for a controller that follows /clock instead of answering each state: the simulator goes on "
        "when the controller has said something since the last state, or after so many wall seconds, and holds its "
        "last command",
        float,
        low=0.0,
        high=10.0,
        metavar="S",
        absent=0.0,
        unset="wait for the answer to each state",
        external_only=True,
    )
    command_timeout: float = graph_option(
        5.0, "wall seconds without a command after which an episode is aborted", low=0.05, high=3600.0, metavar="S"
    )
    startup_timeout: float = graph_option(
        60.0,
        "wall seconds without the first command of an episode, while nodes start, after which it is aborted; in "
        "process, what every call of a controller of yours may take",
        low=0.05,
        high=3600.0,
        metavar="S",
        graph_only=False,
    )
    maximum_acceleration: float = graph_option(
        3.0, "greatest acceleration with which a speed target is followed, m/s²", low=0.1, high=20.0, metavar="A"
    )
    maximum_deceleration: float = graph_option(
        8.0, "greatest deceleration with which a speed target is followed, m/s²", low=0.1, high=20.0, metavar="A"
    )
    initial_pose: bool = graph_option(
        False,
        "publish the car's start pose on /initialpose (geometry_msgs/PoseWithCovarianceStamped, frame map) before the "
        "first state of each episode",
        commands=(),
        graph_only=False,
    )
