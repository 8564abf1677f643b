"""CDR bytes of messages and back, by code generated per type.

Runs of fixed-size members are packed by one ``struct`` call across nested messages; that is what makes a
round trip fast. What a value may be is stricter than in rclpy, which writes garbage for an int in a float
member: here that is a TypeError before anything is sent.
"""

from __future__ import annotations

import struct
from typing import Any, Protocol

from rosless.interfaces import checks
from rosless.interfaces.classes import Message, message_class
from rosless.interfaces.codegen import compile_deserializer, compile_serializer

LITTLE_ENDIAN_HEADER = b"\x00\x01\x00\x00"
_BIG_ENDIAN_PLAIN_CDR = b"\x00\x00"
_LITTLE_ENDIAN_PLAIN_CDR = b"\x00\x01"


class DeserializationError(ValueError):
    """Bytes that are no CDR of the type they were read as."""


class Append(Protocol):
    """Appends the CDR of a message to a buffer that starts with a 4-byte header."""

    def __call__(self, out: bytearray, message: Any) -> None:  # noqa: D102
        ...


class Read(Protocol):
    """Reads a message at a position of a buffer that starts with a 4-byte header."""

    def __call__(self, buffer: bytes | bytearray, position: int) -> tuple[Any, int]:  # noqa: D102
        ...


_serializers: dict[str, Append] = {}
_deserializers: dict[tuple[str, str], Read] = {}


def serializer(name: str) -> Append:
    """The function that appends a message of type ``pkg/msg/Name`` to a buffer."""
    try:
        return _serializers[name]
    except KeyError:
        _serializers[name] = compile_serializer(message_class(name), serializer)
        return _serializers[name]


def deserializer(name: str, order: str = "<") -> Read:
    """The function that reads a message of type ``pkg/msg/Name``; order is "<" or ">"."""
    try:
        return _deserializers[name, order]
    except KeyError:
        _deserializers[name, order] = compile_deserializer(message_class(name), order, deserializer)
        return _deserializers[name, order]


def serialize(message: Message) -> bytes:
    """The CDR of a message, with its encapsulation header."""
    out = bytearray(LITTLE_ENDIAN_HEADER)
    append_checked(serializer(message.__msgtype__), out, message)
    return bytes(out)


def append_checked(append: Append, out: bytearray, message: Message) -> None:
    """Append a message; what is wrong with it is said as type, member and value."""
    try:
        append(out, message)
    except Exception as error:
        # The generated code does not know which member it failed at; look only now.
        checks.explain(message)
        raise TypeError(f"{message.__msgtype__} cannot be serialised: {error}") from error


def deserialize(data: bytes | bytearray | memoryview, name: str) -> Any:
    """The message of type ``pkg/msg/Name`` in these bytes. Its arrays are writable."""
    header = bytes(data[:2])
    if header == _LITTLE_ENDIAN_PLAIN_CDR:
        order = "<"
    elif header == _BIG_ENDIAN_PLAIN_CDR:
        order = ">"
    else:
        raise DeserializationError(f"not plain CDR (header {header.hex()}), cannot read it as {name}")
    return read_checked(deserializer(name, order), bytearray(data), name)


def read_checked(read: Read, data: bytearray | bytes, name: str, position: int = 4) -> Any:
    """Read a message; truncated or damaged data is one kind of error."""
    try:
        return read(data, position)[0]
    except (struct.error, ValueError, IndexError, OverflowError, MemoryError) as error:
        raise DeserializationError(f"{len(data)} bytes are no valid {name}: {error}") from error
