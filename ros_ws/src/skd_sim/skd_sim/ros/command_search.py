"""What the graph shows if a command is awaited and none comes: which nodes use its topic, and where else commands are.

Asked only while something is wrong; nothing here costs a running episode anything.
"""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node

from skd_sim.errors import UsageError
from skd_sim.ros.command_messages import message_class, number_paths
from skd_sim.ros.commands import NAMED_FORMATS
from skd_sim.ros.publishers import Publisher, endpoint_name, living_publishers
from skd_sim.ros.support import EGO_ODOMETRY, EPISODE, VELOCITY_COMMAND

_NAMES = {one.type: name for name, one in NAMED_FORMATS.items()}
_WORDS = ("cmd", "command", "control", "accel", "brake", "throttle", "drive", "speed", "twist", "ackermann")
_MOST = 3  # topics that one line names
_HIDDEN = "_"  # names of nodes that do not count as part of a graph begin so, those of ROS 2's command line too
_OF_EVERY_NODE = ("/rosout", "/parameter_events")


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


def has_stamp(kind: type) -> bool:
    """Return whether messages of a class begin with a header, whose stamp comes first."""
    fields: dict[str, str] = kind.get_fields_and_field_types()  # type: ignore[attr-defined]
    return next(iter(fields.values()), "") == "std_msgs/Header"


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
        f", but {how} ({publisher.kind}){more}, and nobody listens there: --command-topic {name}{option}, or remap it"
    )


def _option(kind: str) -> str:
    """Return the options that would take messages of a type as commands."""
    if kind in _NAMES:
        return f"--command-type {_NAMES[kind]}"
    message = class_of(kind)
    numbers = [] if message is None else [path for path in number_paths(message) if "covariance" not in path]
    likely = [path for path in numbers if any(word in path for word in ("accel", "speed", "velocity"))]
    field = next(iter([*likely, *numbers]), "…")
    return f"--command-type {kind} --command-field {field}"


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
