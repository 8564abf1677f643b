"""rclpy.publisher."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rosless import qos_dds, wire
from rosless.callback_groups import CallbackGroup
from rosless.duration import Duration
from rosless.event_handler import PublisherEventCallbacks
from rosless.exceptions import InvalidHandle, RCLError
from rosless.interfaces import cdr, definitions
from rosless.interfaces.idl import idl_struct
from rosless.names import topic_to_dds
from rosless.qos import QoSProfile

if TYPE_CHECKING:
    from rosless.node import Node

_HEADER = cdr.LITTLE_ENDIAN_HEADER
_PADDING = [bytes(count) for count in range(4)]


class Publisher:
    """Sends messages of one type on one topic. Made by :meth:`Node.create_publisher`."""

    def __init__(
        self,
        node: Node,
        msg_type: type[Any],
        topic: str,
        resolved_topic: str,
        qos_profile: QoSProfile,
        event_callbacks: PublisherEventCallbacks,
        callback_group: CallbackGroup,
    ) -> None:
        self.msg_type = msg_type
        self.topic = topic
        self.qos_profile = qos_profile
        self.callback_group = callback_group
        self._context = node.context
        self._resolved_topic = resolved_topic
        name = msg_type.__msgtype__
        self._append = cdr.serializer(name)
        # reading it back once warms everything up that the first message would otherwise wait for
        cdr.deserialize(cdr.serialize(msg_type()), name)
        dds_topic = topic_to_dds(
            resolved_topic, avoid_ros_namespace_conventions=qos_profile.avoid_ros_namespace_conventions
        )
        qos = qos_dds.to_dds(qos_profile, definitions.type_hash(name), writer=True)
        self._writer = node.context.participant.writer(dds_topic, idl_struct(name), qos)
        self._entity: int = self._writer._ref
        self.gid: bytes = self._writer.get_guid().bytes
        self.event_handlers = event_callbacks.create_event_handlers(self._entity, node.get_logger(), topic)

    def publish(self, msg: Any) -> None:
        """Send a message, or one that is serialised already.

        :raises TypeError: if it is not a message of this publisher's type, or a member has a value of
        another type.
        """
        if not self._context._ok or not self._entity:
            self._refuse()
        if msg.__class__ is self.msg_type:
            out = bytearray(_HEADER)
            try:
                self._append(out, msg)
            except Exception:
                out = bytearray(_HEADER)
                cdr.append_checked(self._append, out, msg)
            out += _PADDING[-len(out) & 3]
            wire.write(self._entity, bytes(out))
        elif isinstance(msg, bytes):
            wire.write(self._entity, msg + _PADDING[-len(msg) & 3])
        else:
            raise TypeError(f"Expected {self.msg_type}, got {type(msg)}")

    def _refuse(self) -> None:
        if not self._entity:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")
        raise RCLError("Failed to publish: publisher's context is invalid")

    def get_subscription_count(self) -> int:
        """Number of subscriptions that get this publisher's messages."""
        return wire.matched_count(self._entity, is_writer=True)

    @property
    def topic_name(self) -> str:
        """The topic, expanded and remapped."""
        return self._resolved_topic

    def assert_liveliness(self) -> None:
        """Say that this publisher is alive."""
        wire.assert_liveliness(self._entity)

    def wait_for_all_acked(self, timeout: Duration | None = None) -> bool:
        """Wait until everything is acknowledged; a negative timeout waits for ever, as does none."""
        left = -1 if timeout is None else timeout.nanoseconds
        if left >= 0:
            return wire.wait_for_acks(self._entity, left)
        while not wire.wait_for_acks(self._entity, wire.LONGEST_WAIT_NS):
            if not self._context.ok():
                return False
        return True

    def destroy(self) -> None:
        """Destroy the publisher; nodes do it by :meth:`Node.destroy_publisher`."""
        entity, self._entity = self._entity, 0
        for handler in self.event_handlers:
            handler.destroy()
        if entity:
            wire.delete(entity)
