"""Who publishes on a topic, and why a command does not come.

Killed publishers, which the middleware lists for a while, are left out. Causes stand in a table, each with what the
graph shows of it and what mends it; the first that fits is the diagnosis. A *certain* one is not mended by waiting.
Causes are looked for only while something is wrong, so that they cost a running episode nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible

from skd_sim.errors import UsageError
from skd_sim.ros.commands import NAMED_FORMATS, message_class, number_paths
from skd_sim.ros.from_messages import from_stamp
from skd_sim.ros.lockstep import LEAD
from skd_sim.ros.support import STREAM, Topic
from skd_sim.world.episode import WALL_CLOCK, stamp_fault

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
    while any(_UNKNOWN in one.name for one in publishers) and time.monotonic() < latest:
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


_STATES = (
    Topic.EGO_ODOMETRY,
    Topic.ADVERSARY_ODOMETRY,
    Topic.EGO_SCAN,
    Topic.EGO_POINTS,
    Topic.EGO_IMU,
    Topic.ADVERSARY_DETECTIONS,
    Topic.TF,
)
"""Topics by which a stack sees the car, or whom it may hit."""
_NAMES = {one.type: name for name, one in NAMED_FORMATS.items()}
_WORDS = ("cmd", "command", "control", "accel", "brake", "throttle", "drive", "speed", "twist", "ackermann")
_POLICIES = {"effort": "reliability", "volatile": "durability", "deadline": "deadline", "live": "liveliness"}
"""Words of the middleware's reasons, and the policy of which they are."""
_MOST = 3  # topics that one line names
_HIDDEN = "_"  # names of nodes that do not count as part of a graph begin so, those of ROS 2's command line too
_OF_EVERY_NODE = ("/rosout", PARAMETER_EVENTS)


@dataclass
class Heard:
    """What has come on a topic since it is listened to: how many, and the newest stamp (ns), if they have any."""

    subscription: Any = None
    count: int = 0
    newest: int | None = None

    def take(self, message: Any) -> None:
        """Take a message."""
        self.count += 1
        if (header := getattr(message, "header", None)) is not None:
            self.newest = max(self.newest or 0, from_stamp(header.stamp))


class Awaited(NamedTuple):
    """A kind of command that an episode needs.

    Attributes:
        topic: full name of the topic.
        kind: type of its messages, as `geometry_msgs/msg/Twist`.
    """

    topic: str
    kind: str


@dataclass(frozen=True)
class Evidence:
    """What the graph shows of a command that does not come.

    Attributes:
        node: node through which the graph is seen.
        awaited: the command.
        stamp: stamp of the state that is to be answered, ns; none: not known.
        by_stamp: whether a command has to carry that stamp, as in lockstep without a quiet time.
        senses: whether the car of the episode has a laser.
        heard: what has come, by topic, where there is a subscription.
    """

    node: Node
    awaited: Awaited
    stamp: int | None = None
    by_stamp: bool = True
    senses: bool = True
    heard: Mapping[str, Heard] = field(default_factory=dict)

    @cached_property
    def publishers(self) -> list[Publisher]:
        """Who publishes on its topic."""
        return living_publishers(self.node, self.awaited.topic)

    @cached_property
    def own(self) -> set[str]:
        """Names of the nodes that play SKD's parts."""
        topics = (Topic.EGO_ODOMETRY, Topic.EPISODE, Topic.VELOCITY_COMMAND)
        roles = {one.name for topic in topics for one in living_publishers(self.node, topic)}
        return roles | {self.node.get_fully_qualified_name()}

    @cached_property
    def listening(self) -> dict[str, dict[str, list[str]]]:
        """Of each node that is not SKD's the topics to which it listens, with their types."""
        found = {}
        for name, space in self.node.get_node_names_and_namespaces():
            full = f"{space.rstrip('/')}/{name}"
            if full not in self.own and not name.startswith(_HIDDEN):
                try:
                    topics = self.node.get_subscriber_names_and_types_by_node(name, space)
                except Exception:  # it has just gone
                    continue
                found[full] = {topic: kinds for topic, kinds in topics if topic not in _OF_EVERY_NODE}
        return found

    @property
    def listened(self) -> dict[str, list[str]]:
        """Topics to which nodes that are not SKD's listen, with their types."""
        return {topic: kinds for topics in self.listening.values() for topic, kinds in topics.items()}

    @cached_property
    def candidates(self) -> list[tuple[str, Publisher]]:
        """Other topics with publishers of what may be commands and no subscriber, the likeliest first."""
        found = []
        for name, kinds in self.node.get_topic_names_and_types():
            if name == self.awaited.topic or name in _OF_EVERY_NODE or not any(_rank(name, kind) for kind in kinds):
                continue
            if {endpoint_name(one) for one in self.node.get_subscriptions_info_by_topic(name)} - self.own:
                continue  # SKD listens to find out what comes
            foreign = [one for one in living_publishers(self.node, name) if one.name not in self.own]
            found += [(name, one) for one in foreign[:1] if _rank(name, one.kind)]
        return sorted(found, key=lambda one: (_rank(one[0], one[1].kind), one[0]))[:_MOST]

    def full(self, topic: str) -> str:
        """Return a topic's full name."""
        return str(self.node.resolve_topic_name(topic))

    def has_come(self, topic: str) -> bool:
        """Whether messages have come on a topic."""
        return topic in self.heard and self.heard[topic].count > 0

    @property
    def newest(self) -> int | None:
        """Newest stamp of the commands that came, ns; none where none came, or they have no stamp."""
        return self.heard[self.awaited.topic].newest if self.has_come(self.awaited.topic) else None

    @property
    def answered(self) -> bool:
        """Whether a command came that counts: also one that the simulator's subscription takes."""
        if not self.has_come(self.awaited.topic) or _qos_of_publisher(self) or _stamp(self):
            return False
        return self.newest is None or not self.by_stamp or self.newest == self.stamp


class Diagnosis(NamedTuple):
    """Why a command does not come: the cause's name, whether it is certain, and in words."""

    cause: str
    certain: bool
    text: str


def diagnose(evidence: Evidence) -> Diagnosis:
    """Return the first cause that fits."""
    found = ((name, certain, find(evidence)) for name, (certain, find) in CAUSES.items())
    return next(Diagnosis(name, certain, text) for name, certain, text in found if text)


def _no_adversary(seen: Evidence) -> str | None:
    topic = seen.awaited.topic
    if topic != seen.full(Topic.VELOCITY_COMMAND):
        return None
    return _silent(seen) if seen.publishers else f"no node publishes on {topic}"


def _type(seen: Evidence) -> str | None:
    if not seen.publishers or any(one.kind == seen.awaited.kind for one in seen.publishers):
        return None
    other, (topic, kind) = seen.publishers[0], seen.awaited
    return f"{other.name} publishes {other.kind} on {topic}, expected is {kind}: {_option(other.kind)}"


def _misfit(offered: QoSProfile, requested: QoSProfile) -> str:
    """Return which policy does not fit, in lower case; empty where a message can come through."""
    fits, why = qos_check_compatible(offered, requested)
    if fits != QoSCompatibility.ERROR:
        return ""
    found = (policy for word, policy in _POLICIES.items() if word in str(why).lower())
    return next(found, "quality of service")


def _qos_of_publisher(seen: Evidence) -> str | None:
    topic, kind = seen.awaited
    fitting = [one for one in seen.publishers if one.kind == kind]
    misfits = [(one.name, _misfit(one.quality, STREAM)) for one in fitting]
    if not misfits or not all(policy for _, policy in misfits):
        return None
    name, policy = misfits[0]
    how = "best effort, and nothing may be lost here: publish it reliable" if policy == "reliability" else "too weak"
    return f"{name} publishes {topic} with a {policy} that is {how} (qos_overrides.{topic}.publisher.{policy})"


def _subscription(seen: Evidence) -> str | None:
    """Of a node that hears one of SKD's states, and takes it for another type or with what is not offered."""
    for topic in map(seen.full, (*_STATES, Topic.CLOCK)):
        ours = [one for one in seen.node.get_publishers_info_by_topic(topic) if endpoint_name(one) in seen.own]
        for theirs in seen.node.get_subscriptions_info_by_topic(topic) if ours else ():
            if (name := endpoint_name(theirs)) not in seen.listening:
                continue
            if theirs.topic_type != ours[0].topic_type:
                return f"{name} listens to {topic} for {theirs.topic_type}, it has {ours[0].topic_type}: take that"
            if policy := _misfit(ours[0].qos_profile, theirs.qos_profile):
                return (
                    f"{name} listens to {topic} with a {policy} that is not offered: "
                    f"qos_overrides.{topic}.subscription.{policy}, or depth 10 alone"
                )
    return None


def _stamp(seen: Evidence) -> str | None:
    newest, awaited = seen.newest, seen.stamp
    if newest is None:
        return None
    if seen.by_stamp:
        wrong = newest == 0 or newest > WALL_CLOCK or awaited not in (None, newest)
    else:
        wrong = awaited is not None and 0 < newest < awaited - LEAD
    return f"commands come, but their stamps {stamp_fault(newest, awaited or 0)}" if wrong else None


def _without_laser(seen: Evidence) -> str | None:
    if seen.senses:
        return None
    scans = {seen.full(Topic.EGO_SCAN), seen.full(Topic.EGO_POINTS)}
    for name, topics in seen.listening.items():
        if found := scans & topics.keys():
            return f"{name} listens to {min(found)}, and the scenario has no section sensor: add one"
    return None


def _not_active(seen: Evidence) -> str | None:
    kind = "lifecycle_msgs/srv/GetState"
    services = [name for name, kinds in seen.node.get_service_names_and_types() if kind in kinds]
    managed = sorted(name.removesuffix("/get_state") for name in services)
    if not managed or seen.has_come(seen.awaited.topic):
        return None
    return f"managed nodes may not be active: -p reset:=lifecycle -p lifecycle_nodes:={','.join(managed)}"


def _elsewhere(seen: Evidence) -> str | None:
    if seen.publishers or not seen.candidates:
        return None
    name, publisher = seen.candidates[0]
    come = "messages of {} arrive on {}" if seen.has_come(name) else "{} publishes on {}"
    option = "" if publisher.kind == seen.awaited.kind else f" {_option(publisher.kind)}"
    more = f" (or on {', '.join(other for other, _ in seen.candidates[1:])})" if len(seen.candidates) > 1 else ""
    return (
        f"no node publishes on {seen.awaited.topic}, but {come.format(publisher.name, name)} ({publisher.kind}){more}, "
        f"and no node listens there: -p command_topic:={name}{option}, or remap it"
    )


def _arrives_elsewhere(seen: Evidence) -> str | None:
    return _elsewhere(seen) if any(seen.has_come(name) for name, _ in seen.candidates) else None


def _hears_nothing(seen: Evidence) -> str | None:
    """Of a stack that cannot see the car, or not the adversary, and listens to topics that no node publishes."""
    hears = {topic for topic in _STATES if seen.full(topic) in seen.listened}
    of_car = hears - {Topic.ADVERSARY_ODOMETRY, Topic.ADVERSARY_DETECTIONS}
    alone = hears <= {Topic.EGO_ODOMETRY, Topic.EGO_IMU, Topic.TF} and any(_remaps(seen).values())
    return _unpublished(seen) if alone or not of_car else None


def _remaps(seen: Evidence) -> dict[str, str]:
    """Return the topics that a stack listens to and no node publishes, each with the odometry to remap it to.

    That is one to which the stack does not listen yet, the car's first; empty: not known.
    """
    lacking = [topic for topic in seen.listened if not seen.node.count_publishers(topic)]
    lacking.sort(key=lambda topic: "odom" not in topic and "ego" not in topic)
    states = (Topic.EGO_ODOMETRY, Topic.ADVERSARY_ODOMETRY)
    free = iter([topic for topic in states if seen.full(topic) not in seen.listened])
    return {topic: next(free, "") if "nav_msgs/msg/Odometry" in seen.listened[topic] else "" for topic in lacking}


def _unpublished(seen: Evidence) -> str | None:
    remaps, lacking = _remaps(seen), []
    for name, topics in seen.listening.items():
        if found := [topic for topic in remaps if topic in topics]:
            lacking.append(f"{name} listens to {' and '.join(found[:_MOST])}")
    if not lacking:
        return None
    how = " ".join(f"-r {theirs.lstrip('/')}:=/{ours}" for theirs, ours in remaps.items() if ours)
    mends = f"remap it ({how})" if how else "publish it, or remap it"
    return f"{'; '.join(lacking[:_MOST])}, where no node publishes: {mends}"


def _follows_clock(seen: Evidence) -> str | None:
    names = [one.name for one in seen.publishers if seen.full(Topic.CLOCK) in seen.listening.get(one.name, ())]
    if not names or not seen.by_stamp:
        return None
    said = f"{names[0]} is there, has not published, and listens to {Topic.CLOCK}, which waits for its command"
    return f"{said}: where it decides by a timer, -p quiet_time:=0.1"


def _silent(seen: Evidence) -> str:
    if seen.publishers:
        names = " and ".join(sorted({one.name for one in seen.publishers}))
        heard = sorted(seen.listened.keys() & set(map(seen.full, _STATES)))
        listens = f"listens to {' and '.join(heard)}" if heard else "is there"
        return f"{names} {listens}, but has published nothing on {seen.awaited.topic}: see its log"
    nobody = f"no node publishes on {seen.awaited.topic}"
    if seen.listening:
        return f"{nobody}; nodes that are not SKD's: {', '.join(sorted(seen.listening)[:_MOST])}"
    return f"{nobody}, and there is no node but SKD's own: start it, in the same ROS_DOMAIN_ID"


CAUSES: Mapping[str, tuple[bool, Callable[[Evidence], str | None]]] = {
    "no adversary": (False, _no_adversary),
    "wrong type": (True, _type),
    "quality of service": (True, _qos_of_publisher),
    "subscription": (True, _subscription),
    "stamp": (True, _stamp),
    "no laser": (True, _without_laser),
    "not active": (False, _not_active),
    "wrong topic": (True, _arrives_elsewhere),
    "hears nothing": (True, _hears_nothing),
    "perhaps wrong topic": (False, _elsewhere),
    "perhaps remapped": (False, _unpublished),
    "follows the clock": (False, _follows_clock),
    "silent": (False, _silent),
}
"""By name, in the order in which they are tried: whether waiting does not mend it, and what finds it.

It returns what is seen and what mends it; none where it is another cause.
"""


def class_of(kind: str) -> type | None:
    """Return the class of a type's messages; none where it cannot be imported here."""
    try:
        return message_class(kind)
    except UsageError:
        return None


def _option(kind: str) -> str:
    """Return the options that would take messages of a type as commands; without stamps they need a quiet time."""
    message: Any = class_of(kind)
    has_stamp = message is None or {"header", "stamp"} & message.get_fields_and_field_types().keys()
    quiet = "" if has_stamp else " -p quiet_time:=0.1"
    if kind in _NAMES:
        return f"-p command_type:={_NAMES[kind]}{quiet}"
    numbers = [] if message is None else [path for path in number_paths(message) if "covariance" not in path]
    likely = [path for path in numbers if any(word in path for word in ("accel", "speed", "velocity"))]
    found = next(iter([*likely, *numbers]), "…")
    return f"-p command_type:={kind} -p command_field:={found}{quiet}"


def _rank(topic: str, kind: str) -> int:
    """Return how likely commands come on a topic: 1 the likeliest, 0 not at all."""
    if kind in _NAMES:
        return 1
    named = any(word in f"{topic} {kind}".lower() for word in _WORDS)
    message = class_of(kind)
    numeric = message is None or next(number_paths(message), None) is not None
    return 2 if named and numeric else 0
