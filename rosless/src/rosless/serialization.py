"""rclpy.serialization."""

from __future__ import annotations

from typing import Any

from rosless.interfaces import cdr


def serialize_message(message: Any) -> bytes:
    """The CDR bytes of a message."""
    return cdr.serialize(message)


def deserialize_message(serialized_message: bytes, message_type: type[Any]) -> Any:
    """The message in CDR bytes."""
    return cdr.deserialize(serialized_message, message_type.__msgtype__)
