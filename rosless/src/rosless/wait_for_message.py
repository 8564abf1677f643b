"""rclpy.wait_for_message."""

from __future__ import annotations

import time
from typing import Any

from rosless.node import Node
from rosless.qos import QoSProfile

_POLL_S = 0.001


def wait_for_message(
    msg_type: type[Any],
    node: Node,
    topic: str,
    *,
    qos_profile: QoSProfile | int = 1,
    time_to_wait: float = -1,
) -> tuple[bool, Any]:
    """The next message of a topic, without spinning: (True, message), or (False, None) after the time."""
    received: list[Any] = []
    subscription = node.create_subscription(msg_type, topic, received.append, qos_profile)
    end = None if time_to_wait < 0 else time.monotonic() + time_to_wait
    try:
        while node.context.ok() and (end is None or time.monotonic() < end):
            taken = subscription.take()
            if taken is not None:
                return True, taken[1][0]
            time.sleep(_POLL_S)
        return False, None
    finally:
        node.destroy_subscription(subscription)
