"""Reads the messages of an MCAP file, from its beginning to its end, and says what of it is damaged.

The mcap package's StreamReader cuts the file into records and compares checksums. It is given whole chunks, so that one
that is damaged costs no other, and a file that was cut short gives what came before. The index is not used.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from mcap.exceptions import EndOfFile, InvalidMagic
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import open_regular

from skd_evaluator.bags.types import types_in

_LARGEST_RECORD = 256 * 2**20  # bytes; recorders' chunks have one to a few MiB
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class Received(NamedTuple):
    """One message: its type, its channel and its bytes."""

    schema: Schema
    channel: Channel
    data: bytes

    def decoded(self) -> Any:
        """Return the message as rosbags decodes it, by the definition that the file has of its type.

        Raises:
            UsageError: it is not encoded as CDR, is compressed by itself, or cannot be decoded.
        """
        topic = self.channel.topic
        if self.channel.message_encoding != "cdr":
            raise UsageError(f"{topic} is encoded as {shortened(self.channel.message_encoding)}, expected cdr")
        if self.data.startswith(_ZSTD_MAGIC):
            raise UsageError(
                "its messages are compressed one by one; unpack it with ros2 bag convert, or record with "
                "--storage-preset-profile zstd_fast instead of --compression-mode message"
            )
        store = types_in(self.schema.name, self.schema.encoding, self.schema.data)
        try:
            return store.deserialize_cdr(self.data, self.schema.name)
        except Exception as error:  # what damaged bytes are taken for can raise anything
            said = shortened(f"{type(error).__name__}: {error}")
            raise UsageError(f"a message on {topic} cannot be read ({said})") from error


@dataclass
class Condition:
    """What was found out about a file while it was read.

    Attributes:
        damage: what is wrong with it, in the order found; a chunk that is named here gave no message.
        unchecked: whether messages came from a part without a checksum.
        refuted: whether a checksum contradicts messages that have no other: nothing that came may be used.
        chunks: how many there were, damaged ones included.
        messages: how many there were on all topics, as far as they could be read.
    """

    damage: list[str] = field(default_factory=list)
    unchecked: bool = False
    refuted: bool = False
    chunks: int = 0
    messages: int = 0


def read_messages(path: Path, wanted: Callable[[str], bool], condition: Condition) -> Iterator[Received]:
    """Yield the messages of an MCAP file on wanted topics, in the order of the file.

    Damaged parts are left out and named in `condition`, which is complete when the iteration has ended. Do not rely on
    messages before that, because the checksum of the whole comes last.

    Args:
        path: path of the MCAP file.
        wanted: says of a topic whether its messages are wanted.
        condition: told what is found.

    Raises:
        UsageError: it cannot be opened, or is no regular file.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    wanted = functools.cache(wanted)
    with open_regular(path) as stream:
        for record in _records(StreamReader(stream, emit_chunks=True, validate_crcs=True,
                                            record_size_limit=_LARGEST_RECORD), condition):  # fmt: skip
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                condition.messages += 1
                channel = channels.get(record.channel_id)
                schema = None if channel is None else schemas.get(channel.schema_id)
                if channel is None or (schema is None and wanted(channel.topic)):
                    condition.damage.append(f"a message is of channel {record.channel_id}, which has no type")
                elif schema is not None and wanted(channel.topic):
                    yield Received(schema, channel, record.data)
        if not condition.damage and stream.read(1):
            condition.damage.append("something follows its end")


def _records(reader: StreamReader, condition: Condition) -> Iterator[McapRecord]:
    """Yield the records of a file, those of chunks among them, and take note of what is damaged."""
    try:
        for record in reader.records:
            if isinstance(record, Chunk):
                condition.chunks += 1
                yield from _unpacked(record, condition)
            elif isinstance(record, DataEnd):
                condition.unchecked &= not record.data_section_crc
            elif isinstance(record, Statistics):
                _compare(record, condition)
            else:
                condition.unchecked |= isinstance(record, Message)
                yield record
    except EndOfFile:
        condition.damage.append("it is cut short")
    except InvalidMagic:
        condition.damage.append("it does not begin or end as an MCAP file")
    except CRCValidationError:
        condition.refuted = condition.unchecked
        condition.damage.append("its records do not match their checksum")
    except Exception as error:  # what damaged bytes are taken for can raise anything
        condition.damage.append(f"a record cannot be read ({shortened(f'{type(error).__name__}: {error}')})")


def _unpacked(chunk: Chunk, condition: Condition) -> list[McapRecord]:
    """Return the records of a chunk; none where it is damaged."""
    try:
        records = breakup_chunk(chunk, validate_crc=True)
    except CRCValidationError:
        condition.damage.append(f"chunk {condition.chunks} does not match its checksum")
    except Exception as error:
        said = shortened(f"{type(error).__name__}: {error}")
        condition.damage.append(f"chunk {condition.chunks} cannot be unpacked ({said})")
    else:
        condition.unchecked |= not chunk.uncompressed_crc
        return records
    return []


def _compare(said: Statistics, condition: Condition) -> None:
    found = (condition.chunks, condition.messages)
    if (said.chunk_count, said.message_count) != found and not condition.damage:
        condition.damage.append(
            f"it says that it holds {said.message_count} messages in {said.chunk_count} chunks, and has {found[1]} in "
            f"{found[0]}"
        )


def shortened(text: str) -> str:
    """Return a text in a few words on one line."""
    said = " ".join(text.split()).rstrip(": ")
    return said if len(said) <= 120 else f"{said[:120]}…"
