"""What a car under test may publish: which message, which numbers in it, and what they mean.

Types with a name of their own stand in one table; others are described by ROS name, field and quantity. Message types
are imported by their names, so that nothing of ROS is needed until one is.
"""

from __future__ import annotations

import functools
import importlib
import operator
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, cast

from skd_sim.errors import UsageError
from skd_sim.options.options import CommandOptions
from skd_sim.options.registry import reason_of
from skd_sim.ros.from_messages import from_stamp
from skd_sim.world.dynamics.basic import CommandLimits, steering_angle

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
        steering: path of the number that steers, to the left; or empty: the command does not steer.
        is_yaw_rate: whether that number is a yaw rate, rad/s, and not the angle of the front wheels, rad.
    """

    type: str
    field: str
    quantity: Quantity
    limit: str = ""
    steering: str = ""
    is_yaw_rate: bool = False

    @property
    def package(self) -> str:
        """Name of the ROS package that defines the message."""
        return self.type.partition("/")[0]


NAMED_FORMATS = {
    # It has no field for a steering angle, which SKD's own node has to send to the last bit.
    "accel_stamped": CommandFormat(
        "geometry_msgs/msg/AccelStamped", "accel.linear.x", Quantity.ACCELERATION, steering="accel.angular.z"
    ),
    "twist_stamped": CommandFormat(
        "geometry_msgs/msg/TwistStamped", "twist.linear.x", Quantity.SPEED, steering="twist.angular.z", is_yaw_rate=True
    ),
    "twist": CommandFormat(
        "geometry_msgs/msg/Twist", "linear.x", Quantity.SPEED, steering="angular.z", is_yaw_rate=True
    ),
    # Its definition: drive at the speed; an acceleration of zero means as quickly as possible, another one is the
    # desired magnitude, of decelerations too.
    "ackermann": CommandFormat(
        "ackermann_msgs/msg/AckermannDriveStamped",
        "drive.speed",
        Quantity.SPEED,
        "drive.acceleration",
        "drive.steering_angle",
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
    change = (target - speed) / duration
    if limit > 0.0:
        change = CommandLimits(-limit, limit).clip(change)
    return bounds.clip(change)


_SLOW = 0.5
"""m/s below which a yaw rate is followed as at this speed: a standing car does not turn."""


def angle_of_yaw_rate(yaw_rate: float, speed: float, wheelbase: float) -> float:
    """Return the steering angle (rad) for a yaw rate (rad/s) at a speed (m/s)."""
    return steering_angle(yaw_rate / max(speed, _SLOW), wheelbase)


def command_format(options: CommandOptions) -> CommandFormat:
    """Return the kind of command that options ask for; whether the type has such a field is not looked at.

    Raises:
        UsageError: the type is neither a name nor a ROS type, or a field or quantity does not go with it.
    """
    named = NAMED_FORMATS.get(options.command_type)
    if named is not None:
        if options.command_field or options.command_steering:
            raise UsageError(
                f"command_field and command_steering go with a type of yours: command_type {options.command_type} "
                f"already says {named.field} of {named.type}"
            )
        return named
    if not _TYPE.fullmatch(options.command_type):
        raise UsageError(
            f"command_type must be one of {', '.join(NAMED_FORMATS)}, or a message type as in "
            f"my_msgs/msg/Command; got {options.command_type!r:.80}"
        )
    quantity = Quantity(options.command_quantity)
    return CommandFormat(options.command_type, options.command_field, quantity, steering=options.command_steering)


Reader = Callable[[Any], tuple[int | None, tuple[float, float, float]]]
"""From a message to its stamp (ns; none where the type has none) and the command, its limit (0: none), and steering."""

_STEP = re.compile(r"([A-Za-z]\w*)(?:\[(\d+)\])?")
_ARRAY = re.compile(r"sequence<([^,>]+).*>|(.+)\[(\d+)\]")  # of any length, or of a fixed one
_NUMBER = re.compile(r"float|double|long double|u?int(8|16|32|64)")
_MOST_NAMED = 24  # fields in one line of an error
_HEADER, _TIME = "std_msgs/Header", "builtin_interfaces/Time"


@dataclass(frozen=True)
class CarCommands:
    """The commands of a car under test: their message type, and where the number is in it.

    Attributes:
        format: format of the commands, as the options have it.
        kind: class of its messages.
        stamped: whether the messages say for which time they are, in header.stamp or stamp.
        read: takes one out of a message; raises `IndexError` where its array is too short.
    """

    format: CommandFormat
    kind: type
    stamped: bool
    read: Reader


def car_commands(options: CommandOptions) -> CarCommands:
    """Find the message type and the field that the options name.

    Raises:
        UsageError: there is no such type, or no such number in it.
    """
    chosen = command_format(options)
    kind = message_class(chosen.type)
    take = _getter(chosen.field, kind, chosen.type)
    limit, steering = (
        _getter(field, kind, chosen.type) if field else (lambda _message: 0.0)
        for field in (chosen.limit, chosen.steering)
    )
    fields = _fields(kind)
    stamp = operator.attrgetter("header.stamp") if fields.get("header") == _HEADER else None
    if stamp is None and fields.get("stamp") == _TIME:
        stamp = operator.attrgetter("stamp")

    def read(message: Any) -> tuple[int | None, tuple[float, float, float]]:
        said = from_stamp(stamp(message)) if stamp else None
        return said, (float(take(message)), float(limit(message)), float(steering(message)))

    return CarCommands(chosen, kind, stamp is not None, read)


def message_class(name: str) -> type:
    """Return the class of a message type, as in geometry_msgs/msg/Twist.

    Raises:
        UsageError: there is no such package, no such message in it, or it cannot be loaded.
    """
    package, _, kind = name.split("/")
    try:
        module = importlib.import_module(f"{package}.msg")
    except ModuleNotFoundError as error:
        if error.name not in (package, f"{package}.msg"):
            raise UsageError(f"{name} cannot be loaded: {reason_of(error)}") from error
        raise UsageError(
            f"command_type {name}: there is no message package {package} here: source the workspace that has it, or "
            "give the folder of its .msg files with message_folder"
        ) from error
    except Exception as error:  # what a package does at its import is its own affair
        raise UsageError(f"{name} cannot be loaded: {reason_of(error)}") from error
    found: Any = getattr(module, kind, None)
    if not hasattr(found, "get_fields_and_field_types"):
        there = sorted(key for key, value in vars(module).items() if hasattr(value, "get_fields_and_field_types"))
        raise UsageError(f"command_type {name}: {package} has no such message; it has {_listed(there)}")
    return cast("type", found)


def _fields(kind: Any) -> dict[str, str]:
    """Return the types of a message's fields by their names, as `double`, `float[9]` or `std_msgs/Header`."""
    return dict(kind.get_fields_and_field_types())


def _class_of(kind: str) -> type:
    return message_class(kind.replace("/", "/msg/"))


def number_paths(kind: type, before: str = "") -> Iterator[str]:
    """Yield the paths of the numbers in a message class; for an array that of its first number.

    Args:
        kind: class of the message.
        before: path of the message itself, with a full stop behind it; empty for a whole message.
    """
    for name, of in _fields(kind).items():
        path = f"{before}{name}"
        if array := _ARRAY.fullmatch(of):
            of, path = array[1] or array[2], f"{path}[0]"
        if _NUMBER.fullmatch(of):
            yield path
        elif "/" in of and of != _TIME:
            yield from number_paths(_class_of(of), f"{path}.")


def _getter(field: str, kind: type, name: str) -> Callable[[Any], Any]:
    """Return a function that takes the number at a path out of a message.

    Args:
        field: path of the number in the message.
        kind: class of the message.
        name: ROS name of the message type, for error lines.

    Raises:
        UsageError: there is no number at this path; says which there are.
    """
    numbers = f"its numbers are {_listed(number_paths(kind))}"
    if not field:
        raise UsageError(f"command_type {name} needs command_field; {numbers}")
    steps: list[Callable[[Any], Any]] = []
    of, here = "", _fields(kind)
    for part in field.split("."):
        match = _STEP.fullmatch(part)
        of = here.get(match[1], "") if match else ""
        if match and match[2] is not None:
            array, index = _ARRAY.fullmatch(of), int(match[2])
            of = (array[1] or array[2]) if array and index < int(array[3] or index + 1) else ""
        if not match or not of:
            break
        steps.append(operator.attrgetter(match[1]))
        if match[2] is not None:
            steps.append(operator.itemgetter(index))
        here = _fields(_class_of(of)) if "/" in of and not _ARRAY.fullmatch(of) else {}
    if not _NUMBER.fullmatch(of):
        raise UsageError(f"there is no number {field} in {name}; {numbers}")
    if all(isinstance(step, operator.attrgetter) for step in steps):
        return operator.attrgetter(field)
    return lambda message: functools.reduce(lambda value, step: step(value), steps, message)


def _listed(names: Iterable[str]) -> str:
    found = list(names)
    more = f", … ({len(found)} in all)" if len(found) > _MOST_NAMED else ""
    return ", ".join(found[:_MOST_NAMED]) + more if found else "none"
