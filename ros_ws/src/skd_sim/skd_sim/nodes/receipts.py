"""What a node says of each episode that it begins: what it took it for, and with which code it runs it."""

from __future__ import annotations

from rclpy.node import Node
from skd_msgs.msg import EpisodeReceipt

from skd_sim.episode.digest import episode_digest
from skd_sim.episode.episode import Episode
from skd_sim.messages.to_messages import to_stamp
from skd_sim.nodes.support import EPISODE_RECEIPT, LATCHED
from skd_sim.program.sources import software


class Receipts:
    """Tells the evaluator which episode a node has begun."""

    def __init__(self, node: Node, *packages: str) -> None:
        """Make the topic.

        Args:
            node: that begins episodes.
            packages: with which it runs them.
        """
        self._name = node.get_fully_qualified_name()
        self._software = software(packages)
        self._publisher = node.create_publisher(EpisodeReceipt, EPISODE_RECEIPT, LATCHED)

    def send(self, episode: Episode, campaign: str, start: int) -> None:
        """Say that an episode begins.

        Args:
            episode: as the node understood it.
            campaign: that its message named.
            start: stamp of its tick 0, ns.
        """
        receipt = EpisodeReceipt(node=self._name, campaign=campaign, episode_id=episode.episode_id)
        receipt.start = to_stamp(start)
        receipt.specification = episode_digest(episode, campaign, start)
        receipt.software = self._software
        self._publisher.publish(receipt)
