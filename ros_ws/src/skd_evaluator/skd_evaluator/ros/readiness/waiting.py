"""What is said while the first commands of an episode are awaited, and nothing before that: a look costs time."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from skd_sim.episode.stamps import NANOSECONDS, stamp_fault
from skd_sim.nodes.command_search import (
    candidates,
    class_of,
    foreign_nodes,
    has_stamp,
    unheard,
    why_no_command,
)
from skd_sim.nodes.publishers import living_publishers
from skd_sim.nodes.support import EGO_ODOMETRY

_LISTEN_AFTER = 1.0
"""s of waiting after which this node listens to what else is published: by then something is the matter."""
_SAY_EVERY = 10.0
_ANY = QoSProfile(depth=10, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Fits every publisher."""
_STAMP = struct.Struct("<iI")
_BEHIND_ENCAPSULATION = 4  # bytes; the stamp of a header that comes first


class Awaited(NamedTuple):
    """A kind of command that an episode needs.

    Attributes:
        topic: full name of the topic.
        kind: type of its messages, as `geometry_msgs/msg/Twist`.
        best_effort: whether a publisher that is not reliable is heard.
    """

    topic: str
    kind: str
    best_effort: bool = False


@dataclass
class _Heard:
    """What has come on a topic since somebody listens: how many, and the newest stamp (ns), if they have any."""

    subscription: Any
    stamped: bool
    count: int = 0
    newest: int = 0

    def take(self, data: bytes) -> None:
        self.count += 1
        if self.stamped and len(data) >= _BEHIND_ENCAPSULATION + _STAMP.size:
            seconds, nanoseconds = _STAMP.unpack_from(data, _BEHIND_ENCAPSULATION)
            self.newest = max(self.newest, seconds * NANOSECONDS + nanoseconds)


class FirstCommands:
    """Says every ten seconds for which command an episode waits, and what is on the graph instead of it."""

    def __init__(self, node: Node, awaited: Sequence[Awaited], say: Callable[[str], None]) -> None:
        """Know nothing yet.

        Args:
            node: node through which the graph is seen; it has to be spun while `look` is called.
            awaited: the commands that are awaited.
            say: called with each line.
        """
        self._node = node
        self._awaited = awaited
        self._say = say
        self._heard: dict[str, _Heard] = {}
        self.begin(0)

    def begin(self, start: int) -> None:
        """An episode was handed out: the state of its tick 0 is stamped `start` (ns)."""
        self.end()
        self._start = start
        self._began = self._listened = time.monotonic()
        self._said = 0

    def end(self) -> None:
        """The commands are there, or will not come."""
        for heard in self._heard.values():
            self._node.destroy_subscription(heard.subscription)
        self._heard.clear()

    def look(self, *, state_came: bool) -> None:
        """See whether something is to be said; to be called now and then while the first commands have not come.

        Args:
            state_came: whether the state of tick 0 has come.
        """
        now = time.monotonic()
        if now - self._listened > _LISTEN_AFTER:
            self._listened = now
            self._listen()
        waited = int((now - self._began) / _SAY_EVERY)
        if waited > self._said:
            self._said = waited
            for line in self._lines(f"({waited * _SAY_EVERY:g} s)", state_came=state_came):
                self._say(line)

    def _listen(self) -> None:
        for topic, kind, _ in self._awaited:
            if any(one.kind == kind for one in living_publishers(self._node, topic)):
                self._hear(topic, kind)
        for topic, publisher in candidates(self._node, self._awaited[0].topic):
            self._hear(topic, publisher.kind)

    def _hear(self, topic: str, kind: str) -> None:
        message = class_of(kind)
        if topic not in self._heard and message is not None:
            heard = _Heard(None, has_stamp(message))
            heard.subscription = self._node.create_subscription(message, topic, heard.take, _ANY, raw=True)
            self._heard[topic] = heard

    def _lines(self, seconds: str, *, state_came: bool) -> list[str]:
        if not state_came:
            topic = self._node.resolve_topic_name(EGO_ODOMETRY)
            publishers = living_publishers(self._node, topic)
            why = f"{publishers[0].name} is there and says nothing" if publishers else f"nobody publishes on {topic}"
            return [f"waiting for {topic} {seconds}: {why}"]
        return [
            f"waiting for {one.topic} {seconds}: {self._why(one)}" for one in self._awaited if not self._answered(one)
        ]

    def _answered(self, one: Awaited) -> bool:
        heard = self._heard.get(one.topic)
        return heard is not None and heard.count > 0 and (not heard.stamped or heard.newest == self._start)

    def _why(self, one: Awaited) -> str:
        why = why_no_command(
            self._node,
            one.topic,
            one.kind,
            best_effort=one.best_effort,
            arrives=lambda topic: topic in self._heard and self._heard[topic].count > 0,
        )
        heard = self._heard.get(one.topic)
        if not why and heard is not None and heard.count:
            return f"commands come, but their stamps are of no use: {stamp_fault(heard.newest, self._start)}"
        if not why:
            names = ", ".join(publisher.name for publisher in living_publishers(self._node, one.topic))
            why = f"{names} is there and has not published yet"
        deaf = [f"{name} listens to {topic}" for name, topic in unheard(self._node)]
        if deaf:
            return f"{why}; {' and '.join(deaf)}, where nobody publishes: remap it"
        if not foreign_nodes(self._node):
            return f"{why}; there is no node on the graph but SKD's own"
        return why
