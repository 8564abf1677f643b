"""rclpy.topic_endpoint_info and rclpy.type_hash: what is known of one publisher or subscription."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from enum import IntEnum

from rosless.qos import HistoryPolicy, QoSProfile, qos_profile_unknown

_HASH_IN_USER_DATA = re.compile(rb"typehash=RIHS(\d\d)_([0-9a-f]{64});")


class TopicEndpointTypeEnum(IntEnum):
    """Kind of an endpoint."""

    INVALID = 0
    PUBLISHER = 1
    SUBSCRIPTION = 2


@dataclass
class TypeHash:
    """Version and value of a type's hash."""

    version: int = -1
    value: bytes = bytes(32)

    def __str__(self) -> str:
        if self.version <= 0 or len(self.value) != 32:
            return "INVALID"
        return f"RIHS{self.version:02}_{self.value.hex()}"

    @classmethod
    def from_user_data(cls, data: bytes) -> TypeHash:
        """The hash that ROS 2 puts into the user data of an endpoint."""
        match = _HASH_IN_USER_DATA.search(data)
        return cls(int(match[1]), bytes.fromhex(match[2].decode())) if match else cls()


@dataclass
class TopicEndpointInfo:
    """A publisher or subscription, and the node that it belongs to."""

    node_name: str = ""
    node_namespace: str = ""
    topic_type: str = ""
    topic_type_hash: TypeHash = field(default_factory=TypeHash)
    endpoint_type: TopicEndpointTypeEnum = TopicEndpointTypeEnum.INVALID
    endpoint_gid: list[int] = field(default_factory=list)
    qos_profile: QoSProfile = field(default_factory=lambda: qos_profile_unknown)

    def __str__(self) -> str:
        qos = self.qos_profile
        history = qos.history.name
        if qos.history == HistoryPolicy.KEEP_LAST:
            history += f" ({qos.depth})"
        return "\n".join(
            [
                f"Node name: {self.node_name}",
                f"Node namespace: {self.node_namespace}",
                f"Topic type: {self.topic_type}",
                f"Topic type hash: {self.topic_type_hash}",
                f"Endpoint type: {self.endpoint_type.name}",
                f"GID: {'.'.join(format(byte, '02x') for byte in self.endpoint_gid)}",
                "QoS profile:",
                f"  Reliability: {qos.reliability.name}",
                f"  History (Depth): {history}",
                f"  Durability: {qos.durability.name}",
                f"  Lifespan: {qos.lifespan}",
                f"  Deadline: {qos.deadline}",
                f"  Liveliness: {qos.liveliness.name}",
                f"  Liveliness lease duration: {qos.liveliness_lease_duration}",
            ]
        )
