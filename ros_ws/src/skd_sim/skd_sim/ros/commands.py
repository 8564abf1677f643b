"""What a car under test may publish: which message, which number in it, and what that number means.

Types with a name of their own stand in one table; others are described by ROS name, field and quantity.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum

from skd_sim.errors import UsageError
from skd_sim.options.graph_options import CommandOptions
from skd_sim.world.dynamics.limits import CommandLimits

_TYPE = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Za-z][A-Za-z0-9]*")


class Quantity(StrEnum):
    """Quantity that a command gives the car, such as an acceleration."""

    ACCELERATION = "acceleration"
    """m/s²."""
    SPEED = "speed"
    """A target, m/s, which the simulator's car follows within its bounds."""


@dataclass(frozen=True)
class CommandFormat:
    """A kind of command that a car under test may publish.

    Attributes:
        type: ROS name of the message, for example geometry_msgs/msg/AccelStamped.
        field: path of the number in the message, for example accel.linear.x or axes[1].
        quantity: what the number is.
        limit: path of another number, the greatest change of speed that a speed target asks for, m/s², 0: any; or
            empty: there is none.
    """

    type: str
    field: str
    quantity: Quantity
    limit: str = ""

    @property
    def package(self) -> str:
        """Name of the ROS package that defines the message."""
        return self.type.partition("/")[0]


NAMED_FORMATS = {
    "accel_stamped": CommandFormat("geometry_msgs/msg/AccelStamped", "accel.linear.x", Quantity.ACCELERATION),
    "twist_stamped": CommandFormat("geometry_msgs/msg/TwistStamped", "twist.linear.x", Quantity.SPEED),
    "twist": CommandFormat("geometry_msgs/msg/Twist", "linear.x", Quantity.SPEED),
    # Its definition: drive at the speed; an acceleration of zero means as quickly as possible, another one is the
    # desired magnitude, of decelerations too.
    "ackermann": CommandFormat(
        "ackermann_msgs/msg/AckermannDriveStamped", "drive.speed", Quantity.SPEED, "drive.acceleration"
    ),
}


def follow_speed(target: float, speed: float, duration: float, bounds: CommandLimits, limit: float = 0.0) -> float:
    """Return the acceleration (m/s²) with which a car follows a speed target.

    Args:
        target: target speed, m/s.
        speed: speed of the car now, m/s.
        duration: time after which the car is to have the target speed, s.
        bounds: least and greatest acceleration with which the car follows.
        limit: greatest change of speed that the target itself allows, m/s²; with 0 any is allowed.
    """
    wanted = (target - speed) / duration
    if limit > 0.0:
        wanted = CommandLimits(-limit, limit).clip(wanted)
    return bounds.clip(wanted)


def command_format(options: CommandOptions) -> CommandFormat:
    """Return the kind of command that options ask for; whether the type has such a field is not looked at.

    Raises:
        UsageError: the type is neither a name nor a ROS type, or a field or quantity does not go with it.
    """
    named = NAMED_FORMATS.get(options.command_type)
    if named is not None:
        if options.command_field:
            raise UsageError(
                f"--command-field goes with a type of yours: --command-type {options.command_type} already says "
                f"{named.field} of {named.type}"
            )
        return named
    if not _TYPE.fullmatch(options.command_type):
        raise UsageError(
            f"--command-type must be one of {', '.join(NAMED_FORMATS)}, or a message type as in "
            f"my_msgs/msg/Command; got {options.command_type!r:.80}"
        )
    return CommandFormat(options.command_type, options.command_field, Quantity(options.command_quantity))
