"""/parameter_events: what changed, for whoever follows a node's parameters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rosless.interfaces.classes import message_class
from rosless.qos import qos_profile_parameter_events

if TYPE_CHECKING:
    from rosless.node import Node

TOPIC = "/parameter_events"


class ParameterEvents:
    """Publishes the changes of one node's parameters."""

    def __init__(self, node: Node) -> None:
        self._message = message_class("rcl_interfaces/msg/ParameterEvent")
        self._publisher = node.create_publisher(self._message, TOPIC, qos_profile_parameter_events)
        self._name = node.get_fully_qualified_name()
        self._clock = node.get_clock()

    def collect(self) -> Any:
        """An event without changes."""
        return self._message(node=self._name)

    def publish(self, event: Any) -> None:
        """Send an event."""
        event.stamp = self._clock.now().to_msg()
        self._publisher.publish(event)
