"""How the node graph is run: the options that a simulator's node needs, each in one place.

By its entry here an option is on the command line, a parameter of the simulator's node, and a launch argument; see
`skd_sim.options.options`. What only the evaluator needs to start a graph stands in its own table, over this one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from skd_sim.options.frames import FRAMES
from skd_sim.options.options import GRAPH_COMMANDS, Names, option

graph_option = partial(option, group="node graph", commands=GRAPH_COMMANDS, graph_only=True)
_RATED = tuple(name for name in GRAPH_COMMANDS if name != "drive")
"""Commands of what is rated; what one only watches goes by the wall clock."""
_command_option = partial(graph_option, external_only=True)

LOCKSTEP = "lockstep"
REAL_TIME = "real_time"


@dataclass(frozen=True, kw_only=True)
class CommandOptions:
    """The table of what a car under test publishes, which whoever hears it needs. See `skd_sim.ros.commands`."""

    command_type: str = _command_option(
        "accel_stamped",
        "type of the message in which the controller under test publishes its commands: accel_stamped (an "
        "acceleration, m/s²); twist_stamped, twist or ackermann (a speed to reach, m/s); or the name of any message "
        "type, such as my_msgs/msg/Command",
        metavar="TYPE",
    )
    command_field: str = _command_option(
        "",
        "which number in a message type of your own is the command, such as longitudinal.acceleration or axes[1]",
        metavar="FIELD",
        unset="none; a message type of your own needs one",
    )
    command_quantity: str = _command_option(
        "acceleration",
        "what the command in a message type of your own is: an acceleration (m/s²), or a speed to reach (m/s)",
        choices=Names(("acceleration", "speed")),
    )
    command_topic: str = _command_option(
        "ego/acceleration_command", "topic on which the controller publishes its commands", metavar="TOPIC"
    )


@dataclass(frozen=True, kw_only=True)
class StateOptions:
    """The table of how a simulator's node says what it sees."""

    scan_rate: float = graph_option(
        0.0,
        "how many laser scans and point clouds are published in a simulated second, as near as the control periods "
        "allow. With 0 they are published with every state of the car",
        low=0.0,
        high=1000.0,
        metavar="HZ",
    )
    odom_frame: str = graph_option(FRAMES.odom, "name of the coordinate frame of the car's odometry", metavar="FRAME")
    base_frame: str = graph_option(FRAMES.base, "name of the coordinate frame of the car", metavar="FRAME")
    laser_frame: str = graph_option(FRAMES.laser, "name of the coordinate frame of the car's laser", metavar="FRAME")
    own_localisation: bool = graph_option(
        False, "the controller itself publishes the transform map → odom, so that the simulator must not"
    )


@dataclass(frozen=True, kw_only=True)
class SimulatorOptions(CommandOptions, StateOptions):
    """The table of what every simulator's node is told."""

    pacing: str = graph_option(
        LOCKSTEP,
        "when the simulator advances: lockstep (as soon as the commands of car and adversary have arrived), or "
        "real_time (by the wall clock, whether or not a command has arrived)",
        choices=Names((LOCKSTEP, REAL_TIME)),
        commands=_RATED,
    )
    rate_factor: float = graph_option(
        1.0,
        "with real_time: how many simulated seconds pass in a second of the wall clock",
        low=0.01,
        high=100.0,
        metavar="F",
    )
    slip_limit: float = graph_option(
        0.05,
        "with real_time: how late the simulator may begin a control period, in seconds of the wall clock (or half a "
        "period, if that is more). An episode in which it begins one later is aborted, for it says nothing about the "
        "car",
        low=0.001,
        high=3600.0,
        metavar="S",
        commands=_RATED,
    )
    quiet_time: float | None = graph_option(
        None,
        "with lockstep, for a controller that follows /clock and does not answer each state: the simulator goes on as "
        "soon as the controller has published a command since the last state, and after this many seconds of the wall "
        "clock at the latest. Until then its last command holds",
        float,
        low=0.0,
        high=10.0,
        metavar="S",
        unset="the simulator waits until each state is answered",
        external_only=True,
        commands=_RATED,
    )
    command_timeout: float = graph_option(
        5.0,
        "an episode is aborted after this many seconds of the wall clock without a command",
        low=0.05,
        high=3600.0,
        metavar="S",
    )
    startup_timeout: float = graph_option(
        60.0,
        "an episode is aborted after this many seconds of the wall clock without its first command: nodes need time to "
        "start. Without the node graph: how many seconds a call of your own controller may take",
        low=0.05,
        high=3600.0,
        metavar="S",
        graph_only=False,
    )
    maximum_acceleration: float = graph_option(
        3.0,
        "greatest acceleration with which the car follows a speed that is commanded, m/s²",
        low=0.1,
        high=20.0,
        metavar="A",
    )
    maximum_deceleration: float = graph_option(
        8.0,
        "greatest deceleration with which the car follows a speed that is commanded, m/s²",
        low=0.1,
        high=20.0,
        metavar="A",
    )
    initial_pose: bool = graph_option(
        False,
        "publish the car's start pose on /initialpose (geometry_msgs/PoseWithCovarianceStamped, frame map) before the "
        "first state of each episode",
        commands=(),
        graph_only=False,
    )
