"""Message definitions for writing and reading bags: ROS 2 Jazzy's, and those of skd_msgs."""

from __future__ import annotations

import functools
import os
from pathlib import Path

from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from skd_sim.ros_environment.messages import message_package


def _definition_folder() -> Path:
    """Return the folder of skd_msgs' .msg files: of the sourced workspace, else as they come with SKD.

    Raises:
        UsageError: they are in neither place.
    """
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    sourced = [Path(prefix, "share", "skd_msgs", "msg") for prefix in prefixes if prefix]
    return next((folder for folder in sourced if folder.is_dir()), None) or message_package().folder / "msg"


@functools.cache
def typestore() -> Typestore:
    """Return the type store with all messages that the graph uses."""
    return typestore_with({})


def typestore_with(replaced: Typesdict) -> Typestore:
    """Return a type store with all messages that the graph uses, some as another version defined them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in sorted(_definition_folder().glob("*.msg")):
        name = f"skd_msgs/msg/{file.stem}"
        ours = get_types_from_msg(file.read_text(encoding="utf-8"), name)
        store.register({**ours, name: replaced.get(name, ours[name])})
    return store
