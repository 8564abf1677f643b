"""Names in files and recordings from the time when the adversary was still called pedestrian.

Today *pedestrian* is a kind of road user and nothing else. Whatever reads files asks here, so that no other module
knows the old names; nothing is written under them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skd_sim.errors import UsageError

SECTIONS = {"pedestrian": "adversary"}
"""Section of a scenario, then → today."""
TOPICS = {
    "/pedestrian/odometry": "/adversary/odometry",
    "/pedestrian/detections": "/adversary/detections",
    "/pedestrian/velocity_command": "/adversary/velocity_command",
}
"""Topic without a namespace, then → today."""


def scenario_of_today(data: Any, where: str) -> Any:
    """Return a scenario's content with its sections under today's names; anything but a mapping is returned as it is.

    Args:
        data: content of a scenario, of whatever time; it is not changed.
        where: file or other origin, for messages.

    Raises:
        UsageError: it has a section under both names.
    """
    return _renamed(data, SECTIONS, where, "section ") if isinstance(data, Mapping) else data


def options_of_today(data: Mapping[Any, Any], where: str) -> Mapping[Any, Any]:
    """Return options with keys such as scenario.SECTION.KEY, of a campaign's file, under today's names.

    Raises:
        UsageError: a key is there under both names.
    """
    prefix = "scenario."
    renamed = {
        key: f"{prefix}{SECTIONS[section]}{dot}{rest}"
        for key in data
        if isinstance(key, str) and key.startswith(prefix)
        for section, dot, rest in [key.removeprefix(prefix).partition(".")]
        if section in SECTIONS
    }
    return _renamed(data, renamed, where, "key ")


def _renamed(data: Mapping[Any, Any], names: Mapping[str, str], where: str, what: str) -> Mapping[Any, Any]:
    for then, today in names.items():
        if then in data and today in data:
            raise UsageError(f"{where}: has {what}{today} and {what}{then}, its former name; leave {then} out")
    return {names.get(key, key) if isinstance(key, str) else key: value for key, value in data.items()}
