"""Who publishes on a topic of commands, as the middleware sees it; see `skd_sim.lockstep.command_source.Senders`."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node

from skd_sim.nodes.command_search import kind_name, why_no_command
from skd_sim.nodes.publishers import living_publishers, publisher_names


class TopicSenders:
    """Those who publish on one topic.

    Attributes:
        subscription: subscription to the topic; it has to be set before the first episode.
    """

    def __init__(self, node: Node, topic: str) -> None:
        """Look at a topic on behalf of a node."""
        self.subscription: Any = None
        self._node = node
        self._topic = topic

    def count(self) -> int:
        """Return how many publishers match the subscription, the dead whose lease has not ended among them."""
        return int(self.subscription.get_publisher_count())

    def living(self) -> int:
        """Return how many there are of the living, matching or not."""
        return len(living_publishers(self._node, self._topic))

    def names(self) -> list[str]:
        """Return the names of the living; waits a moment for those that have not come."""
        return publisher_names(self._node, self._topic)

    def absence(self) -> str:
        """Return why nothing comes: what is there does not fit, or is elsewhere, or is not there."""
        name = self._node.resolve_topic_name(self._topic)
        kind = kind_name(self.subscription.msg_type)
        return why_no_command(self._node, name, kind) or f"what is published on {name} does not reach this node"
