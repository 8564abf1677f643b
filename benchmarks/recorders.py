"""Ways to write a recording as other recorders do, honest ones and broken ones; see `mutations.py`.

What honest recorders write is to change no number. Each has the signature of a `mutators.Mutator`.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bag_forge import TYPES, Sent, base, store
from mcap.opcode import Opcode
from mcap.writer import CompressionType, IndexType, Writer
from mutators import HEAD, Mutator, pick, records, written

METADATA = "metadata.yaml"
_OTHER_TYPES = (("x/msg/Y", "ros2msg", b"float64 z\n"), ("z", "jsonschema", b"{}"), ("", "", b""))


def _definition(name: str) -> str:
    return store.generate_msgdef(name, ros_version=2)[0]


def odd_chunks(original: Path, file: Path, _s: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator) -> str:
    """Put in a chunk that is empty, holds a chunk, ends within a record, or is packed by what nobody knows."""
    content = original.read_bytes()
    _, start, _ = pick(rng, records(content)[1:-3])
    how = pick(rng, ["empty", "nested", "cut", "unknown"])
    inside = {
        "empty": b"",
        "nested": HEAD.pack(Opcode.CHUNK, 40) + bytes(40),
        "cut": HEAD.pack(Opcode.MESSAGE, 99) + bytes(22),
        "unknown": bytes(31),
    }[how]
    name = b"snappy" if how == "unknown" else b""
    body = struct.pack("<QQQII", 0, 0, len(inside), zlib.crc32(inside), len(name)) + name
    body += struct.pack("<Q", len(inside)) + inside
    file.write_bytes(content[:start] + HEAD.pack(Opcode.CHUNK, len(body)) + body + content[start:])
    return f"{how} chunk at {start}"


def odd_records(original: Path, file: Path, _s: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator) -> str:
    """Put in a record that later versions may have, with any content, or one whose length is beyond the file."""
    content = original.read_bytes()
    _, start, _ = pick(rng, records(content)[1:-3])
    opcode = int(pick(rng, [0x10, 0x7F, 0x80, 0xFF, Opcode.ATTACHMENT, Opcode.METADATA]))
    size, said = int(rng.integers(64)), 0
    said = int(pick(rng, [size, size, size + 1, 2**63]))
    file.write_bytes(content[:start] + HEAD.pack(opcode, said) + rng.bytes(size) + content[start:])
    return f"a record {opcode:#x} of {size} bytes that says {said}"


def odd_recorder(
    _original: Path, file: Path, sent: Sequence[Sent], _options: dict[str, Any], rng: np.random.Generator
) -> str:
    """Write it as an honest recorder with habits of its own: packing, chunks, channels, and what else it writes."""
    packing, size = pick(rng, list(CompressionType)), int(pick(rng, [1, 300, 4096, 2**20]))
    channels_each, noise = int(pick(rng, [1, 1, 2, 5])), bool(rng.random() < 0.5)
    with file.open("wb") as stream:
        writer = Writer(
            stream,
            chunk_size=size,
            compression=packing,
            use_chunking=bool(rng.random() < 0.8),
            index_types=pick(rng, [IndexType.ALL, IndexType.NONE]),
            repeat_channels=bool(rng.random() < 0.5),
            repeat_schemas=bool(rng.random() < 0.5),
            use_statistics=bool(rng.random() < 0.5),
            use_summary_offsets=bool(rng.random() < 0.5),
            enable_data_crcs=bool(rng.random() < 0.5),
        )
        writer.start(profile=pick(rng, ["", "ros2", "x"]), library="")
        others = [writer.register_channel(f"/other{n}", "x", writer.register_schema(*of)) for n, of in
                  enumerate(_OTHER_TYPES)]  # fmt: skip
        others.append(writer.register_channel("/without/a/type", "json", 0))
        channels: dict[tuple[str, int], int] = {}
        for number, one in enumerate(sent):
            name, turn = TYPES[base(one.topic)], number % channels_each
            if (one.topic, turn) not in channels:
                schema = writer.register_schema(name, "ros2msg", _definition(name).encode())
                channels[one.topic, turn] = writer.register_channel(one.topic, "cdr", schema, {"turn": str(turn)})
            writer.add_message(channels[one.topic, turn], one.time, one.bytes(), int(rng.integers(2**40)), 0)
            if noise:
                writer.add_message(pick(rng, others), 2**63, rng.bytes(int(rng.integers(50))), 0, 0)
            if noise and number % 9 == 0:
                writer.add_attachment(number, number, "a.bin", "x", rng.bytes(99))
                writer.add_metadata("m", {"k": str(number)})
        writer.finish()
    return f"packed by {packing.name}, chunks of {size}, {channels_each} channels a topic, noise {noise}"


_EDITS = (
    lambda text: f"# of another kind\n{text}\n",
    lambda text: text.replace("float64", "float32", 1),
    lambda text: text.replace("float64", "int64", 1),
    lambda text: text.replace("uint64", "uint32", 1),
    lambda text: "\n".join(reversed(text.splitlines()[:9])),
    lambda _text: "",
    lambda text: text.replace("seed", "sead").replace("pose", "pase"),
)


def another_type(
    _original: Path, file: Path, sent: Sequence[Sent], _options: dict[str, Any], rng: np.random.Generator
) -> str:
    """Send some messages of a topic on a channel of its own, whose type is defined in another way."""
    topic, edit = pick(rng, sorted({one.topic for one in sent})), int(rng.integers(len(_EDITS)))
    name, share = TYPES[base(topic)], float(pick(rng, [0.5, 1.0]))
    with file.open("wb") as stream:
        writer = Writer(stream, enable_data_crcs=True)
        writer.start(profile="ros2", library="")
        channels = {
            one: writer.register_channel(
                one, "cdr", writer.register_schema(TYPES[base(one)], "ros2msg", _definition(TYPES[base(one)]).encode())
            )
            for one in sorted({message.topic for message in sent})
        }
        other = writer.register_channel(
            topic, "cdr", writer.register_schema(name, "ros2msg", _EDITS[edit](_definition(name)).encode())
        )
        for number, one in enumerate(sent):
            channel = other if one.topic == topic and rng.random() < share else channels[one.topic]
            writer.add_message(channel, one.time, one.bytes(), one.time, number)
        writer.finish()
    return f"{share:.0%} of {topic} of a type defined by edit {edit}"


def wrong_checksum(
    original: Path, file: Path, _sent: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator
) -> str:
    """Give a chunk, the data section or the summary another checksum, or none; what comes later is made right."""
    content = bytearray(original.read_bytes())
    where = [one for one in records(bytes(content)) if one[0] in (Opcode.CHUNK, Opcode.DATA_END, Opcode.FOOTER)]
    opcode, start, end = pick(rng, where)
    place = {Opcode.CHUNK: start + HEAD.size + 24, Opcode.DATA_END: start + HEAD.size}.get(opcode, end - 4)
    new = int(pick(rng, [0, 1, int(rng.integers(2**32))]))
    content[place : place + 4] = struct.pack("<I", new)
    again = opcode == Opcode.CHUNK and rng.random() < 0.5
    if again:
        _, data_end, _ = next(one for one in where if one[0] == Opcode.DATA_END)
        content[data_end + HEAD.size : data_end + HEAD.size + 4] = struct.pack("<I", zlib.crc32(content[:data_end]))
    file.write_bytes(content)
    return f"checksum of a {Opcode(opcode).name}: {new}" + (", that of the data section anew" if again else "")


def other_metadata(
    original: Path, file: Path, sent: Sequence[Sent], options: dict[str, Any], rng: np.random.Generator
) -> str:
    """Write metadata.yaml beside a recording that it contradicts."""
    kept = list(sent)
    how = pick(rng, ["right", "an episode fewer", "a message fewer", "another file", "no file", "no YAML", "clock"])
    if how == "an episode fewer":
        ends = [place for place, one in enumerate(kept) if base(one.topic).endswith("result")]
        kept = kept[: (ends[-2] if len(ends) > 1 else 0) + 1]
    elif how == "a message fewer":
        del kept[int(rng.integers(len(kept)))]
    written(file, kept, options)
    names = {"another file": f"  - {file.name}\n  - bag_1.mcap\n", "no file": ""}.get(how, f"  - {file.name}\n")
    counts = Counter(one.topic for one in sent)
    topics = "".join(
        f"  - topic_metadata:\n      name: {topic}\n      type: {TYPES[base(topic)]}\n    message_count: {count}\n"
        for topic, count in sorted(counts.items())
    )
    start = 0 if how == "clock" else sent[0].time
    about = (
        f"version: 9\nstorage_identifier: mcap\nstarting_time:\n  nanoseconds_since_epoch: {start}\n"
        f"message_count: {len(sent)}\ntopics_with_message_count:\n{topics}relative_file_paths:\n{names}"
    )
    text = "rosbag2_bagfile_information:\n" + "".join(f"  {line}\n" for line in about.splitlines())
    (file.parent / METADATA).write_text("[" if how == "no YAML" else text, encoding="utf-8")
    return f"{METADATA}: {how}, of {original.name}"


RECORDERS: dict[str, Mutator] = {
    "odd recorders": odd_recorder,
    "types defined otherwise": another_type,
    "wrong checksums": wrong_checksum,
    "metadata.yaml": other_metadata,
}
