"""Whether everybody runs the episode that was handed out: the nodes say what they took it for, and it is compared.

A node runs what it was told last. Who told it, and whether the evaluator hears that too, need not be known for this:
another specification has another digest.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from skd_msgs.msg import EpisodeReceipt
from skd_sim.episode.aborts import AbortKind, abort_reason
from skd_sim.episode.digest import episode_digest
from skd_sim.episode.episode import Episode
from skd_sim.messages.seal import Seal
from skd_sim.nodes.publishers import living_publishers
from skd_sim.nodes.support import EPISODE_RECEIPT
from skd_sim.program.sources import sources_digest

_KIND = "skd_msgs/msg/EpisodeReceipt"
_REMEMBERED = 16  # episodes of before, of which a receipt may come late
_EVERY_RECEIPT = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class ReceivedReceipts:
    """The receipts of one episode after another.

    Attributes:
        subscription: to them.
    """

    def __init__(self, node: Node, required: Sequence[str], refuse: Callable[[str], None], seal: Seal) -> None:
        """Listen on behalf of an evaluator.

        Args:
            node: the evaluator.
            required: names of nodes, without namespaces, that have to send one, as all have to who publish any.
            refuse: called with the reason, where a node runs something else than it was handed.
            seal: with which they say it.
        """
        self._node, self._refuse, self._seal = node, refuse, seal
        self._required = frozenset(required)
        self._asked = self._campaign = ""
        self._before: deque[str] = deque(maxlen=_REMEMBERED)
        self._taken: set[str] = set()
        self.subscription = node.create_subscription(EpisodeReceipt, EPISODE_RECEIPT, self._on_receipt, _EVERY_RECEIPT)

    def begin(self, episode: Episode, campaign: str, start: int) -> None:
        """An episode is about to be handed out, whose tick 0 is stamped `start` (ns)."""
        self._before.append(self._asked)
        self._asked, self._campaign = self._seal.proof(episode_digest(episode, campaign, start)), campaign
        self._taken.clear()

    def _on_receipt(self, receipt: Any) -> None:
        name = str(receipt.node)
        if receipt.specification == self._asked:
            self._taken.add(name)
            if others := [one for one in str(receipt.software).split() if not _is_ours(one)]:
                self._say(f"{name} runs another version of {' and '.join(one.partition(':')[0] for one in others)}")
        elif name in self._taken:
            self._say(f"{name} went on to another episode, of campaign {str(receipt.campaign)!r:.60}")
        elif receipt.campaign == self._campaign and receipt.specification not in self._before:
            self._say(f"{name} took the episode for another than was handed out")

    def _say(self, what: str) -> None:
        self._refuse(abort_reason(AbortKind.UNASKED, f"{what}: who else publishes on the topics of SKD?"))

    def awaited(self) -> list[str]:
        """Return the nodes that run the episode and have not said yet what they took it for; cheap where all have."""
        said = {name.rpartition("/")[2] for name in self._taken}
        missing = sorted(self._required - said)
        if missing or self.subscription.get_publisher_count() <= len(self._taken):
            return missing
        there = living_publishers(self._node, EPISODE_RECEIPT)
        names = {one.name for one in there if one.kind == _KIND}  # of another type nobody can be heard
        return sorted(names - self._taken)


def _is_ours(word: str) -> bool:
    package, _, digest = word.partition(":")
    return package in ("skd_sim", "skd_adversary") and digest == sources_digest(package)
