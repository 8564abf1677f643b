"""Reads an MCAP file from end to end and checks everything that it says of itself.

The mcap package's own readers allocate what a length field says, read past the end of a record into the next, and take
the index's word for where chunks are. Here every record is cut out by its length first, no length is followed beyond
what is in the file and within `LARGEST_RECORD`, and checksums of chunks, of the data section and of the summary are
compared wherever the recorder wrote them (the format's specification: github.com/foxglove/mcap, "MCAP Format
Specification"). The index is not used, so that a damaged one cannot hide a chunk.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, NamedTuple, TypeVar

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, McapRecord, Schema, Statistics
from skd_sim.inputs.outside import open_regular

LARGEST_RECORD = 64 * 2**20
"""Bytes of the largest record or chunk, packed or not, that is read; recorders' chunks have one to a few MiB."""
LARGEST_MESSAGE = 2 * 2**20
"""Bytes of the largest message that an episode is made of: φ over the longest horizon and shortest tick has 1.4 MiB."""
_FREE, _RATIO = 64 * 2**20, 64
"""What a file may hold unpacked: this many bytes, and this many times its size beyond them."""
_MAGIC = b"\x89MCAP0\r\n"
_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHANNEL_ID = struct.Struct("<H")
_BLOCK = 2**20
_IN_CHUNKS = (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL)
_MOST_DEFINITIONS = 2 * 2**16  # of a chunk: types and channels have numbers of 16 bits
_SKIPPED = (Opcode.ATTACHMENT, Opcode.METADATA, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT_INDEX)

_Record = TypeVar("_Record", bound=McapRecord)


class DamagedError(Exception):
    """A file, or a part of it, is damaged; the message says what is wrong, and where."""


class Received(NamedTuple):
    """One message: its type, its channel and its bytes."""

    schema: Schema
    channel: Channel
    data: bytes


@dataclass
class Condition:
    """What was found out about a file while it was read.

    Attributes:
        damage: what is wrong with it, in the order found; a chunk that is named here may have given a part of its
            messages, or none.
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


class _Source:
    """A file that counts its place and sums up what was read."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream = stream
        self.size = stream.seek(0, 2)
        stream.seek(0)
        self.place = 0
        self.sum = 0

    def take(self, length: int) -> bytes:
        data = self._stream.read(length)
        if len(data) < length:
            raise DamagedError(f"it is cut short after {self.size} bytes")
        self.place += length
        self.sum = zlib.crc32(data, self.sum)
        return data

    def skip(self, length: int) -> None:
        while length > 0:
            length -= len(self.take(min(length, _BLOCK)))


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
    with open_regular(path) as stream:
        try:
            yield from _File(_Source(stream), wanted, condition).messages()
        except DamagedError as error:
            condition.damage.append(str(error))


class _File:
    """The state of reading one file."""

    def __init__(self, source: _Source, wanted: Callable[[str], bool], condition: Condition) -> None:
        self._source = source
        self._wanted = wanted
        self._condition = condition
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._definitions: set[tuple[int, bytes]] = set()
        self._kinds: dict[int, tuple[Schema, Channel] | None] = {}
        self._unpacked = 0

    def messages(self) -> Iterator[Received]:
        """Read the data section, record by record, then what stands after it."""
        source, condition = self._source, self._condition
        if source.size == 0:
            raise DamagedError("it is empty")
        if source.size < len(_MAGIC) or source.take(len(_MAGIC)) != _MAGIC:
            raise DamagedError("it is no MCAP file: it does not begin as one")
        while True:
            before = source.sum
            opcode, length = self._next()
            if opcode == Opcode.CHUNK:
                yield from self._chunk(source.take(length))
            elif opcode in _IN_CHUNKS:
                message = self._record(opcode, source.take(length), 0, length)
                if opcode == Opcode.MESSAGE:
                    condition.unchecked = True
                if message is not None:
                    yield message
            elif opcode == Opcode.DATA_END:
                said = _parsed(DataEnd, source.take(length), "the end of its data section").data_section_crc
                if said == before:
                    condition.unchecked = False
                elif said:
                    condition.refuted = condition.unchecked
                    condition.damage.append("its records do not match their checksum")
                return self._summary()
            elif opcode == Opcode.FOOTER:
                raise DamagedError("its data section has no end")
            else:
                source.skip(length)  # the header, attachments, metadata, indices, and what later versions may add

    def _next(self) -> tuple[int, int]:
        """Return opcode and length of the next record; it is within the file."""
        source = self._source
        if source.place == source.size:
            raise DamagedError(f"it is cut short after {source.size} bytes: it has no footer")
        opcode, length = _HEAD.unpack(source.take(_HEAD.size))
        if opcode == 0:
            raise DamagedError(f"byte {source.place - _HEAD.size} is not the beginning of a record")
        if length > source.size - source.place:
            raise DamagedError(f"it is cut short after {source.size} bytes: a record of {length} bytes does not end")
        if length > LARGEST_RECORD and opcode not in _SKIPPED:
            raise DamagedError(_too_large("a record", length))
        return opcode, length

    def _chunk(self, content: bytes) -> Iterator[Received]:
        self._condition.chunks += 1
        number = self._condition.chunks
        try:
            chunk = _parsed(Chunk, content, f"chunk {number}")
            raw = self._unpack(chunk, number)
            if not chunk.uncompressed_crc:
                self._condition.unchecked = True
            for opcode, start, end in _cut(raw, f"chunk {number}"):
                message = self._record(opcode, raw, start, end)
                if message is not None:
                    yield message
        except DamagedError as error:
            self._condition.damage.append(str(error))

    def _unpack(self, chunk: Chunk, number: int) -> bytes:
        """Return the records of a chunk, no more of them than it says itself."""
        size = chunk.uncompressed_size
        if size > LARGEST_RECORD:
            raise DamagedError(_too_large(f"chunk {number}", size))
        self._unpacked += size
        allowed = _FREE + _RATIO * self._source.size
        if self._unpacked > allowed:
            raise DamagedError(f"it unpacks to more than {allowed // 2**20} MiB, {_RATIO} times its size: split it")
        try:
            raw = _UNPACK[chunk.compression](chunk.data, size)
        except KeyError:
            raise DamagedError(f"chunk {number} is packed by {chunk.compression[:20]!r}, which is unknown") from None
        except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
            raise DamagedError(f"chunk {number} cannot be unpacked ({' '.join(str(error).split())})") from error
        if len(raw) != size:
            raise DamagedError(f"chunk {number} unpacks to {len(raw)} bytes and not to {size}")
        if chunk.uncompressed_crc and zlib.crc32(raw) != chunk.uncompressed_crc:
            raise DamagedError(f"chunk {number} does not match its checksum")
        return raw

    def _record(self, opcode: int, raw: bytes, start: int, end: int) -> Received | None:
        """Take note of a schema or a channel, or return a message that is wanted.

        Args:
            opcode: kind of the record, as MCAP numbers it.
            raw: what holds its content.
            start: where in it the content begins.
            end: where in it the content ends.
        """
        if opcode == Opcode.MESSAGE:
            self._condition.messages += 1
            if end - start < _MESSAGE_HEAD.size:
                raise DamagedError("a message is shorter than its head")
            number = _CHANNEL_ID.unpack_from(raw, start)[0]
            if number not in self._kinds:
                self._kinds[number] = self._kind(number)
            kind = self._kinds[number]
            if kind is None:
                return None
            if end - start > LARGEST_MESSAGE:
                raise DamagedError(f"a message on {kind[1].topic} has {end - start} bytes, more than any of an episode")
            return Received(*kind, raw[start + _MESSAGE_HEAD.size : end])
        content = raw[start:end]
        if (opcode, content) in self._definitions:
            return None  # repeated, as some recorders do in every chunk
        if opcode == Opcode.SCHEMA:
            schema = _parsed(Schema, content, "a schema")
            _same(self._schemas.setdefault(schema.id, schema), schema, f"schema {schema.id}")
        elif opcode == Opcode.CHANNEL:
            channel = _parsed(Channel, content, "a channel")
            _same(self._channels.setdefault(channel.id, channel), channel, f"channel {channel.id}")
        self._definitions.add((opcode, content))
        return None

    def _kind(self, number: int) -> tuple[Schema, Channel] | None:
        """Return type and channel, if its topic is wanted."""
        channel = self._channels.get(number)
        if channel is None:
            raise DamagedError(f"a message is of channel {number}, which was not announced")
        if not self._wanted(channel.topic):
            return None
        schema = self._schemas.get(channel.schema_id)
        if schema is None:
            raise DamagedError(f"channel {channel.topic} has no message type")
        return schema, channel

    def _summary(self) -> None:
        """Read what follows the data section: nothing of it is used, but it must agree with what was read."""
        source = self._source
        begin = source.place
        source.sum = 0
        while True:
            before, start = source.sum, source.place
            opcode, length = self._next()
            if opcode == Opcode.FOOTER:
                head = _HEAD.pack(opcode, length)
                content = source.take(length)
                footer = _parsed(Footer, content, "its footer")
                if footer.summary_start not in (0, begin) or (footer.summary_start == 0 and start != begin):
                    self._condition.damage.append("its footer points to another place than its summary's")
                elif footer.summary_crc and zlib.crc32(content[:16], zlib.crc32(head, before)) != footer.summary_crc:
                    self._condition.damage.append("its summary does not match its checksum")
                break
            if opcode == Opcode.STATISTICS:
                self._compare(_parsed(Statistics, source.take(length), "its statistics"))
            else:
                source.skip(length)
        if source.size - source.place < len(_MAGIC) or source.take(len(_MAGIC)) != _MAGIC:
            self._condition.damage.append("it does not end as an MCAP file")
        if source.place < source.size:
            self._condition.damage.append(f"{source.size - source.place} bytes follow its end")

    def _compare(self, said: Statistics) -> None:
        found = (self._condition.chunks, self._condition.messages)
        if (said.chunk_count, said.message_count) != found and not self._condition.damage:
            self._condition.damage.append(
                f"it says that it holds {said.message_count} messages in {said.chunk_count} chunks, and has {found[1]} "
                f"in {found[0]}"
            )


def _parsed(kind: type[_Record], content: bytes, what: str) -> _Record:
    """Return a record of the mcap package from its bytes, all of which must be in `content`."""
    try:
        return kind.read(ReadDataStream(BytesIO(content)))  # type: ignore[attr-defined,no-any-return]
    except Exception as error:  # its parsers raise whatever the bytes make them raise
        raise DamagedError(f"{what} cannot be read") from error


def _same(known: McapRecord, new: McapRecord, what: str) -> None:
    if known != new:
        raise DamagedError(f"{what} is defined twice, and differently")


def _cut(raw: bytes, what: str) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of each record in a chunk; they must fill it exactly."""
    place, size, definitions = 0, len(raw), 0
    while place < size:
        if size - place < _HEAD.size:
            raise DamagedError(f"{what} ends within a record")
        opcode, length = _HEAD.unpack_from(raw, place)
        place += _HEAD.size
        if opcode != Opcode.MESSAGE:
            definitions += 1
            if opcode not in _IN_CHUNKS or definitions > _MOST_DEFINITIONS:
                raise DamagedError(f"{what} holds a kind of record that no chunk may hold")
        if length > size - place:
            raise DamagedError(f"{what} ends within a record")
        yield opcode, place, place + length
        place += length


def _from_zstd(data: bytes, size: int) -> bytes:
    said = zstandard.frame_content_size(data)  # it is what would be allocated
    if said not in (-1, size):
        raise zstandard.ZstdError(f"it says that it unpacks to {said} bytes, its chunk {size}")
    return zstandard.decompress(data, max_output_size=max(1, size))


def _from_lz4(data: bytes, size: int) -> bytes:
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))


_UNPACK: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda data, _size: data,
    "zstd": _from_zstd,
    "lz4": _from_lz4,
}


def _too_large(what: str, size: int) -> str:
    return f"{what} has {size} bytes; at most {LARGEST_RECORD // 2**20} MiB are read"
