"""Which nodes publish on a topic: killed ones, which the middleware lists for a while, are left out."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSProfile

_FAST_DDS = (1, 15)  # vendor id of eProsima, with which its GUIDs begin
_PREFIX = 12  # bytes of a GUID that are its participant's (RTPS 2.3, section 8.2.4)
_UNKNOWN = "_UNKNOWN_"  # in what rmw calls a node whose endpoints were found before its name
_NAMING = 0.5  # s that a name is waited for


class Publisher(NamedTuple):
    """One publisher of a topic.

    Attributes:
        name: full name of its node; a node that publishes twice is listed twice.
        participant: identifier by which its process takes part in the graph; it is known from the first moment, while a
            name is not.
        kind: type of its messages, as `geometry_msgs/msg/Twist`.
        quality: its quality of service.
    """

    name: str
    participant: bytes
    kind: str
    quality: QoSProfile

    @property
    def named(self) -> bool:
        """Whether its node's name has come already."""
        return _UNKNOWN not in self.name


def living_publishers(node: Node, topic: str) -> list[Publisher]:
    """Return the publishers of a topic, sorted by name.

    A process that was killed says no farewell, and its publishers are listed until their lease ends (20 s). Fast DDS
    writes host (2 bytes) and process (2 bytes) into a GUID, by which the dead of this machine are told apart; of other
    middlewares and machines all that are listed count as living.

    Args:
        node: node through which the graph is seen.
        topic: name of the topic as the node would write it, before remapping.
    """
    endpoints = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    publishers = sorted(map(_publisher, endpoints), key=lambda one: one[:3])
    processes = {int(entry.name) & 0xFFFF for entry in Path("/proc").iterdir() if entry.name.isdecimal()}
    of_nodes = node.get_publishers_info_by_topic(PARAMETER_EVENTS)
    nodes = [(endpoint_name(one), bytes(one.endpoint_gid)) for one in of_nodes]
    ours = next((gid for name, gid in nodes if name == node.get_fully_qualified_name()), None)
    if ours is None or tuple(ours[:2]) != _FAST_DDS:
        return publishers
    _seen.update(gid[:4] for _, gid in nodes if _process(gid) != _process(ours) and _process(gid) in processes)
    if ours[:4] not in _seen:
        return publishers  # of no other node a process was ever seen: they may run in containers, with their own
    return [one for one in publishers if one.participant[:4] != ours[:4] or _process(one.participant) in processes]


_seen: set[bytes] = set()
"""Beginnings of GUIDs, which name the host, of which the process of another node has been seen."""


def second_publisher(node: Node, topic: str) -> str | None:
    """Return, in words, which nodes publish on a topic that is one's alone; none where at most one does. Cheap then."""
    topic = node.resolve_topic_name(topic)
    if node.count_publishers(topic) < 2 or len(publishers := living_publishers(node, topic)) < 2:
        return None
    latest = time.monotonic() + _NAMING
    while not all(one.named for one in publishers) and time.monotonic() < latest:
        time.sleep(0.01)
        publishers = living_publishers(node, topic)
    names = [*(one.name for one in publishers), "one that is gone", "another that is gone"][: max(2, len(publishers))]
    return f"{len(names)} nodes publish {topic}, one may: {' and '.join(names)}"


def _publisher(endpoint: Any) -> Publisher:
    participant = bytes(endpoint.endpoint_gid[:_PREFIX])
    return Publisher(endpoint_name(endpoint), participant, endpoint.topic_type, endpoint.qos_profile)


def endpoint_name(endpoint: Any) -> str:
    """Return the name, in full, of the node that has a publisher or a subscription."""
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _process(gid: bytes) -> int:
    """Return the last 16 bits of the id of a process, as Fast DDS writes them."""
    return int(gid[4] | gid[5] << 8)


PARAMETER_EVENTS = "/parameter_events"
"""Every node publishes on it; not so on /rosout, where another node of its process has its name."""


def kind_name(kind: type) -> str:
    """Return the name of a class of messages, as `geometry_msgs/msg/Twist`."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
