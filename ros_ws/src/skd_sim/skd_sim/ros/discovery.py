"""Which nodes publish on a topic, and why no command can come on it, as far as the graph shows it.

The middleware still lists killed nodes for a while; they are left out. On SKD's own topics one node may publish. Why no
command comes is asked only while something is wrong, and costs a running episode nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import ReliabilityPolicy

from skd_sim.errors import UsageError
from skd_sim.ros.commands import NAMED_FORMATS, message_class, number_paths
from skd_sim.ros.support import EGO_ODOMETRY, EPISODE, VELOCITY_COMMAND

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
        reliable: whether it delivers all of them.
    """

    name: str
    participant: bytes
    kind: str
    reliable: bool

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
    publishers = sorted(map(_publisher, endpoints))
    processes = {int(entry.name) & 0xFFFF for entry in Path("/proc").iterdir() if entry.name.isdecimal()}
    of_nodes = node.get_publishers_info_by_topic(_PARAMETER_EVENTS)
    nodes = [(endpoint_name(one), bytes(one.endpoint_gid)) for one in of_nodes]
    ours = next((gid for name, gid in nodes if name == node.get_fully_qualified_name()), None)
    if ours is None or tuple(ours[:2]) != _FAST_DDS:
        return publishers
    if not {_process(gid) for _, gid in nodes if _process(gid) != _process(ours)} & processes:
        return publishers  # of no other node a process is seen: they may run in containers, with processes of their own
    return [one for one in publishers if one.participant[:4] != ours[:4] or _process(one.participant) in processes]


def publisher_names(node: Node, topic: str, *, least: int = 0) -> list[str]:
    """Return the names of the nodes that publish on a topic, sorted; waits a moment for those that have not come.

    Args:
        node: node through which the graph is seen.
        topic: name of the topic as the node would write it, before remapping.
        least: how many there were a moment ago.
    """
    latest = time.monotonic() + _NAMING
    while True:
        publishers = living_publishers(node, topic)
        if all(one.named for one in publishers) or time.monotonic() > latest:
            names = [one.name for one in publishers]
            return names + ["one that is gone"] * (least - len(names))
        time.sleep(0.01)


def second_publisher(node: Node, topic: str) -> str | None:
    """Return, in words, who publishes on a topic that is one node's alone; none where at most one does. Cheap then."""
    topic = node.resolve_topic_name(topic)
    if node.count_publishers(topic) < 2 or len(living_publishers(node, topic)) < 2:
        return None
    names = publisher_names(node, topic, least=2)
    return f"{len(names)} nodes publish {topic}, one may: {' and '.join(names)}"


def _publisher(endpoint: Any) -> Publisher:
    reliable = endpoint.qos_profile.reliability != ReliabilityPolicy.BEST_EFFORT
    return Publisher(endpoint_name(endpoint), bytes(endpoint.endpoint_gid[:_PREFIX]), endpoint.topic_type, reliable)


def endpoint_name(endpoint: Any) -> str:
    """Return the name, in full, of the node that has a publisher or a subscription."""
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _process(gid: bytes) -> int:
    """Return the last 16 bits of the id of a process, as Fast DDS writes them."""
    return int(gid[4] | gid[5] << 8)


_NAMES = {one.type: name for name, one in NAMED_FORMATS.items()}
_WORDS = ("cmd", "command", "control", "accel", "brake", "throttle", "drive", "speed", "twist", "ackermann")
_MOST = 3  # topics that one line names
_HIDDEN = "_"  # names of nodes that do not count as part of a graph begin so, those of ROS 2's command line too
_PARAMETER_EVENTS = "/parameter_events"
"""Every node publishes on it; not so on /rosout, where another node of its process has its name."""
_OF_EVERY_NODE = ("/rosout", _PARAMETER_EVENTS)


def why_no_command(node: Node, topic: str, kind: str, arrives: Callable[[str], bool] | None = None) -> str:
    """Return why no command can come on a topic, as far as the graph shows it; empty if nothing is wrong.

    Args:
        node: node through which the graph is seen.
        topic: full name of the topic.
        kind: type of what is awaited, as `geometry_msgs/msg/Twist`.
        arrives: says of a topic whether messages come on it, where somebody has listened.
    """
    publishers = living_publishers(node, topic)
    fitting = [one for one in publishers if one.kind == kind]
    if any(one.reliable for one in fitting):
        return ""
    if fitting:
        return (
            f"{_names(fitting)} publishes {topic} with quality of service best effort, and nothing may be lost here: "
            "publish it reliable"
        )
    if publishers:
        other = publishers[0]
        return f"{other.name} publishes {other.kind} on {topic}, awaited is {kind}: {_option(other.kind)}"
    ours = topic == node.resolve_topic_name(VELOCITY_COMMAND)  # which has no options
    return f"nobody publishes on {topic}{'' if ours else _elsewhere(node, topic, kind, arrives)}"


def candidates(node: Node, topic: str) -> list[tuple[str, Publisher]]:
    """Return the other topics on which somebody publishes what may be commands and nobody listens, likeliest first."""
    own = _own_nodes(node)
    found = []
    for name, kinds in node.get_topic_names_and_types():
        if name == topic or name in _OF_EVERY_NODE or not any(_rank(name, kind) for kind in kinds):
            continue
        if {endpoint_name(one) for one in node.get_subscriptions_info_by_topic(name)} - own:
            continue  # SKD listens to find out what comes
        foreign = [one for one in living_publishers(node, name) if one.name not in own and _rank(name, one.kind)]
        if foreign:
            found.append((name, foreign[0]))
    return sorted(found, key=lambda one: (_rank(one[0], one[1].kind), one[0]))[:_MOST]


def unheard(node: Node) -> list[tuple[str, str]]:
    """Return (node, topic) for topics to which nodes that are not SKD's listen, and on which nobody publishes."""
    own = _own_nodes(node)
    found = []
    for name, space in node.get_node_names_and_namespaces():
        full = f"{space.rstrip('/')}/{name}"
        if full in own or name.startswith(_HIDDEN):
            continue
        topics = [topic for topic, _ in node.get_subscriber_names_and_types_by_node(name, space)]
        found += [(full, topic) for topic in topics if topic not in _OF_EVERY_NODE and not node.count_publishers(topic)]
    return found[:_MOST]


def foreign_nodes(node: Node) -> list[str]:
    """Return the names of the nodes on the graph that are not SKD's."""
    there = [one for one in node.get_node_names_and_namespaces() if not one[0].startswith(_HIDDEN)]
    return sorted({f"{space.rstrip('/')}/{name}" for name, space in there} - _own_nodes(node))


def class_of(kind: str) -> type | None:
    """Return the class of a type's messages; none where it cannot be imported here."""
    try:
        return message_class(kind)
    except UsageError:
        return None


def kind_name(kind: type) -> str:
    """Return the name of a class of messages, as `geometry_msgs/msg/Twist`."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def _own_nodes(node: Node) -> set[str]:
    """Return the names of the nodes that play SKD's parts in the graph."""
    topics = (EGO_ODOMETRY, EPISODE, VELOCITY_COMMAND)
    roles = {one.name for topic in topics for one in living_publishers(node, node.resolve_topic_name(topic))}
    return roles | {node.get_fully_qualified_name()}


def _elsewhere(node: Node, topic: str, kind: str, arrives: Callable[[str], bool] | None) -> str:
    found = candidates(node, topic)
    if not found:
        return ""
    name, publisher = found[0]
    come = arrives is not None and arrives(name)
    how = f"messages of {publisher.name} arrive on {name}" if come else f"{publisher.name} publishes on {name}"
    option = "" if publisher.kind == kind else f" {_option(publisher.kind)}"
    more = f" (or on {', '.join(other for other, _ in found[1:])})" if len(found) > 1 else ""
    return (
        f", but {how} ({publisher.kind}){more}, and nobody listens there: -p command_topic:={name}{option}, or remap it"
    )


def _option(kind: str) -> str:
    """Return the options that would take messages of a type as commands."""
    if kind in _NAMES:
        return f"-p command_type:={_NAMES[kind]}"
    message = class_of(kind)
    numbers = [] if message is None else [path for path in number_paths(message) if "covariance" not in path]
    likely = [path for path in numbers if any(word in path for word in ("accel", "speed", "velocity"))]
    field = next(iter([*likely, *numbers]), "…")
    return f"-p command_type:={kind} -p command_field:={field}"


def _rank(topic: str, kind: str) -> int:
    """Return how likely commands come on a topic: 1 the likeliest, 0 not at all."""
    if kind in _NAMES:
        return 1
    named = any(word in f"{topic} {kind}".lower() for word in _WORDS)
    message = class_of(kind)
    numeric = message is None or next(number_paths(message), None) is not None
    return 2 if named and numeric else 0


def _names(publishers: list[Publisher]) -> str:
    return " and ".join(sorted({one.name for one in publishers}))
