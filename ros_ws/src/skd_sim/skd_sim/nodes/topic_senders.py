"""Who publishes on a topic of commands, as the middleware sees it; see `skd_sim.lockstep.command_source.Senders`."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node

from skd_sim.nodes.command_search import kind_name, why_no_command
from skd_sim.nodes.publishers import living_publishers, publisher_names


class TopicSenders:
    """The nodes that publish on one topic.

    Attributes:
        subscription: subscription to the topic; it has to be set before the first episode.
    """

    def __init__(self, node: Node, topic: str) -> None:
        """Look at a topic on behalf of a node."""
        self.subscription: Any = None
        self._node = node
        self._topic = topic

    def count(self) -> int:
        """Return how many publishers match the subscription, including dead ones whose lease has not ended."""
        return int(self.subscription.get_publisher_count())

    def living(self) -> int:
        """Return how many living publishers there are, matching or not."""
        return len(living_publishers(self._node, self._topic))

    def names(self) -> list[str]:
        """Return the names of the nodes of living publishers; waits a moment for names that have not come."""
        return publisher_names(self._node, self._topic)

    def absence(self) -> str:
        """Return why nothing comes: the publisher does not fit, publishes elsewhere, or is missing."""
        name = self._node.resolve_topic_name(self._topic)
        kind = kind_name(self.subscription.msg_type)
        return why_no_command(self._node, name, kind) or f"what is published on {name} does not reach this node"
