"""Names of nodes and topics: what is valid, and how they expand, as rcl and rmw have it."""

from __future__ import annotations

import re
from collections.abc import Callable

from rosless.exceptions import (
    InvalidNamespaceException,
    InvalidNodeNameException,
    InvalidParameterException,
    InvalidServiceNameException,
    InvalidTopicNameException,
    NameValidationException,
)

_SUBSTITUTION = re.compile(r"\{([^{}]*)\}")
_MAX_NODE_NAME = 255
_MAX_TOPIC_NAME = 247  # DDS limits a topic's name to 255 bytes, the prefix included
_Problem = tuple[str, int]


def validate_node_name(node_name: str) -> bool:
    """True, or InvalidNodeNameException."""
    problem = _token_problem(node_name, "node name")
    if problem:
        raise InvalidNodeNameException(node_name, *problem)
    return True


def validate_namespace(namespace: str) -> bool:
    """True, or InvalidNamespaceException."""
    problem: _Problem | None = None
    if not namespace:
        problem = "namespace must not be empty", 0
    elif not namespace.startswith("/"):
        problem = "namespace must be absolute, it must lead with a '/'", 0
    elif namespace != "/":
        problem = _path_problem(namespace, "namespace", allowed="")
    if problem:
        raise InvalidNamespaceException(namespace, *problem)
    return True


def validate_topic_name(name: str, *, is_service: bool = False) -> bool:
    """True, or InvalidTopicNameException; the name may be relative or private and hold substitutions."""
    return _validate_topic(name, is_service, allowed="~{}")


def validate_full_topic_name(name: str, *, is_service: bool = False) -> bool:
    """True, or InvalidTopicNameException; the name must be absolute."""
    if not name.startswith("/"):
        raise _topic_error(is_service)(name, "topic name must be absolute, it must lead with a '/'", 0)
    return _validate_topic(name, is_service, allowed="")


def validate_parameter_name(name: str) -> bool:
    """True, or InvalidParameterException."""
    if not name:
        raise InvalidParameterException(name)
    return True


def expand_topic_name(topic_name: str, node_name: str, node_namespace: str) -> str:
    """The absolute name of a relative or private one."""
    validate_topic_name(topic_name)
    validate_node_name(node_name)
    validate_namespace(node_namespace)
    return expand(topic_name, node_name, node_namespace)


def expand(name: str, node_name: str, node_namespace: str) -> str:
    """As :func:`expand_topic_name`, without checking what is given."""
    private = join(node_namespace, node_name)
    if name.startswith("~"):
        name = private + name[1:]
    values = {"node": node_name, "ns": node_namespace, "namespace": node_namespace}

    def value(match: re.Match[str]) -> str:
        if match[1] not in values:
            raise InvalidTopicNameException(name, f"unknown substitution '{{{match[1]}}}'", match.start())
        return values[match[1]]

    name = _SUBSTITUTION.sub(value, name)
    return name if name.startswith("/") else join(node_namespace, name)


def join(namespace: str, name: str) -> str:
    """``/ns`` and ``name`` -> ``/ns/name``."""
    return f"{namespace.rstrip('/')}/{name}"


def normalize_namespace(namespace: str) -> str:
    """An absolute namespace from one that may be empty or relative."""
    if not namespace:
        return "/"
    return namespace if namespace.startswith("/") else f"/{namespace}"


def topic_to_dds(topic: str, *, avoid_ros_namespace_conventions: bool = False, prefix: str = "rt") -> str:
    """``/topic`` -> ``rt/topic``."""
    return topic if avoid_ros_namespace_conventions else f"{prefix}{topic}"


def topic_from_dds(name: str) -> str | None:
    """``rt/topic`` -> ``/topic``, None for what is no ROS topic."""
    return name[2:] if name.startswith("rt/") else None


def is_topic_name_hidden(name: str) -> bool:
    """True if some part of the name starts with an underscore."""
    return any(part.startswith("_") for part in name.split("/"))


def _validate_topic(name: str, is_service: bool, *, allowed: str) -> bool:
    problem: _Problem | None = None
    if not name:
        problem = "topic name must not be empty string", 0
    elif name == "/":
        problem = "topic name must not end with a forward slash", 0
    elif "~" in allowed and name.startswith("~") and len(name) > 1 and name[1] != "/":
        problem = "tilde (~) must be followed by a forward slash", 0
    else:
        problem = _path_problem(name, "topic name", allowed)
    if not problem and len(name) > _MAX_TOPIC_NAME:
        problem = f"topic name must not be longer than {_MAX_TOPIC_NAME} characters", _MAX_TOPIC_NAME
    if problem:
        raise _topic_error(is_service)(name, *problem)
    return True


def _topic_error(is_service: bool) -> Callable[[str, str, int], NameValidationException]:
    return InvalidServiceNameException if is_service else InvalidTopicNameException


def _path_problem(name: str, what: str, allowed: str) -> _Problem | None:
    if name.endswith("/"):
        return f"{what} must not end with a forward slash", len(name) - 1
    for index, character in enumerate(name):
        if character == "~" and (index or "~" not in allowed):
            return f"{what} must not contain a tilde (~) other than at its start", index
        if not (character == "/" or _is_name_character(character) or character in allowed):
            return (
                f"{what} must not contain characters other than alphanumerics, '_', '~', '{{', or '}}'",
                index,
            )
    if "//" in name:
        return f"{what} must not contain repeated '/'", name.index("//") + 1
    for match in re.finditer(r"(?:^|/)([0-9])", name):
        return f"{what} token must not start with a number", match.start(1)
    return None


def _token_problem(name: str, what: str) -> _Problem | None:
    if not name:
        return f"{what} must not be empty", 0
    for index, character in enumerate(name):
        if not _is_name_character(character):
            return f"{what} must not contain characters other than alphanumerics or '_'", index
    if name[0].isdigit():
        return f"{what} must not start with a number", 0
    if len(name) > _MAX_NODE_NAME:
        return f"{what} must not be longer than {_MAX_NODE_NAME} characters", _MAX_NODE_NAME
    return None


def _is_name_character(character: str) -> bool:
    return character == "_" or (character.isascii() and character.isalnum())
