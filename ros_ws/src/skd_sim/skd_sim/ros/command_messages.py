"""Commands of a car under test, read out of messages of any type: the type by its name, the number by its path."""

from __future__ import annotations

import functools
import importlib
import inspect
import operator
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from rosidl_parser.definition import AbstractNestedType, Array, BasicType, NamespacedType

from skd_sim.errors import UsageError
from skd_sim.options.graph_options import CommandOptions
from skd_sim.options.registry import reason_of
from skd_sim.ros.commands import CommandFormat, command_format
from skd_sim.ros.from_messages import from_stamp

Reader = Callable[[Any], tuple[int | None, tuple[float, float]]]
"""From a message to its stamp (ns; none where the type has none) and the command with its limit (0: none)."""

_STEP = re.compile(r"([A-Za-z]\w*)(?:\[(\d+)\])?")
_NOT_NUMBERS = ("boolean", "char", "wchar", "octet")
_MOST_NAMED = 24  # fields in one line of an error
_TIME = "builtin_interfaces/msg/Time"


@dataclass(frozen=True)
class CarCommands:
    """The commands of a car under test: their message type, and where the number is in it.

    Attributes:
        format: format of the commands, as it was asked for.
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
    limit = _getter(chosen.limit, kind, chosen.type) if chosen.limit else None
    stamp = _stamp_getter(kind)

    def read(message: Any) -> tuple[int | None, tuple[float, float]]:
        said = from_stamp(stamp(message)) if stamp else None
        return said, (float(take(message)), float(limit(message)) if limit else 0.0)

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
            f"--command-type {name}: there is no message package {package} here: source the workspace that has it, or "
            "give the folder of its .msg files with --message-folder"
        ) from error
    except Exception as error:  # what a package does at its import is its own affair
        raise UsageError(f"{name} cannot be loaded: {reason_of(error)}") from error
    found = getattr(module, kind, None)
    if not _is_message(found):
        there = sorted(key for key, value in vars(module).items() if _is_message(value))
        raise UsageError(f"--command-type {name}: {package} has no such message; it has {_listed(there)}")
    assert isinstance(found, type)
    return found


def _is_message(thing: Any) -> bool:
    return inspect.isclass(thing) and hasattr(thing, "get_fields_and_field_types")


def _fields(kind: Any) -> dict[str, Any]:
    """Return the fields of a message class by name, with their types."""
    return dict(zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True))


def _class_of(kind: NamespacedType) -> type:
    return message_class("/".join(kind.namespaced_name()))


def _is_number(kind: Any) -> bool:
    return isinstance(kind, BasicType) and kind.typename not in _NOT_NUMBERS


def number_paths(kind: type, before: str = "") -> Iterator[str]:
    """Yield the paths of the numbers in a message class; for an array that of its first number.

    Args:
        kind: class of the message.
        before: path of the message itself, with a full stop behind it; empty for a whole message.
    """
    for name, of in _fields(kind).items():
        path = f"{before}{name}"
        if isinstance(of, AbstractNestedType):
            of, path = of.value_type, f"{path}[0]"
        if _is_number(of):
            yield path
        elif isinstance(of, NamespacedType) and "/".join(of.namespaced_name()) != _TIME:
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
    if not field:
        raise UsageError(f"--command-type {name} needs --command-field; its numbers are {_listed(number_paths(kind))}")
    steps: list[Callable[[Any], Any]] = []
    here: Any = kind  # a class, or the type of a field that is no message
    before = ""
    for part in field.split("."):
        match = _STEP.fullmatch(part)
        found = _fields(here).get(match[1]) if match and inspect.isclass(here) else None
        if found is None or match is None:
            raise UsageError(f"{name} has no field {before}{part}; {_what_there_is(here, before)}")
        steps.append(operator.attrgetter(match[1]))
        if match[2] is not None:
            found = _element(found, int(match[2]), f"{before}{part}", name)
            steps.append(operator.itemgetter(int(match[2])))
        here = _class_of(found) if isinstance(found, NamespacedType) else found
        before = f"{before}{part}."
    if not _is_number(here):
        raise UsageError(f"{field} of {name} is no number; {_what_there_is(here, before)}")
    if all(isinstance(step, operator.attrgetter) for step in steps):
        return operator.attrgetter(field)
    return lambda message: functools.reduce(lambda value, step: step(value), steps, message)


def _element(kind: Any, index: int, path: str, name: str) -> Any:
    """Return the type of an array's element.

    Raises:
        UsageError: there is no such element.
    """
    if not isinstance(kind, AbstractNestedType):
        raise UsageError(f"{path} of {name}: this field is no array; leave out [{index}]")
    if isinstance(kind, Array) and index >= kind.size:
        raise UsageError(f"{path} of {name}: this array has {kind.size} elements, from [0] on")
    return kind.value_type


def _what_there_is(here: Any, before: str) -> str:
    """Return, in words, which numbers there are below a place in the message."""
    at = before.rstrip(".")
    if isinstance(here, AbstractNestedType):
        return f"{at} is an array: name one of its elements, as in {at}[0]"
    if not inspect.isclass(here):
        return f"{at} is of type {getattr(here, 'typename', 'string')}"
    return f"{'its' if not at else 'the'} numbers {'' if not at else 'there '}are {_listed(number_paths(here, before))}"


def _listed(names: Any) -> str:
    found = list(names)
    more = f", … ({len(found)} in all)" if len(found) > _MOST_NAMED else ""
    return ", ".join(found[:_MOST_NAMED]) + more if found else "none"


def _stamp_getter(kind: type) -> Callable[[Any], Any] | None:
    """Return a function that takes the stamp out of a message; None if the type has no stamp."""
    fields = _fields(kind)
    for name, of in fields.items():
        if not isinstance(of, NamespacedType):
            continue
        said = "/".join(of.namespaced_name())
        if (name, said) == ("header", "std_msgs/msg/Header"):
            return operator.attrgetter("header.stamp")
        if (name, said) == ("stamp", _TIME):
            return operator.attrgetter("stamp")
    return None
