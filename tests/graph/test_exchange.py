"""What nodes of one process say to each other by a call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.serialization import serialize_message
from skd_sim.nodes.composition.exchange import Exchange
from skd_sim.nodes.support import LATCHED, STREAM
from std_msgs.msg import String


class Wire:
    """A publisher of the middleware, with so many listeners elsewhere."""

    def __init__(self, topic: str, listeners: int = 0) -> None:
        self.topic_name, self.listeners = topic, listeners
        self.sent: list[Any] = []

    def publish(self, message: Any) -> None:
        self.sent.append(message)

    def get_subscription_count(self) -> int:
        return self.listeners


class Member:
    """A node, as far as the exchange looks at it."""

    def count_publishers(self, topic: str) -> int:
        return len(topic)


def test_messages_come_in_their_order_and_none_within_another() -> None:
    exchange, a, b = Exchange(["/one", "/two"]), Member(), Member()
    one = exchange.publisher(a, Wire("/one"), STREAM)
    two = exchange.publisher(b, Wire("/two"), STREAM)
    said: list[str] = []

    def answer(message: Any) -> None:
        said.append(f"begin {message.data}")
        if message.data < "3":
            two.publish(String(data=message.data * 2))
        said.append(f"end {message.data}")

    exchange.subscription(b, String, "/one", answer, raw=False)
    exchange.subscription(a, String, "/two", lambda message: said.append(message.data), raw=False)
    for number in "123":
        one.publish(String(data=number))
    assert said == []  # until the executor has its turn
    assert exchange.deliver()
    assert said == ["begin 1", "end 1", "begin 2", "end 2", "begin 3", "end 3", "11", "22"]
    assert not exchange.deliver()


def test_what_takes_long_waits_until_all_is_heard() -> None:
    exchange, node = Exchange(["/one"]), Member()
    publisher = exchange.publisher(Member(), Wire("/one"), STREAM)
    said: list[str] = []

    def hear(data: bytes) -> None:
        said.append(data.decode())
        if data == b"state":
            exchange.later(lambda: said.append("plan"))

    exchange.subscription(node, String, "/one", hear, raw=True)
    for data in (b"state", b"over"):
        publisher.publish(data)
    exchange.later(lambda: publisher.publish(b"answer"))
    exchange.deliver()
    assert said == ["state", "over", "answer", "plan"]


def test_each_hears_bytes_or_an_object_as_it_wants() -> None:
    exchange, node = Exchange(["/one"]), Member()
    publisher = exchange.publisher(Member(), Wire("/one"), STREAM)
    heard: list[Any] = []
    for raw in (True, False):
        exchange.subscription(node, String, "/one", heard.append, raw=raw)
    message = String(data="both")
    data = bytes(serialize_message(message))
    for said in (message, data):
        publisher.publish(said)
    exchange.deliver()
    assert heard == [data, message, data, message]
    assert all(isinstance(one, kind) for one, kind in zip(heard, (bytes, String) * 2, strict=True))


def test_the_wire_carries_what_somebody_may_hear() -> None:
    exchange = Exchange(["/latched", "/deaf", "/heard"])
    deaf, heard, latched = Wire("/deaf"), Wire("/heard", 1), Wire("/latched")
    for wire, qos in ((deaf, STREAM), (heard, STREAM), (latched, LATCHED)):
        publisher = exchange.publisher(Member(), wire, qos)
        publisher.publish(b"it")
        assert publisher.get_subscription_count() == wire.listeners
        exchange.subscription(Member(), String, wire.topic_name, lambda _data: None, raw=True)
        assert publisher.get_subscription_count() == wire.listeners + 1
    assert (deaf.sent, heard.sent, latched.sent) == ([], [b"it"], [b"it"])  # who comes late gets what is latched


def test_who_listens_to_its_own_topic_hears_others() -> None:
    exchange, node, other = Exchange(["/one"]), Member(), Member()
    exchange.publisher(node, Wire("/one"), LATCHED)
    assert exchange.subscription(node, String, "/one", lambda _message: None, raw=False) is None
    called = exchange.subscription(other, String, "/one", lambda _message: None, raw=False)
    assert called is not None
    assert called.get_publisher_count() == len("/one")  # of all that the middleware knows
    foreign = Wire("/of_others")
    assert exchange.publisher(node, foreign, STREAM) is foreign


def test_one_subscription_for_all_who_hear_a_topic_of_others() -> None:
    exchange = Exchange([])
    made: list[Callable[[bytes], None]] = []
    heard: list[tuple[str, bytes]] = []

    def subscribe(heard_by_all: Callable[[bytes], None]) -> Any:
        made.append(heard_by_all)
        return object()

    def join(name: str, qos: Any) -> Any:
        return exchange.join(String, "/command", qos, lambda data: heard.append((name, data)), subscribe)

    first, second, third = join("simulator", STREAM), join("evaluator", STREAM), join("watcher", LATCHED)
    assert first is second
    assert third is not first
    assert len(made) == 2
    made[0](b"go")
    assert heard == [("simulator", b"go"), ("evaluator", b"go")]
