"""Messages of MCAP files: their types, and a reader that says what of a file is damaged.

The mcap package's StreamReader cuts the file into records and compares checksums. It is given whole chunks, so that one
that is damaged costs no other, and a file that was cut short gives what came before. The index is not used. Types are
those of ROS 2 Jazzy, of skd_msgs, and of a car's commands, or as the file defines them.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from mcap.exceptions import EndOfFile, InvalidMagic
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore
from skd_sim.errors import UsageError
from skd_sim.inputs.files import open_regular
from skd_sim.ros_environment.installation import message_package, packages_without_wheel
from skd_sim.ros_environment.variables import PREFIX


def _shared(package: str) -> Iterator[Path]:
    """Yield the folders of .msg files that a package has in the prefixes of this run, or comes with here, in order."""
    prefixes = [os.environ.get(PREFIX, ""), *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    folders = [Path(prefix, "share", package, "msg") for prefix in prefixes if prefix]
    own = [one.folder / "msg" for one in packages_without_wheel() if one.name == package]  # where none are built
    return (folder for folder in (*folders, *own) if folder.is_dir())


def _definition_folder() -> Path:
    """Return the folder of skd_msgs' .msg files: of the sourced workspace, else as they come with SKD.

    Raises:
        UsageError: they are in neither place.
    """
    sourced = os.environ.get("AMENT_PREFIX_PATH") and next(_shared("skd_msgs"), None)
    return sourced or message_package().folder / "msg"


@functools.cache
def typestore() -> Typestore:
    """Return the type store with all messages that the graph uses."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for file in sorted(_definition_folder().glob("*.msg")):
        store.register(get_types_from_msg(file.read_text(encoding="utf-8"), f"skd_msgs/msg/{file.stem}"))
    return store


@functools.cache
def types_in(name: str, encoding: str, definition: bytes) -> Typestore:
    """Return a store with a message type as a file defines it, or as it is installed where the file does not say.

    Args:
        name: of the type.
        encoding: of the definition; all but ros2msg is taken as installed.
        definition: as the file has it; some recorders leave it empty, or leave out types that it uses.

    Raises:
        UsageError: the definition cannot be read, or a type is defined nowhere.
    """
    if not definition or encoding != "ros2msg":
        complete(typestore(), name)
        return typestore()
    try:
        types, store = get_types_from_msg(definition.decode(), name), get_typestore(Stores.EMPTY)
        left = [*types]
        while left:
            used = [one for _, kind in types[left.pop()][1] for one in _names(kind) if one not in types]
            for one in used:
                complete(typestore(), one)
                types[one] = typestore().fielddefs[one]
            left += used
        store.register(types)
    except Exception as error:  # its parser raises whatever the text makes it raise
        raise UsageError(f"the definition of {name:.80} cannot be read ({type(error).__name__})") from error
    return store


def complete(store: Typestore, name: str) -> None:
    """Add a type, and those that it uses, to a store that may not know them.

    Raises:
        UsageError: a definition is nowhere.
    """
    if name in store.fielddefs:
        return
    package, _, kind = name.split("/")
    files = (folder / f"{kind}.msg" for folder in _shared(package))
    file = next((file for file in files if file.is_file()), None)
    if file is None:
        raise UsageError(f"{name} cannot be recorded: there is no {kind}.msg in the share folder of {package}")
    found = get_types_from_msg(file.read_text(encoding="utf-8"), name)
    for _, kind_of_field in found[name][1]:
        for used in _names(kind_of_field):
            complete(store, used)
    store.register(found)


def _names(field: Any) -> Iterator[str]:
    """Yield the message types that a field of a definition is of."""
    kind, what = field
    if kind == Nodetype.NAME:
        yield what
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from _names(what[0])


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
