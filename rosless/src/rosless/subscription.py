"""rclpy.subscription."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from enum import Enum
from typing import TYPE_CHECKING, Any

from rosless import qos_dds, wire
from rosless.callback_groups import CallbackGroup
from rosless.event_handler import SubscriptionEventCallbacks
from rosless.interfaces import cdr, definitions
from rosless.interfaces.idl import idl_struct
from rosless.names import topic_to_dds
from rosless.qos import QoSProfile

if TYPE_CHECKING:
    from rosless.node import Node

_HEADER = cdr.LITTLE_ENDIAN_HEADER


class Subscription:
    """Gets messages of one type from one topic. Made by :meth:`Node.create_subscription`."""

    class CallbackType(Enum):
        """What the callback takes."""

        MessageOnly = 0
        WithMessageInfo = 1

    def __init__(
        self,
        node: Node,
        msg_type: type[Any],
        topic: str,
        resolved_topic: str,
        callback: Callable[..., Any],
        callback_group: CallbackGroup,
        qos_profile: QoSProfile,
        raw: bool,
        event_callbacks: SubscriptionEventCallbacks,
    ) -> None:
        self.msg_type = msg_type
        self.topic = topic
        self.callback = callback
        self.callback_group = callback_group
        self.qos_profile = qos_profile
        self.raw = raw
        self._resolved_topic = resolved_topic
        self._type_name: str = msg_type.__msgtype__
        self._read = cdr.deserializer(self._type_name)
        cdr.deserialize(cdr.serialize(msg_type()), self._type_name)  # warm up
        dds_topic = topic_to_dds(
            resolved_topic, avoid_ros_namespace_conventions=qos_profile.avoid_ros_namespace_conventions
        )
        qos = qos_dds.to_dds(qos_profile, definitions.type_hash(self._type_name), writer=False)
        self._reader = node.context.participant.reader(dds_topic, idl_struct(self._type_name), qos)
        self._entity: int = self._reader._ref
        self.gid: bytes = self._reader.get_guid().bytes
        self.wait_entity = wire.read_condition(self._entity)
        self.event_handlers = event_callbacks.create_event_handlers(self._entity, node.get_logger(), topic)

    @property
    def callback(self) -> Callable[..., Any]:
        """What gets the messages."""
        return self._callback

    @callback.setter
    def callback(self, value: Callable[..., Any]) -> None:
        self._callback = value
        for count, kind in ((1, self.CallbackType.MessageOnly), (2, self.CallbackType.WithMessageInfo)):
            try:
                inspect.signature(value).bind(*[object()] * count)
            except TypeError:
                continue
            self._callback_type = kind
            self._with_info = kind is self.CallbackType.WithMessageInfo
            return
        raise RuntimeError(
            "Subscription.__init__(): callback should be either be callable with one argument"
            "(to get only the message) or two (to get message and message info)"
        )

    def take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        """Take the next message, and say what to run."""
        if not self._entity:
            return None
        sample = wire.take_one(self._entity)
        if sample is None:
            return None
        data, info = sample
        message: Any
        if self.raw:
            message = data
        elif data[:2] == b"\x00\x01":
            message = cdr.read_checked(self._read, bytearray(data), self._type_name)
        else:
            message = cdr.deserialize(data, self._type_name)
        if not self._with_info:
            return self._callback, (message,)
        return self._callback, (message, _message_info(info))

    def get_publisher_count(self) -> int:
        """Number of publishers whose messages arrive here."""
        return wire.matched_count(self._entity, is_writer=False)

    @property
    def topic_name(self) -> str:
        """The topic, expanded and remapped."""
        return self._resolved_topic

    def destroy(self) -> None:
        """Destroy the subscription; nodes do it by :meth:`Node.destroy_subscription`."""
        entity, self._entity = self._entity, 0
        for handler in self.event_handlers:
            handler.destroy()
        if entity:
            wire.delete(entity)


def _message_info(info: Any) -> dict[str, Any]:
    # numbers that DDS does not give are what rmw's "unsupported" is
    return {
        "source_timestamp": info.source_timestamp,
        "received_timestamp": 0,
        "publication_sequence_number": None,
        "reception_sequence_number": None,
    }
