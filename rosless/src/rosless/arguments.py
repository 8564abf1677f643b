"""``--ros-args``: remaps, parameters and log levels from the command line and from the environment."""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from rosless import names
from rosless.exceptions import RCLError
from rosless.parameters import yaml_values

ENVIRONMENT_VARIABLE = "ROSLESS_ARGS"

_START, _END = "--ros-args", "--"
_IGNORED_FLAGS = frozenset(
    f"--{switch}-{what}-logs" for switch in ("enable", "disable") for what in ("rosout", "stdout", "external-lib")
)
_IGNORED_OPTIONS = frozenset(["--log-config-file", "--log-file-name", "-e", "--enclave"])
_REMAP = re.compile(r"(?:(?P<node>[A-Za-z_]\w*):(?!//))?(?P<from>[^:=]\S*?):=(?P<to>\S+)")
_PARAMETER = re.compile(r"(?:(?P<node>[^\s:]+):)?(?P<name>[^\s:]+?):=(?P<value>.*)", re.DOTALL)


class UnknownROSArgsError(RuntimeError):
    """Raised for an argument after --ros-args that is none."""


class InvalidROSArgsError(RCLError):
    """Raised for a ROS argument with an invalid value."""


@dataclass(frozen=True)
class Remap:
    """``[node:]from:=to``."""

    node: str | None
    source: str
    target: str


@dataclass
class Arguments:
    """What the ROS arguments say."""

    remaps: list[Remap] = field(default_factory=list)
    # node name or pattern -> parameters; a later pattern that matches overrides an earlier one
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    log_levels: dict[str, str] = field(default_factory=dict)  # logger name ("" is the default) -> level

    def node_name(self, name: str) -> str:
        """The name of a node after remapping."""
        return self._special(("__node", "__name"), name) or name

    def namespace(self, namespace: str, node_name: str) -> str:
        """The namespace of a node after remapping."""
        return self._special(("__ns",), node_name) or namespace

    def _special(self, sources: tuple[str, ...], node_name: str) -> str | None:
        for remap in self.remaps:
            if remap.source in sources and remap.node in (None, node_name):
                return remap.target
        return None

    def topic(self, topic: str, node_name: str, namespace: str, *, is_service: bool = False) -> str | None:
        """The new name of an absolute topic, or None if no rule fits."""
        wanted = "rosservice://" if is_service else "rostopic://"
        for remap in self.remaps:
            source = remap.source
            if source.startswith("__") or remap.node not in (None, node_name):
                continue
            if "://" in source:
                if not source.startswith(wanted):
                    continue
                source = source.removeprefix(wanted)
            if names.expand(source, node_name, namespace) == topic:
                return names.expand(remap.target, node_name, namespace)
        return None

    def parameters_for(self, fully_qualified_name: str) -> dict[str, Any]:
        """The parameter values for one node."""
        result: dict[str, Any] = {}
        for pattern, values in self.parameters.items():
            if yaml_values.node_name_matches(pattern, fully_qualified_name):
                result.update(values)
        return result


def parse(args: Sequence[str]) -> Arguments:
    """The ROS arguments among a command line's."""
    result = Arguments()
    overrides: list[tuple[str, str, Any]] = []
    for section in _sections(args):
        index = 0
        while index < len(section):
            index += _parse_one(section, index, result, overrides)
    # single parameters are laid over all files, wherever they stand
    for node, name, value in overrides:
        result.parameters.setdefault(node, {})[name] = value
    return result


def parse_with_environment(args: Sequence[str]) -> Arguments:
    """As :func:`parse`, with those of $ROSLESS_ARGS before them."""
    text = os.environ.get(ENVIRONMENT_VARIABLE, "")
    try:
        given = shlex.split(text)
    except ValueError as error:
        raise InvalidROSArgsError(f"{ENVIRONMENT_VARIABLE} cannot be split into arguments: {error}") from error
    if not given:
        return parse(args)
    if given[0] != _START:
        given.insert(0, _START)
    # --ros-args is closed here, so that the program's own arguments do not become ROS arguments
    return parse([*given, _END, *args])


def remove_ros_args(args: Sequence[str] | None = None) -> list[str]:
    """The arguments that are none of ROS's; the program's name stays."""
    result, inside = [], False
    for argument in sys.argv if args is None else args:
        if argument == _START:
            inside = True
        elif inside and argument == _END:
            inside = False
        elif not inside:
            result.append(argument)
    return result


def _sections(args: Sequence[str]) -> list[list[str]]:
    sections: list[list[str]] = []
    inside = False
    for argument in args:
        if argument == _START:
            if not inside:
                sections.append([])
            inside = True
        elif inside and argument == _END:
            inside = False
        elif inside:
            sections[-1].append(argument)
    return sections


def _parse_one(
    section: list[str], index: int, result: Arguments, overrides: list[tuple[str, str, Any]]
) -> int:  # number of arguments used
    flag = section[index]
    if flag in _IGNORED_FLAGS:
        return 1
    if flag not in ("-r", "--remap", "-p", "--param", "--params-file", "--log-level") and flag not in _IGNORED_OPTIONS:
        raise UnknownROSArgsError(f"found unknown ROS arguments: {flag!r}")
    if index + 1 >= len(section):
        raise InvalidROSArgsError(f"{flag} needs a value after it")
    value = section[index + 1]
    if flag in ("-r", "--remap"):
        result.remaps.append(_remap(value))
    elif flag in ("-p", "--param"):
        overrides.append(_parameter(value))
    elif flag == "--params-file":
        try:
            nodes = yaml_values.load_file(value)
        except yaml_values.YamlError as error:
            raise InvalidROSArgsError(str(error)) from error
        for node, parameters in nodes.items():
            result.parameters.setdefault(node, {}).update(parameters)
    elif flag == "--log-level":
        logger, separator, level = value.rpartition(":=")
        if level.upper() not in ("DEBUG", "INFO", "WARN", "ERROR", "FATAL") or (separator and not logger):
            raise InvalidROSArgsError(f"--log-level must be [logger:=]debug|info|warn|error|fatal, got {value!r}")
        result.log_levels[logger] = level.upper()
    return 2


def _remap(text: str) -> Remap:
    match = _REMAP.fullmatch(text)
    if not match:
        raise InvalidROSArgsError(f"a remap must look like [node:]from:=to, got {text!r}")
    node, source, target = match["node"], match["from"], match["to"]
    if source in ("__node", "__name"):
        names.validate_node_name(target)
    elif source == "__ns":
        names.validate_namespace(target)
    elif "://" not in source:
        names.validate_topic_name(source)
        names.validate_topic_name(target)
    return Remap(node, source, target.removeprefix("rostopic://").removeprefix("rosservice://"))


def _parameter(text: str) -> tuple[str, str, Any]:
    match = _PARAMETER.fullmatch(text)
    if not match:
        raise InvalidROSArgsError(f"a parameter must look like [node:]name:=value, got {text!r}")
    try:
        value = yaml_values.parse(match["value"])
    except yaml_values.YamlError as error:
        raise InvalidROSArgsError(f"parameter {match['name']}: {error}") from error
    return yaml_values.absolute(match["node"] or "/**"), match["name"], value
