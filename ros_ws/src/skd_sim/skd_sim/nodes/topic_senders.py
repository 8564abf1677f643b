"""Who publishes on a topic of commands, as the middleware sees it; see `skd_sim.lockstep.Senders`."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node

from skd_sim.nodes.publishers import living_publishers, publisher_names


class TopicSenders:
    """Those who publish on one topic.

    Attributes:
        subscription: to it; to be set before the first episode.
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
        if self._node.count_publishers(name):
            return f"type or quality of service of what comes on {name} do not fit (it has to be reliable)"
        return f"nobody publishes on {name}{self._elsewhere(name)}"

    def _elsewhere(self, name: str) -> str:
        """Return on which other topics somebody publishes what would be commands."""
        kind = f"{self.subscription.msg_type.__module__.split('.')[0]}/msg/{self.subscription.msg_type.__name__}"
        others = [
            topic
            for topic, kinds in self._node.get_topic_names_and_types()
            if kind in kinds and topic != name and self._node.count_publishers(topic)
        ]
        others = [topic for topic in others if not topic.endswith("/velocity_command")]
        return f", but somebody does so on {', '.join(others)}" if others else ""
