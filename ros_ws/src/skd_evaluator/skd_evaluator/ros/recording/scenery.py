"""What a bag holds so that RViz and Foxglove replay it as it was seen: transforms and the car's looks.

Nothing of it is needed to compute anything. They are those that were heard, of whoever sent them; what is latched is in
every bag, at the episode's start. Markers and figures are made when the bag is written (`recording`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from skd_sim.messages.stream_cdr import CdrError, read_transforms
from skd_sim.nodes.support import ROBOT_DESCRIPTION, STREAM, TF, TF_STATIC
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from skd_evaluator.bags.writer import RecordedMessage

# As tf2 listens: each of several nodes may have latched transforms of its own.
_LATCHED = QoSProfile(
    depth=100,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


class Scenery:
    """Listens to transforms and to what the car looks like, for the bags.

    Attributes:
        transforms: the subscription to those that change.
    """

    def __init__(
        self, node: Node, keep: Callable[[RecordedMessage], None], log_time: Callable[[int], int | None]
    ) -> None:
        """Subscribe.

        Args:
            node: node that listens.
            keep: called with each message to record that belongs to one moment.
            log_time: returns the simulation time (ns) at which a message with a stamp (ns) is logged, or none.
        """
        self._keep, self._log_time = keep, log_time
        self._names = {topic: node.resolve_topic_name(topic) for topic in (TF, TF_STATIC, ROBOT_DESCRIPTION)}
        self._fixed: dict[str, Any] = {}
        self._description: bytes | None = None
        self.transforms = node.create_subscription(TFMessage, TF, self._on_transforms, STREAM, raw=True)
        node.create_subscription(TFMessage, TF_STATIC, self._on_fixed_transforms, _LATCHED)
        node.create_subscription(String, ROBOT_DESCRIPTION, self._on_description, _LATCHED, raw=True)

    def _on_transforms(self, data: bytes) -> None:
        try:
            stamp = self._log_time(read_transforms(data)[0])
        except CdrError:
            return
        if stamp is not None:
            self._keep(RecordedMessage(self._names[TF], TFMessage, stamp, bytes(data)))

    def _on_fixed_transforms(self, message: Any) -> None:
        self._fixed |= {transform.child_frame_id: transform for transform in message.transforms}

    def _on_description(self, data: bytes) -> None:
        self._description = bytes(data)

    def latched(self, start: int) -> list[RecordedMessage]:
        """Return what was latched when an episode started at `start` (ns)."""
        found = []
        if self._fixed:
            fixed = serialize_message(TFMessage(transforms=list(self._fixed.values())))
            found.append(RecordedMessage(self._names[TF_STATIC], TFMessage, start, fixed, latched=True))
        if self._description is not None:
            found.append(
                RecordedMessage(self._names[ROBOT_DESCRIPTION], String, start, self._description, latched=True)
            )
        return found
