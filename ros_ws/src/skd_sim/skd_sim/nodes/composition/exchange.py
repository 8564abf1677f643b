"""What nodes of one process say to each other: by a call, and on the topic for everybody else.

A message that is published comes to the nodes of this process by a queue, which their executor works off between
callbacks: so no callback is called from within another one, and all of them come in the order in which they were said.
The bytes are those that stand on the topic. Who listens to a topic on which it speaks itself wants to know of others,
and hears the topic.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message


class CalledSubscription:
    """What a node of this process has in place of a subscription to a topic of the exchange.

    Attributes:
        topic_name: full name of the topic.
        msg_type: class of the messages.
        raw: whether the callback takes bytes.
        callback: called with each message.
    """

    def __init__(self, node: Node, kind: type, topic: str, callback: Callable[[Any], None], *, raw: bool) -> None:
        """Listen on behalf of a node."""
        self.topic_name, self.msg_type = topic, kind
        self.callback, self.raw = callback, raw
        self._node = node

    def get_publisher_count(self) -> int:
        """Return how many publishers the topic has, of this process and of others."""
        return int(self._node.count_publishers(self.topic_name))

    def heard(self, message: Any) -> Any:
        """Return a message as the callback takes it: as bytes, or as an object."""
        if self.raw:
            return message if isinstance(message, bytes) else serialize_message(message)
        return deserialize_message(message, self.msg_type) if isinstance(message, bytes) else message


class CallingPublisher:
    """A publisher of a topic of the exchange."""

    def __init__(self, real: Any, listeners: list[CalledSubscription], queue: deque[_Call], *, latched: bool) -> None:
        """Speak to the listeners, of whom there may be more later, and by the real publisher."""
        self._real, self._listeners, self._queue = real, listeners, queue
        self._latched = latched

    def publish(self, message: Any) -> None:
        """Say a message, an object or its bytes."""
        if self._latched or self._real.get_subscription_count():  # nobody else could get it later
            self._real.publish(message)
        for listener in self._listeners:
            self._queue.append(_Call(listener, message))

    def get_subscription_count(self) -> int:
        """Return how many listen, in this process and elsewhere."""
        return int(self._real.get_subscription_count()) + len(self._listeners)


class _Call(NamedTuple):
    listener: CalledSubscription
    message: Any


class _Joined(NamedTuple):
    """The one subscription of this process to a topic of others, and all who hear it."""

    real: Any
    kind: type
    qos: Any
    callbacks: list[Callable[[Any], None]]


class Exchange:
    """Messages between the nodes of one process, which one executor runs."""

    def __init__(self, topics: Collection[str]) -> None:
        """Know of nobody yet.

        Args:
            topics: full names of the topics on which only nodes of this process speak to each other.
        """
        self._listeners: dict[str, list[CalledSubscription]] = {topic: [] for topic in topics}
        self._speakers: dict[str, set[Node]] = {topic: set() for topic in topics}
        self._joined: dict[str, _Joined] = {}
        self._queue: deque[_Call] = deque()
        self._later: deque[Callable[[], None]] = deque()

    def publisher(self, node: Node, real: Any, qos: Any) -> Any:
        """Return what a node publishes with, in place of a publisher of its own if the topic is one of the exchange."""
        topic = real.topic_name
        if topic not in self._listeners:
            return real
        self._speakers[topic].add(node)
        latched = getattr(qos, "durability", None) == DurabilityPolicy.TRANSIENT_LOCAL
        return CallingPublisher(real, self._listeners[topic], self._queue, latched=latched)

    def subscription(
        self, node: Node, kind: type, topic: str, callback: Callable[[Any], None], *, raw: bool
    ) -> CalledSubscription | None:
        """Return what a node has in place of a subscription; none if it needs one.

        Args:
            node: node that listens.
            kind: class of the messages.
            topic: full name of the topic.
            callback: called with each message.
            raw: whether it takes bytes.
        """
        if topic not in self._listeners or node in self._speakers[topic]:
            return None
        made = CalledSubscription(node, kind, topic, callback, raw=raw)
        self._listeners[topic].append(made)
        return made

    def join(
        self,
        kind: type,
        topic: str,
        qos: Any,
        callback: Callable[[Any], None],
        subscribe: Callable[[Callable[[Any], None]], Any],
    ) -> Any:
        """Return the subscription by which bytes of a topic of others come to this process, and hear it.

        Args:
            kind: class of the messages.
            topic: full name of the topic.
            qos: its quality of service.
            callback: called with the bytes of each message, after those who have joined before.
            subscribe: makes the subscription of the first who joins, which has to stay.
        """
        there = self._joined.get(topic)
        if there is not None and there.kind is kind and there.qos is qos:
            there.callbacks.append(callback)
            return there.real
        callbacks = [callback]

        def on_bytes(data: bytes) -> None:
            for one in callbacks:
                one(data)

        real = subscribe(on_bytes)
        if there is None:
            self._joined[topic] = _Joined(real, kind, qos, callbacks)
        return real

    def leave(self, subscription: CalledSubscription) -> None:
        """Say nothing more to a listener."""
        self._listeners[subscription.topic_name].remove(subscription)

    def later(self, work: Callable[[], None]) -> None:
        """Have work done that takes long, when all that was said has been heard."""
        self._later.append(work)

    def deliver(self) -> bool:
        """Hand over all that was said, and do what was put off, until nothing is left; return whether there was any."""
        queue, later = self._queue, self._later
        if not (queue or later):
            return False
        while queue or later:
            if queue:
                listener, message = queue.popleft()
                listener.callback(listener.heard(message))
            else:
                later.popleft()()
        return True
