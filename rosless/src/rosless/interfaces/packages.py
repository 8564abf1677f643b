"""Which interface packages exist, found without parsing any of them.

This module is imported at the first failing top-level import of a program (that is when the finder is
asked), even while the interpreter starts, so it reads directory names at most and imports nothing that is
not there already.
"""

# pathlib would be imported at every interpreter start
# ruff: noqa: PTH100, PTH112, PTH113, PTH118, PTH119, PTH120, PTH208

import os
import sys

MSG_PATH_VARIABLE = "ROSLESS_MSG_PATH"

# The packages of rosbags' Jazzy typestore, listed so that a failing import need not load it; a test compares.
STANDARD_PACKAGES = frozenset(
    """
    action_msgs actionlib_msgs builtin_interfaces diagnostic_msgs geometry_msgs lifecycle_msgs nav_msgs
    rcl_interfaces rmw_dds_common rosbag2_interfaces rosgraph_msgs sensor_msgs service_msgs shape_msgs
    statistics_msgs std_msgs stereo_msgs tf2_msgs trajectory_msgs type_description_interfaces
    unique_identifier_msgs visualization_msgs std_srvs
    """.split()  # noqa: SIM905
)


def search_path() -> list[str]:
    """Directories that may hold package folders with .msg files, first match wins."""
    directories = [entry for entry in os.environ.get(MSG_PATH_VARIABLE, "").split(os.pathsep) if entry]
    # <checkout>/rosless/src/rosless/interfaces/packages.py, where rosless runs from a checkout of the project
    project = os.path.abspath(__file__)
    for _ in range(4):
        project = os.path.dirname(project)
    if os.path.basename(project) == "rosless":
        directories.append(os.path.join(os.path.dirname(project), "ros_ws", "src"))
    directories.append(os.path.join(sys.prefix, "share"))
    return directories


def find(package: str) -> str | None:
    """The folder of a package that is not a standard one, or None."""
    for directory in search_path():
        folder = os.path.join(directory, package)
        if os.path.isfile(os.path.join(folder, "package.xml")) and any(
            os.path.isdir(os.path.join(folder, kind)) for kind in ("msg", "srv")
        ):
            return folder
    return None


def exists(package: str) -> bool:
    """True if messages of this package can be served."""
    return package in STANDARD_PACKAGES or find(package) is not None


def interface_files(folder: str, kind: str) -> list[str]:
    """The definition files of one kind ("msg" or "srv") in a package folder, sorted by name."""
    directory = os.path.join(folder, kind)
    if not os.path.isdir(directory):
        return []
    return sorted(os.path.join(directory, name) for name in os.listdir(directory) if name.endswith(f".{kind}"))
