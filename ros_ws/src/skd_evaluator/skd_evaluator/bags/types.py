"""Message definitions for writing and reading bags: ROS 2 Jazzy's, those of skd_msgs, and those of a car's commands."""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from skd_sim.errors import UsageError
from skd_sim.ros_environment.installation import PREFIX, message_package, packages_without_wheel


def _shared(package: str) -> Iterator[Path]:
    """Yield the folders of .msg files that a package has in the prefixes of this run, or comes with here, in order."""
    prefixes = [os.environ.get(PREFIX, ""), *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    folders = [Path(prefix, "share", package, "msg") for prefix in prefixes if prefix]
    own = [one.folder / "msg" for one in packages_without_wheel() if one.name == package]  # where none are built
    return (folder for folder in (*folders, *own) if folder.is_dir())


def _definition_folder() -> Path:
    """Return the folder of skd_msgs' .msg files: of the sourced workspace, else as they come with SKD.

    Raises:
        UsageError: they are in neither place.
    """
    sourced = os.environ.get("AMENT_PREFIX_PATH") and next(_shared("skd_msgs"), None)
    return sourced or message_package().folder / "msg"


@functools.cache
def typestore() -> Typestore:
    """Return the type store with all messages that the graph uses."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in sorted(_definition_folder().glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"skd_msgs/msg/{file.stem}"))
    return store


@functools.cache
def types_in(name: str, encoding: str, definition: bytes) -> Typestore:
    """Return a store with a message type as a file defines it, or as it is installed where the file does not say.

    Args:
        name: of the type.
        encoding: of the definition; all but ros2msg is taken as installed.
        definition: as the file has it; some recorders leave it empty, or leave out types that it uses.

    Raises:
        UsageError: the definition cannot be read, or a type is defined nowhere.
    """
    if not definition or encoding != "ros2msg":
        complete(typestore(), name)
        return typestore()
    try:
        types, store = get_types_from_msg(definition.decode(), name), get_typestore(Stores.EMPTY)
        left = [*types]
        while left:
            used = [one for _, field in types[left.pop()][1] for one in _names(field) if one not in types]
            for one in used:
                complete(typestore(), one)
                types[one] = typestore().fielddefs[one]
            left += used
        store.register(types)
    except Exception as error:  # its parser raises whatever the text makes it raise
        raise UsageError(f"the definition of {name:.80} cannot be read ({type(error).__name__})") from error
    return store


def complete(store: Typestore, name: str) -> None:
    """Add a type, and those that it uses, to a store that may not know them.

    Raises:
        UsageError: a definition is nowhere.
    """
    if name in store.fielddefs:
        return
    package, _, kind = name.split("/")
    files = (folder / f"{kind}.msg" for folder in _shared(package))
    file = next((file for file in files if file.is_file()), None)
    if file is None:
        raise UsageError(f"{name} cannot be recorded: there is no {kind}.msg in the share folder of {package}")
    found = get_types_from_msg(file.read_text(encoding="utf-8"), name)
    for _, field in found[name][1]:
        for used in _names(field):
            complete(store, used)
    store.register(found)


def _names(field: Any) -> Iterator[str]:
    """Yield the message types that a field of a definition is of."""
    kind, what = field
    if kind == Nodetype.NAME:
        yield what
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from _names(what[0])
