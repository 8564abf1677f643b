"""Message definitions for writing and reading bags: ROS 2 Jazzy's, and those of skd_msgs."""

from __future__ import annotations

import functools
import os
import sys
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore


def _definition_folder() -> Path:
    """Return the folder of skd_msgs' .msg files: of the sourced workspace, of the checkout, or as installed by pip."""
    places = [Path(prefix) / "share" for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix]
    places += [parent for parent in Path(__file__).resolve().parents if (parent / "skd_msgs").is_dir()]
    places.append(Path(sys.prefix) / "share")
    for place in places:
        folder = place / "skd_msgs" / "msg"
        if (folder / "Episode.msg").is_file():
            return folder
    raise FileNotFoundError(
        "the definitions of skd_msgs are not installed: source the workspace, or install SKD with pip"
    )


@functools.cache
def typestore() -> Typestore:
    """Return the type store with all messages that the graph uses."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in sorted(_definition_folder().glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"skd_msgs/msg/{file.stem}"))
    return store
