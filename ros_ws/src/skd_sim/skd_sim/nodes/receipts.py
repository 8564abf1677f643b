"""What a node says of each episode that it begins: what it took it for, and with which code it runs it."""

from __future__ import annotations

from typing import Any

from rclpy.node import Node
from skd_msgs.msg import EpisodeReceipt

from skd_sim.episode.digest import episode_digest
from skd_sim.episode.episode import Episode
from skd_sim.messages.from_messages import from_stamp
from skd_sim.messages.seal import Seal
from skd_sim.nodes.support import EPISODE_RECEIPT, LATCHED
from skd_sim.program.sources import software


class Receipts:
    """Tells the evaluator which episode a node has begun."""

    def __init__(self, node: Node, seal: Seal, *packages: str) -> None:
        """Make the topic.

        Args:
            node: that begins episodes.
            seal: with which it says what it took them for.
            packages: with which it runs them.
        """
        self._name = node.get_fully_qualified_name()
        self._software, self._seal = software(packages), seal
        self._publisher = node.create_publisher(EpisodeReceipt, EPISODE_RECEIPT, LATCHED)

    def send(self, episode: Episode, announced: Any) -> None:
        """Say that an episode begins.

        Args:
            episode: as the node understood it.
            announced: the message that announced it.
        """
        receipt = EpisodeReceipt(node=self._name, campaign=announced.campaign, episode_id=announced.episode_id)
        receipt.start = announced.header.stamp
        digest = episode_digest(episode, announced.campaign, from_stamp(announced.header.stamp))
        receipt.specification = self._seal.proof(digest)
        receipt.software = self._software
        self._publisher.publish(receipt)
