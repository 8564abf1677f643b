"""Parsed interface definitions: rosbags' typestore for standard packages, .msg and .srv files for the rest."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.msg import MSGParser
from rosbags.typesys.store import Typestore

from rosless.interfaces import packages, standard_services

# The typestore keeps no default values. These are all that the standard packages' .msg files give to
# members that would not be zero otherwise.
_STANDARD_DEFAULTS: dict[str, dict[str, Any]] = {
    "geometry_msgs/msg/Quaternion": {"w": 1.0},
    "sensor_msgs/msg/NavSatStatus": {"status": -2},
}

_PLACEHOLDER = "structure_needs_at_least_one_member"

_lock = threading.RLock()
_custom_defaults: dict[str, dict[str, Any]] = {}
_loaded_packages: set[str] = set()


class UnknownInterfaceError(ImportError):
    """An interface that neither the typestore nor any searched folder defines."""


@dataclass(frozen=True)
class Field:
    """One member of a message; ``kind`` says what :attr:`base`, :attr:`size` and :attr:`nested` mean."""

    name: str
    kind: Nodetype  # BASE, NAME, ARRAY or SEQUENCE
    base: str  # primitive type name, or "" for a message
    nested: str  # full type name of a message, or ""
    size: int  # array length, or the upper bound of a sequence (0: none)
    string_bound: int  # upper bound of a string (0: none)
    default: Any  # from the definition, or None

    @property
    def is_collection(self) -> bool:
        """True for arrays and sequences."""
        return self.kind in (Nodetype.ARRAY, Nodetype.SEQUENCE)


@dataclass(frozen=True)
class Definition:
    """A message type: ``pkg/msg/Name`` with its members and constants."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[tuple[str, str, Any], ...]  # name, base type, value

    @property
    def is_empty(self) -> bool:
        """True if the definition has no member of its own (the wire then carries one zero byte)."""
        return not self.fields or self.fields[0].name == _PLACEHOLDER


@cache
def typestore() -> Typestore:
    """The typestore of this process: ROS 2 Jazzy's messages plus every custom package asked for so far."""
    return get_typestore(Stores.ROS2_JAZZY)


def message_names(package: str) -> list[str]:
    """Names of the messages of a package, without prefix."""
    load_package(package)
    prefix = f"{package}/msg/"
    return sorted(name[len(prefix) :] for name in typestore().fielddefs if name.startswith(prefix))


def service_names(package: str) -> list[str]:
    """Names of the services of a package, without prefix."""
    load_package(package)
    prefix, suffix = f"{package}/srv/", "_Request"
    names = (name for name in typestore().fielddefs if name.startswith(prefix) and name.endswith(suffix))
    return sorted(name[len(prefix) : -len(suffix)] for name in names)


@cache
def definition(name: str) -> Definition:
    """The definition of ``pkg/msg/Name`` (or ``pkg/srv/Name_Request``)."""
    load_package(name.partition("/")[0])
    try:
        constants, fields = typestore().fielddefs[name]
    except KeyError:
        raise UnknownInterfaceError(
            f"There is no definition of {name}. Custom packages are searched in "
            f"${packages.MSG_PATH_VARIABLE}, then in {', '.join(packages.search_path())}."
        ) from None
    defaults = _STANDARD_DEFAULTS.get(name) or _custom_defaults.get(name, {})
    return Definition(
        name,
        tuple(_field(field, description, defaults.get(field)) for field, description in fields),
        tuple((constant, base, value) for constant, base, value in constants),
    )


def _field(name: str, description: Any, default: Any) -> Field:
    kind, content = description
    size = 0
    item_kind, item = kind, content
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        (item_kind, item), size = content
    if item_kind == Nodetype.NAME:
        return Field(name, kind, "", item, size, 0, default)
    base, bound = item
    return Field(name, kind, base, "", size, bound, default)


def load_package(package: str) -> None:
    """Register the definitions of a package, and of the packages that they use, in the typestore."""
    with _lock:
        if package in _loaded_packages:
            return
        _loaded_packages.add(package)
        texts = standard_services.TEXTS.get(package, {})
        for service, text in texts.items():
            _register_service(package, service, text)
        if package in packages.STANDARD_PACKAGES:
            return
        folder = packages.find(package)
        if folder is None:
            return
        for path in map(Path, packages.interface_files(folder, "msg")):
            _register(f"{package}/msg/{path.stem}", path.read_text(encoding="utf-8"), str(path))
        for path in map(Path, packages.interface_files(folder, "srv")):
            _register_service(package, path.stem, path.read_text(encoding="utf-8"))


def _register_service(package: str, service: str, text: str) -> None:
    request, _, response = ("\n" + text.strip("\n") + "\n").partition("\n---")
    for part, body in (("Request", request), ("Response", response)):
        _register(f"{package}/srv/{service}_{part}", body, f"{package}/srv/{service}")


def _register(name: str, text: str, origin: str) -> None:
    # The parser knows only the folder "msg"; a service's halves are renamed after parsing.
    package, _, short = name.split("/")
    parsed_name = f"{package}/msg/{short}"
    try:
        types = get_types_from_msg(text, parsed_name)
        defaults = _defaults(text, parsed_name)
    except TypesysError as error:
        raise UnknownInterfaceError(f"{origin} is not a valid definition: {error}") from error
    constants, fields = types[parsed_name]
    if not fields:
        fields = [(_PLACEHOLDER, (Nodetype.BASE, ("uint8", 0)))]
    for _, description in fields:
        item = description[1][0] if description[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else description
        if item[0] == Nodetype.NAME:
            load_package(item[1].partition("/")[0])
    store = typestore()
    if parsed_name == name:
        store.register({name: (constants, fields)})
    else:
        store.fielddefs[name] = (constants, fields)
    if defaults:
        _custom_defaults[name] = defaults


def _defaults(text: str, name: str) -> dict[str, Any]:
    messages = MSGParser(f"MSG: {name}\n{text}\n").specification()
    return {field.name: field.value for field in messages[0].fields if field.value is not None}


@cache
def type_hash(name: str) -> str:
    """The RIHS01 hash of a message type, as ROS 2 puts it into the discovery data."""
    load_package(name.partition("/")[0])
    return _hash_store(name).hash_rihs01(name)


@cache
def service_type_hash(package: str, service: str) -> str:
    """The RIHS01 hash of a service type, which covers request, response and the event for introspection."""
    load_package(package)
    name = f"{package}/srv/{service}"
    request, response, event = (f"{name}_{part}" for part in ("Request", "Response", "Event"))
    store = _hash_store(request, response, "service_msgs/msg/ServiceEventInfo")
    store.fielddefs[event] = (
        [],
        [
            ("info", (Nodetype.NAME, "service_msgs/msg/ServiceEventInfo")),
            ("request", (Nodetype.SEQUENCE, ((Nodetype.NAME, request), 1))),
            ("response", (Nodetype.SEQUENCE, ((Nodetype.NAME, response), 1))),
        ],
    )
    store.fielddefs[name] = (
        [],
        [
            ("request_message", (Nodetype.NAME, request)),
            ("response_message", (Nodetype.NAME, response)),
            ("event_message", (Nodetype.NAME, event)),
        ],
    )
    return store.hash_rihs01(name)


def _hash_store(*names: str) -> Typestore:
    """Definitions of these types, and of those in them, in which char is uint8.

    ROS 2 reads .msg files so, and hashes what it has read.
    """
    store = Typestore()
    missing = list(names)
    while missing:
        name = missing.pop()
        if name in store.fielddefs:
            continue
        constants, fields = typestore().fielddefs[name]
        store.fielddefs[name] = constants, [(field, _without_char(content)) for field, content in fields]
        missing += [field.nested for field in definition(name).fields if field.nested]
    return store


def _without_char(description: Any) -> Any:
    kind, content = description
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        item, size = content
        return kind, (_without_char(item), size)
    if kind == Nodetype.BASE and content[0] == "char":
        return kind, ("uint8", content[1])
    return description
