"""Messages of recordings: MCAP, SQLite (.db3) and ROS 1 (.bag), each also packed by zstd, read in one way.

The mcap package's StreamReader cuts an MCAP file into records and compares checksums. It is given whole chunks, so that
one that is damaged costs no other, and a file that was cut short gives what came before; the index is not used. The
other storages are read by rosbags. Messages that are compressed one by one are unpacked. Types are as the file defines
them, else those of ROS 2 Jazzy, of skd_msgs, and of a car's commands.
"""

from __future__ import annotations

import functools
import os
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import zstandard
from mcap.exceptions import EndOfFile, InvalidMagic
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk
from rosbags.interfaces import MessageDefinitionFormat, Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from skd_sim.errors import UsageError
from skd_sim.inputs.files import open_regular
from skd_sim.ros_environment.installation import PREFIX, message_package, packages_without_wheel

from skd_evaluator.bags.checks import Damage


def _shared(package: str) -> Iterator[Path]:
    """Yield the folders of .msg files that a package has in the prefixes of this run, or comes with here, in order."""
    prefixes = [os.environ.get(PREFIX, ""), *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    folders = [Path(prefix, "share", package, "msg") for prefix in prefixes if prefix]
    own = [one.folder / "msg" for one in packages_without_wheel() if one.name == package]  # where none are built
    return (folder for folder in (*folders, *own) if folder.is_dir())


@functools.cache
def typestore() -> Typestore:
    """Return the type store with all messages that the graph uses; skd_msgs of the sourced workspace, else SKD's own.

    Raises:
        UsageError: the definitions of skd_msgs are in neither place.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    sourced = next(_shared("skd_msgs"), None) if os.environ.get("AMENT_PREFIX_PATH") else None
    for file in sorted((sourced or message_package().folder / "msg").glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"skd_msgs/msg/{file.stem}"))
    return store


@functools.cache
def types_in(name: str, encoding: str, definition: bytes) -> Typestore:
    """Return a store with a message type as a file defines it, or as it is installed where the file does not say.

    Args:
        name: of the type.
        encoding: of the definition, `ros2msg` (of ROS 1, too), `ros2idl`, or any other, which counts for none.
        definition: as the file has it; some recorders leave it empty, or leave out types that it uses.

    Raises:
        UsageError: the definition cannot be read, or a type is defined nowhere.
    """
    if not definition or encoding not in _DEFINED.values():
        complete(typestore(), name)
        return typestore()
    store = get_typestore(Stores.EMPTY)
    try:
        text = definition.decode()
        if encoding == _DEFINED[_IDL]:  # without the lines by which rosbag2 separates definitions
            lines = (line for line in text.splitlines() if not line.startswith(("====", "IDL:")))
            types = get_types_from_idl("\n".join(lines))
        else:
            types = get_types_from_msg(text, name)
        complete(store, name, types)
    except UsageError:
        raise
    except Exception as error:  # its parser raises whatever the text makes it raise
        raise UsageError(f"the definition of {name:.80} cannot be read ({type(error).__name__})") from error
    return store


def complete(store: Typestore, name: str, defined: Mapping[str, Any] = MappingProxyType({})) -> None:
    """Add a type, and those that it uses, to a store that may not know them.

    Args:
        store: the store.
        name: name of the type.
        defined: types by name; any other is taken as it is installed.

    Raises:
        UsageError: a definition is nowhere.
    """
    if name in store.fielddefs:
        return
    definition = defined[name] if name in defined else _installed(name)
    for _, kind in definition[1]:
        for used in _names(kind):
            complete(store, used, defined)
    store.register({name: definition})


def _installed(name: str) -> Any:
    if name in typestore().fielddefs:
        return typestore().fielddefs[name]
    package, _, kind = name.partition("/msg/")
    file = next((file for folder in _shared(package) if (file := folder / f"{kind}.msg").is_file()), None)
    if file is None:
        raise UsageError(f"{name} cannot be recorded: there is no {kind}.msg in the share folder of {package}")
    return get_types_from_msg(file.read_text(encoding="utf-8"), name)[name]


def _names(field: Any) -> Iterator[str]:
    """Yield the message types that a field of a definition is of."""
    kind, what = field
    if kind == Nodetype.NAME:
        yield what
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from _names(what[0])


_LARGEST_RECORD = 256 * 2**20  # bytes; recorders' chunks have one to a few MiB
_MCAP_MAGIC, _SQLITE_MAGIC = b"\x89MCAP", b"SQLite format 3"
_ROS1_MAGIC, _ZSTD_MAGIC = b"#ROSBAG V", b"\x28\xb5\x2f\xfd"
_MSG, _IDL = MessageDefinitionFormat.MSG, MessageDefinitionFormat.IDL
_DEFINED = {_MSG: "ros2msg", _IDL: "ros2idl"}
_CDR, _ROS1 = "cdr", "ros1"


class Received(NamedTuple):
    """One message.

    Attributes:
        topic: on which it was sent.
        type: name of its type.
        data: its bytes, not compressed by themselves.
        logged: when it was recorded, ns.
        encoding: of the bytes.
        definition: encoding and text of what the file says of its type.
    """

    topic: str
    type: str
    data: bytes
    logged: int
    encoding: str
    definition: tuple[str, bytes]

    @property
    def types(self) -> Typestore:
        """The types by which it is decoded."""
        return types_in(self.type, *self.definition)

    def decoded(self) -> Any:
        """Return the message as rosbags decodes it, by the definition that the file has of its type.

        Raises:
            UsageError: it is encoded otherwise than as ROS 1 or 2 do it, or cannot be decoded.
        """
        if self.encoding not in (_CDR, _ROS1):
            raise UsageError(f"{self.topic} is encoded as {shortened(self.encoding)}, expected {_CDR} or {_ROS1}")
        try:
            read = self.types.deserialize_cdr if self.encoding == _CDR else self.types.deserialize_ros1
            return read(self.data, self.type)
        except UsageError:
            raise
        except Exception as error:  # what damaged bytes are taken for can raise anything
            if self.definition[0] == _DEFINED[_IDL]:  # recorders shorten it
                return self._replace(definition=("", b"")).decoded()
            said = shortened(f"{type(error).__name__}: {error}")
            raise UsageError(f"a message on {self.topic} cannot be read ({said})") from error


@dataclass
class Condition:
    """What was found out about a file while it was read.

    Attributes:
        damage: what is wrong with it, in the order found; a chunk that is named here gave no message.
        unchecked: whether messages came from a part without a checksum.
        refuted: whether a checksum contradicts messages that have no other: nothing that came may be used.
        chunks: how many there were, damaged ones included.
        messages: how many there were on all topics, as far as they could be read.
        topics: the type of each topic.
        counts: how many messages each topic has.
    """

    damage: list[str] = field(default_factory=list)
    unchecked: bool = False
    refuted: bool = False
    chunks: int = 0
    messages: int = 0
    topics: dict[str, str] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)


def read_messages(
    path: Path, requested: Callable[[str], bool], damage: Damage, condition: Condition | None = None
) -> Iterator[Received]:
    """Yield the messages of a file on requested topics, in the order of the file.

    Do not rely on messages before the iteration has ended: the checksum of the whole comes last.

    Args:
        path: path of the file.
        requested: says of a topic whether its messages are requested.
        damage: takes note of damaged parts, which give no messages.
        condition: takes note of what the file holds.

    Raises:
        UsageError: it cannot be opened, is no regular file, or of none of the storages; or something must not be left
            out, or nothing of it may be used.
    """
    condition = condition or Condition()
    requested = functools.cache(requested)
    with _unpacked(path) as (file, magic):
        if magic.startswith(_SQLITE_MAGIC) or magic.startswith(_ROS1_MAGIC):
            found = _rosbags(file, requested, condition, is_ros1=magic.startswith(_ROS1_MAGIC))
        elif magic.startswith(_MCAP_MAGIC) or path.name.lower().endswith((".mcap", ".mcap.zstd", ".mcap.zst")):
            found = _mcap(file, requested, condition)
        else:
            raise UsageError(f"{path}: is no recording: neither MCAP, SQLite of rosbag2, nor a bag of ROS 1")
        for one in found:
            yield one._replace(data=_plain(one.data, condition)) if one.data.startswith(_ZSTD_MAGIC) else one
    if condition.refuted:
        raise UsageError(f"{path}: {condition.damage[-1]}, and it has no other: leave the file out")
    if condition.unchecked:
        damage.unchecked.append(path)
    for what in condition.damage:
        damage.leave_out(f"{path}: {what}; what is whole of it is read")


def span_of(path: Path) -> tuple[int, int] | None:
    """Return when the first and the last message of a file were recorded, ns; None without any."""
    with _unpacked(path) as (file, magic):
        if magic.startswith(_MCAP_MAGIC):
            try:
                with file.open("rb") as stream:
                    summary = make_reader(stream).get_summary()
            except Exception:  # cut short, or damaged
                summary = None
            if summary is not None and summary.statistics is not None and summary.statistics.message_count:
                return summary.statistics.message_start_time, summary.statistics.message_end_time
        times = [one.logged for one in read_messages(file, lambda _topic: True, Damage(skip=True))]
    return (min(times), max(times)) if times else None


@contextmanager
def _unpacked(path: Path) -> Iterator[tuple[Path, bytes]]:
    """Give a file that is not packed as a whole, and how it begins."""
    with open_regular(path) as stream:
        magic = stream.read(16)
        if not magic.startswith(_ZSTD_MAGIC):
            yield path, magic
            return
        stream.seek(0)
        with tempfile.NamedTemporaryFile(suffix=".mcap") as plain:
            try:
                shutil.copyfileobj(zstandard.ZstdDecompressor().stream_reader(stream), plain)
            except zstandard.ZstdError as error:
                raise UsageError(f"{path}: cannot be unpacked ({error})") from error
            plain.flush()
            plain.seek(0)
            yield Path(plain.name), plain.read(16)


def _plain(data: bytes, condition: Condition) -> bytes:
    """Return the bytes of a message that is compressed by itself."""
    try:
        return zstandard.ZstdDecompressor().decompressobj().decompress(data)
    except zstandard.ZstdError as error:
        condition.damage.append(f"a message cannot be unpacked ({error})")
        return b""


def _rosbags(
    path: Path, requested: Callable[[str], bool], condition: Condition, *, is_ros1: bool
) -> Iterator[Received]:
    """Yield the messages of the storages that rosbags reads; they have no checksums."""
    from rosbags.rosbag1 import Reader
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    condition.unchecked = True
    reader: Any = Reader(path) if is_ros1 else Sqlite3Reader(path)
    try:
        reader.open()
        chosen = []
        for one in reader.connections:
            condition.topics[one.topic] = one.msgtype
            condition.counts[one.topic] += one.msgcount
            condition.messages += one.msgcount
            if requested(one.topic):
                chosen.append(one)
        for connection, logged, data in reader.messages(chosen) if chosen else ():
            encoding = _ROS1 if is_ros1 else connection.ext.serialization_format
            defined = _DEFINED.get(connection.msgdef.format, ""), connection.msgdef.data.encode()
            yield Received(connection.topic, connection.msgtype, bytes(data), logged, encoding, defined)
        reader.close()
    except Exception as error:  # what damaged bytes are taken for can raise anything
        condition.damage.append(f"it cannot be read to its end ({shortened(f'{type(error).__name__}: {error}')})")


def _mcap(path: Path, requested: Callable[[str], bool], condition: Condition) -> Iterator[Received]:
    """Yield the messages of an MCAP file."""
    schemas: dict[int, Schema] = {0: Schema(0, b"", "", "")}  # of messages that are of no type
    channels: dict[int, Channel] = {}
    with path.open("rb") as stream:
        reader = StreamReader(stream, emit_chunks=True, validate_crcs=True, record_size_limit=_LARGEST_RECORD)
        for record in _records(reader, condition):
            if isinstance(record, Schema):
                if record.encoding == "ros1msg":
                    record.encoding, record.name = _DEFINED[_MSG], record.name.replace("/", "/msg/", 1)
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
                if record.schema_id in schemas:
                    condition.topics[record.topic] = schemas[record.schema_id].name
            elif isinstance(record, Message):
                condition.messages += 1
                channel = channels.get(record.channel_id)
                schema = None if channel is None else schemas.get(channel.schema_id)
                if channel is not None:
                    condition.counts[channel.topic] += 1
                if channel is not None and not requested(channel.topic):
                    continue
                if channel is None or schema is None:
                    condition.damage.append(f"a message is of channel {record.channel_id}, which has no type")
                    continue
                defined, encoding = (schema.encoding, schema.data), channel.message_encoding
                yield Received(channel.topic, schema.name, record.data, record.log_time, encoding, defined)
        if not condition.damage and stream.read(1):
            condition.damage.append("something follows its end")


def _records(reader: StreamReader, condition: Condition) -> Iterator[McapRecord]:
    """Yield the records of a file, those of chunks among them, and take note of what is damaged."""
    try:
        for record in reader.records:
            if isinstance(record, Chunk):
                condition.chunks += 1
                yield from _of_chunk(record, condition)
            elif isinstance(record, DataEnd):
                condition.unchecked &= not record.data_section_crc
            elif isinstance(record, Statistics):
                said, found = (record.message_count, record.chunk_count), (condition.messages, condition.chunks)
                if said != found and not condition.damage:
                    told = "it says that it holds {} messages in {} chunks, and has {} in {}".format(*said, *found)
                    condition.damage.append(told)
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


def _of_chunk(chunk: Chunk, condition: Condition) -> list[McapRecord]:
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


def shortened(text: str) -> str:
    """Return a text in a few words on one line."""
    said = " ".join(text.split()).rstrip(": ")
    return said if len(said) <= 120 else f"{said[:120]}…"
