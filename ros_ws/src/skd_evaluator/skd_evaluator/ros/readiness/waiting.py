"""What is said while the first commands of an episode are awaited, and nothing before that: a look costs time.

A stack whose commands come where nobody takes them, or in a form that nobody can, will go on like that. Where SKD has
started it, and so nobody can mend it meanwhile, the campaign ends as soon as that is certain.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from skd_sim.ros.command_search import (
    candidates,
    class_of,
    foreign_nodes,
    has_stamp,
    unheard,
    why_no_command,
)
from skd_sim.ros.publishers import living_publishers
from skd_sim.ros.support import EGO_ODOMETRY
from skd_sim.world.stamps import NANOSECONDS, WALL_CLOCK, stamp_fault

from skd_evaluator.errors import AssessmentError

_LISTEN_AFTER = 1.0
"""s of waiting after which this node listens to what else is published: by then something is the matter."""
_SAY_EVERY = 10.0
_SAY_AGAIN = 3
"""How many times as long passes until a line is said again that says nothing new."""
_ANY = QoSProfile(depth=10, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Fits every publisher."""
_STAMP = struct.Struct("<iI")
_BEHIND_ENCAPSULATION = 4  # bytes; the stamp of a header that comes first


class Awaited(NamedTuple):
    """A kind of command that an episode needs.

    Attributes:
        topic: full name of the topic.
        kind: type of its messages, as `geometry_msgs/msg/Twist`.
    """

    topic: str
    kind: str


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


class _Why(NamedTuple):
    """Why a command has not come, and whether it will not come by waiting."""

    text: str
    is_certain: bool = False


class FirstCommands:
    """Says every ten seconds for which command an episode waits, and what is on the graph instead of it."""

    def __init__(
        self,
        node: Node,
        awaited: Sequence[Awaited],
        say: Callable[[str], None],
        patience: float = math.inf,
        *,
        by_stamp: bool = True,
    ) -> None:
        """Know nothing yet.

        Args:
            node: node through which the graph is seen; it has to be spun while `look` is called.
            awaited: the commands that are awaited.
            say: called with each line.
            patience: s after which a fault that waiting does not mend ends the wait.
            by_stamp: whether a command without a stamp (0) is of no use: only lockstep without a quiet time needs one.
        """
        self._patience, self._by_stamp = patience, by_stamp
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
        self._last: list[str] = []
        self._certain_since: float | None = None

    def end(self) -> None:
        """The commands are there, or will not come."""
        for heard in self._heard.values():
            self._node.destroy_subscription(heard.subscription)
        self._heard.clear()

    def look(self, *, state_came: bool) -> None:
        """See whether something is to be said; to be called now and then while the first commands have not come.

        Args:
            state_came: whether the state of tick 0 has come.

        Raises:
            AssessmentError: no command will come, which is so since `patience`.
        """
        now = time.monotonic()
        if now - self._listened > _LISTEN_AFTER:
            self._listened = now
            self._listen()
            if state_came and self._patience < math.inf:
                self._look_for_certainty(now)
        waited = int((now - self._began) / _SAY_EVERY)
        if waited > self._said:
            self._said = waited
            reasons = self._reasons(state_came=state_came)
            texts = [f"{topic}: {why.text}" for topic, why in reasons]
            if texts != self._last or waited % _SAY_AGAIN == 0:
                self._last = texts
                for topic, why in reasons:
                    self._say(f"waiting for {topic} ({waited * _SAY_EVERY:g} s): {why.text}")

    def _look_for_certainty(self, now: float) -> None:
        certain = [why.text for _, why in self._reasons(state_came=True) if why.is_certain]
        if not certain:
            self._certain_since = None
            return
        self._certain_since = self._certain_since or now
        if now - self._certain_since >= self._patience:
            raise AssessmentError(
                f"the car controller is not heard: {certain[0]}; that is so since {self._patience:g} s (a third of "
                "--startup-timeout), and waiting does not mend it"
            )

    def _listen(self) -> None:
        for topic, kind in self._awaited:
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

    def _reasons(self, *, state_came: bool) -> list[tuple[str, _Why]]:
        """Return each topic on which something is missing, and why."""
        if not state_came:
            topic = self._node.resolve_topic_name(EGO_ODOMETRY)
            publishers = living_publishers(self._node, topic)
            why = f"{publishers[0].name} is there and says nothing" if publishers else f"nobody publishes on {topic}"
            return [(topic, _Why(why))]
        return [(one.topic, self._why(one)) for one in self._awaited if not self._answered(one)]

    def _answered(self, one: Awaited) -> bool:
        heard = self._heard.get(one.topic)
        if heard is None or not heard.count:
            return False
        return not heard.stamped or heard.newest == self._start or (not self._by_stamp and not heard.newest)

    def _why(self, one: Awaited) -> _Why:
        why = why_no_command(
            self._node,
            one.topic,
            one.kind,
            arrives=lambda topic: topic in self._heard and self._heard[topic].count > 0,
        )
        heard = self._heard.get(one.topic)
        if not why and heard is not None and heard.count:
            fault = stamp_fault(heard.newest, self._start)
            # One that lags may belong to the episode before: a node that starts anew answers later.
            no_clock = not 0 < heard.newest <= WALL_CLOCK
            return _Why(f"commands come, but their stamps are of no use: {fault}", no_clock)
        certain = self._is_certain(one, why)
        if not why:
            names = ", ".join(publisher.name for publisher in living_publishers(self._node, one.topic))
            why = f"{names} is there and has not published yet"
        deaf = [f"{name} listens to {topic}" for name, topic in unheard(self._node)]
        if deaf:
            return _Why(f"{why}; {' and '.join(deaf)}, where nobody publishes: remap it", certain)
        if not foreign_nodes(self._node):
            return _Why(f"{why}; there is no node on the graph but SKD's own")
        return _Why(why, certain)

    def _is_certain(self, one: Awaited, why: str) -> bool:
        """Return whether commands are sent all the time, though not on this topic or not so that they are taken."""
        if not why:
            return False
        come = [topic for topic, heard in self._heard.items() if heard.count > 0 and topic != one.topic]
        return bool(living_publishers(self._node, one.topic)) or (one is self._awaited[0] and bool(come))
