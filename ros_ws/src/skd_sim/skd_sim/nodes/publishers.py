"""Who publishes on a topic, without those that were killed and that the middleware has not given up yet."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from rclpy.node import Node

_FAST_DDS = (1, 15)  # vendor id of eProsima, with which its GUIDs begin


_UNKNOWN = "_UNKNOWN_"  # in what rmw calls a node whose endpoints were found before its name
_NAMING = 0.5  # s that a name is waited for


def living_publishers(node: Node, topic: str) -> list[str]:
    """Return the full names of the nodes that publish on a topic, sorted; one that publishes twice is there twice.

    A process that was killed says no farewell, and its publishers are listed until their lease ends (20 s). Fast DDS
    writes host (2 bytes) and process (2 bytes) into a GUID, by which the dead of this machine are told apart; of other
    middlewares and machines all that are listed count as living.

    Args:
        node: that asks.
        topic: as the node would write it, before remapping.
    """
    latest = time.monotonic() + _NAMING
    while True:
        names = _living(node, topic)
        if not any(_UNKNOWN in name for name in names) or time.monotonic() > latest:
            return names
        time.sleep(0.01)


def _living(node: Node, topic: str) -> list[str]:
    endpoints = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    if len(endpoints) < 2:
        return [_name(endpoint) for endpoint in endpoints]
    processes = {int(entry.name) & 0xFFFF for entry in Path("/proc").iterdir() if entry.name.isdecimal()}
    nodes = node.get_publishers_info_by_topic("/rosout")
    ours = next((one for one in nodes if _name(one) == node.get_fully_qualified_name()), None)
    here = None if ours is None or _host(ours)[:2] != _FAST_DDS else _host(ours)
    others = {_process(one) for one in nodes if ours is not None and _process(one) != _process(ours)}
    if not others & processes:
        here = None  # of no other node a process is seen: they may run in containers, with processes of their own
    return sorted(_name(one) for one in endpoints if _host(one) != here or _process(one) in processes)


def _name(endpoint: Any) -> str:
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _host(endpoint: Any) -> tuple[int, ...]:
    """Return vendor and host of an endpoint."""
    return tuple(endpoint.endpoint_gid[:4])


def _process(endpoint: Any) -> int:
    """Return the last 16 bits of the id of an endpoint's process, as Fast DDS writes them."""
    low, high = endpoint.endpoint_gid[4:6]
    return int(low | high << 8)
