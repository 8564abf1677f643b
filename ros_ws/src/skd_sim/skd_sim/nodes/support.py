"""What the nodes share: names of topics, quality of service, parameters with ranges, and `main`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import rclpy
from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

CLOCK = "/clock"
EGO_ODOMETRY = "ego/odometry"
PEDESTRIAN_ODOMETRY = "pedestrian/odometry"
ACCELERATION_COMMAND = "ego/acceleration_command"
VELOCITY_COMMAND = "pedestrian/velocity_command"
EPISODE = "skd/episode"
EPISODE_RESULT = "skd/episode_result"
ASSESSMENT = "skd/assessment"
MARKERS = "skd/markers"

STREAM = QoSProfile(depth=100, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
"""States, commands and results: none may be lost."""

LATCHED = QoSProfile(
    depth=1,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""The current episode and the last assessment: a node that joins late gets it."""


@dataclass(frozen=True)
class Setting:
    """A node parameter: name, default (which fixes the type), description, and range where it is a float."""

    name: str
    default: Any
    description: str
    low: float | None = None
    high: float | None = None
    read_only: bool = True


def declare(node: Node, settings: Sequence[Setting]) -> dict[str, Any]:
    """Declare parameters with descriptor and range, and return their values."""
    values = {}
    for setting in settings:
        descriptor = ParameterDescriptor(description=setting.description, read_only=setting.read_only)
        if setting.low is not None and setting.high is not None:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(setting.low), to_value=float(setting.high), step=0.0)
            ]
        values[setting.name] = node.declare_parameter(setting.name, setting.default, descriptor).value
    return values


def choice(node: Node, name: str, value: str, allowed: Sequence[str]) -> str:
    """Return `value`, or raise ValueError with one clear line where it is not allowed."""
    if value not in allowed:
        raise ValueError(f"{node.get_name()}: parameter {name} must be one of {', '.join(allowed)}; got {value!r}")
    return value


def run_node(make: Callable[[], Node], args: Sequence[str] | None) -> int:
    """Run a node until it is told to end; return the process's exit code."""
    rclpy.init(args=args)
    node: Node | None = None
    try:
        node = make()
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except ValueError as error:
        rclpy.logging.get_logger("skd").fatal(str(error))
        return 2
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0
