"""Ways to damage or forge a recording or an episodes.npz, each drawn at random; see `mutations.py`."""

from __future__ import annotations

import dataclasses
import io
import math
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from bag_forge import RESULT, Sent, changed, write_mcap
from mcap.opcode import Opcode

Mutator = Callable[[Path, Path, Sequence[Sent], dict[str, Any], np.random.Generator], str]
"""Writes a mutation: (right file, file to write, its messages, how it was written, draws) → what was done."""

HEAD = struct.Struct("<BQ")
WORDS = ["", "paper", "frechet", "deformation", "none", "é"]  # that a text may become
EXTREME = (math.nan, math.inf, -math.inf, 1e300, -1e9, -1.0, 0.0, 1e6, 5e-324)

# Fields of records: name and struct format, up to the first one of variable length (format specification).
_FIELDS: dict[int, tuple[str, ...]] = {
    Opcode.HEADER: ("I",),
    Opcode.FOOTER: ("Q", "Q", "I"),
    Opcode.SCHEMA: ("H", "I"),
    Opcode.CHANNEL: ("H", "H", "I"),
    Opcode.MESSAGE: ("H", "I", "Q", "Q", "I", "I", "I"),
    Opcode.CHUNK: ("Q", "Q", "Q", "I", "I"),
    Opcode.MESSAGE_INDEX: ("H", "I", "Q", "Q"),
    Opcode.CHUNK_INDEX: ("Q", "Q", "Q", "Q", "I", "H", "Q"),
    Opcode.STATISTICS: ("Q", "H", "I", "I", "I", "I", "Q", "Q", "I", "H", "Q"),
    Opcode.SUMMARY_OFFSET: ("B", "Q", "Q"),
    Opcode.DATA_END: ("I",),
}


def records(content: bytes) -> list[tuple[int, int, int]]:
    """Return opcode, start and end of every record, heads included."""
    place, found = 8, []
    while place < len(content) - 8:
        opcode, length = HEAD.unpack_from(content, place)
        found.append((opcode, place, place + HEAD.size + length))
        place += HEAD.size + length
    return found


def pick(rng: np.random.Generator, things: Sequence[Any]) -> Any:
    """Draw one of some things."""
    return things[int(rng.integers(len(things)))]


def flip(original: Path, file: Path, _sent: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator) -> str:
    """Flip one to three bits anywhere."""
    content = bytearray(original.read_bytes())
    places = rng.integers(0, len(content), int(rng.integers(1, 4))).tolist()
    for place in places:
        content[place] ^= 1 << int(rng.integers(8))
    file.write_bytes(content)
    return f"bits flipped in bytes {places}"


def field(original: Path, file: Path, _sent: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator) -> str:
    """Flip a bit of a field of a record: of its head, or of one of the fields that every such record has."""
    content = bytearray(original.read_bytes())
    all_records = records(bytes(content))
    opcode = pick(rng, sorted({record[0] for record in all_records}))
    _, start, _ = pick(rng, [record for record in all_records if record[0] == opcode])
    formats = ("B", "Q", *_FIELDS.get(opcode, ()))
    chosen = int(rng.integers(len(formats)))
    offset = struct.calcsize("<" + "".join(formats[:chosen]))
    bit = int(rng.integers(8 * struct.calcsize(formats[chosen])))
    content[min(start + offset + bit // 8, len(content) - 1)] ^= 1 << bit % 8
    file.write_bytes(content)
    return f"bit {bit} of field {chosen} of a {Opcode(opcode).name}"


def truncate(original: Path, file: Path, _sent: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator) -> str:
    """Cut at the end of a record, or a few bytes before or after."""
    content = original.read_bytes()
    _, start, end = pick(rng, records(content))
    cut = pick(rng, [start, end, end - 1, start + 1, start + 9, (start + end) // 2])
    file.write_bytes(content[: min(cut, len(content) - 1)])
    return f"cut to {cut} of {len(content)} bytes"


def shuffle_records(
    original: Path, file: Path, _sent: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator
) -> str:
    """Drop, double, or exchange records as they stand in the file."""
    content = original.read_bytes()
    parts = [content[start:end] for _, start, end in records(content)]
    chosen, other = (int(place) for place in rng.integers(0, len(parts), 2))
    how = pick(rng, ("dropped", "doubled", "exchanged"))
    if how == "dropped":
        parts[chosen] = b""
    elif how == "doubled":
        parts.insert(other, parts[chosen])
    else:
        parts[chosen], parts[other] = parts[other], parts[chosen]
    file.write_bytes(content[:8] + b"".join(parts) + content[-8:])
    return f"record {chosen} {how} ({other})"


def index(original: Path, file: Path, _sent: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator) -> str:
    """Change or drop a record of the summary, and make the summary's checksum right again."""
    content = original.read_bytes()
    every = records(content)
    end_of_data = next(end for opcode, _, end in every if opcode == Opcode.DATA_END)
    parts = [content[start:end] for _, start, end in every if start >= end_of_data]
    chosen = int(rng.integers(len(parts)))
    if chosen < len(parts) - 1 and rng.random() < 0.4:
        what = f"record {chosen} of the summary dropped"
        parts[chosen] = b""
    else:
        damaged = bytearray(parts[chosen])
        place = int(rng.integers(HEAD.size, len(damaged)))
        damaged[place] ^= 1 << int(rng.integers(8))
        parts[chosen] = bytes(damaged)
        what = f"byte {place} of record {chosen} of the summary"
    summary = b"".join(parts)
    checksum = zlib.crc32(summary[:-4])
    file.write_bytes(content[:end_of_data] + summary[:-4] + struct.pack("<I", checksum) + content[-8:])
    return what


def _leaves(content: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and value of every number and text in a message, and of every list."""
    for one in dataclasses.fields(content):
        value = getattr(content, one.name)
        where = f"{path}{one.name}"
        if one.name.startswith("__"):
            continue
        if dataclasses.is_dataclass(value):
            yield from _leaves(value, f"{where}.")
        else:
            yield where, value


def _flipped(value: Any, rng: np.random.Generator) -> Any:
    """Return a value of which a bit, a character or a member is another."""
    if isinstance(value, float):
        bits = struct.unpack("<Q", struct.pack("<d", value))[0] ^ 1 << int(rng.integers(64))
        return struct.unpack("<d", struct.pack("<Q", bits))[0]
    if isinstance(value, (int, np.integer)):
        return int(value) ^ 1 << int(rng.integers(31))
    if isinstance(value, str):
        place = int(rng.integers(len(value) + 1))
        return value[:place] + pick(rng, ["", "x", "9", "\x00", "[", "φ", "-"]) + value[place + 1 :]
    if isinstance(value, np.ndarray):
        return value
    members = list(value)
    if not members or rng.random() < 0.3:
        return [*members, *members[:1]] if rng.random() < 0.5 else members[:-1]
    place = int(rng.integers(len(members)))
    axis = pick(rng, ["x", "y"])
    members[place] = changed(members[place], axis, _flipped(getattr(members[place], axis), rng))
    return members


def written(file: Path, sent: Sequence[Sent], options: dict[str, Any]) -> None:
    write_mcap(file, sent, **options)


def _fits(value: Any, like: Any) -> Any:
    """Return a value that the field of a message can hold."""
    return abs(int(value)) % 256 if isinstance(like, (int, np.integer)) else value


def forge(_original: Path, file: Path, sent: Sequence[Sent], options: dict[str, Any], rng: np.random.Generator) -> str:
    """Flip a bit of any field of any message, and write it all anew, with right checksums."""
    for _ in range(100):
        topic = pick(rng, sorted({message.topic for message in sent}))
        place = pick(rng, [number for number, message in enumerate(sent) if message.topic == topic])
        where, value = pick(rng, list(_leaves(sent[place].content)))
        new = _flipped(value, rng)
        if isinstance(value, (int, np.integer)) and ("outcome" in where or "mode" in where):
            new %= 256
        other = dataclasses.replace(sent[place], content=changed(sent[place].content, where, new))
        try:
            written(file, [*sent[:place], other, *sent[place + 1 :]], options)
        except Exception:  # what no message can hold, nobody can forge
            continue
        return f"{where} of message {place} on {topic}: {str(value)[:40]} → {str(new)[:40]}"
    raise RuntimeError("nothing could be forged")


_TELLING = {
    "/skd/episode": ("multiplier", "maximum_distance", "safe_trajectory_time_step", "mode", "seed", "episode_id"),
    "/skd/episode_result": ("outcome", "ticks", "impact_time", "impact_speed", "episode_id"),
    "/ego/odometry": ("pose.pose.position.x", "pose.pose.position.y", "twist.twist.linear.x"),
    "/adversary/odometry": ("pose.pose.position.x", "pose.pose.position.y"),
}


def extreme(
    _original: Path, file: Path, sent: Sequence[Sent], options: dict[str, Any], rng: np.random.Generator
) -> str:
    """Give a number that matters a value that cannot be, or hardly, with right checksums."""
    topic = pick(rng, sorted(_TELLING))
    place = pick(rng, [number for number, message in enumerate(sent) if message.topic == topic])
    where = pick(rng, _TELLING[topic])
    value: Any = sent[place].content
    for name in where.split("."):
        value = getattr(value, name)
    whole = isinstance(value, (int, np.integer))
    high = 255 if where in ("mode", "outcome") else 2**31
    new = int(rng.integers(high)) if whole else pick(rng, EXTREME)
    other = dataclasses.replace(sent[place], content=changed(sent[place].content, where, new))
    written(file, [*sent[:place], other, *sent[place + 1 :]], options)
    return f"{where} of message {place} on {topic}: {value} → {new}"


def messages(
    _original: Path, file: Path, sent: Sequence[Sent], options: dict[str, Any], rng: np.random.Generator
) -> str:
    """Drop or double a message, exchange the contents of two, or put all in another order."""
    how = pick(rng, ("dropped", "doubled", "exchanged", "shuffled", "contradicted"))
    place = int(rng.integers(len(sent)))
    new = list(sent)
    if how == "dropped":
        del new[place]
    elif how == "doubled":
        new.append(sent[place])
    elif how == "shuffled":
        new = [sent[number] for number in rng.permutation(len(sent))]
    elif how == "exchanged":
        other = pick(rng, [number for number, one in enumerate(sent) if one.topic == sent[place].topic])
        header = sent[place].content.header
        new[place] = dataclasses.replace(sent[place], content=changed(sent[other].content, "header", header))
    else:
        place = pick(rng, [number for number, one in enumerate(sent) if one.topic == RESULT])
        said = changed(sent[place].content, "impact_speed", 3.25)
        new.insert(pick(rng, [place, place + 1]), dataclasses.replace(sent[place], content=said))
    written(file, new, options)
    return f"message {place} on {sent[place].topic} {how}"


def bomb(original: Path, file: Path, _sent: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator) -> str:
    """Put in a chunk that unpacks to much, says that it does, or holds countless records."""
    content = original.read_bytes()
    start = next(begin for opcode, begin, _ in records(content) if opcode != Opcode.HEADER)
    size = int(pick(rng, [2**26, 2**27, 2**28]))
    filling = pick(rng, [bytes(1), HEAD.pack(Opcode.MESSAGE, 22) + bytes(22), HEAD.pack(Opcode.SCHEMA, 14) + bytes(14)])
    packed = zstandard.ZstdCompressor(level=1).compress(filling * (size // len(filling)))
    said = int(pick(rng, [size // len(filling) * len(filling), 2**62, 100]))
    body = struct.pack("<QQQII", 0, 0, said, 0, 4) + b"zstd" + struct.pack("<Q", len(packed)) + packed
    times = int(pick(rng, [1, 4]))
    file.write_bytes(content[:start] + times * (HEAD.pack(Opcode.CHUNK, len(body)) + body) + content[start:])
    return f"{times} chunks of {size} bytes that say {said}"


def npz_member(original: Path, file: Path, _sent: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator) -> str:
    """Flip a bit in the head or the body of an array, and pack it anew, with right checksums."""
    with zipfile.ZipFile(original) as archive:
        members = {name: bytearray(archive.read(name)) for name in archive.namelist()}
    name = pick(rng, sorted(members))
    part = pick(rng, ["head", "body"])
    low, high = (0, 128) if part == "head" else (128, len(members[name]))
    place = int(rng.integers(low, max(low + 1, high)))
    if place < len(members[name]):
        members[name][place] ^= 1 << int(rng.integers(8))
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, content in members.items():
            archive.writestr(member, bytes(content))
    return f"byte {place} of {name}"


def npz_value(original: Path, file: Path, _sent: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator) -> str:
    """Give a member of an array another value, with right checksums."""
    with np.load(original) as archive:
        arrays = {name: archive[name].copy() for name in archive.files}
    name = pick(rng, sorted(arrays))
    array = arrays[name]
    place = int(rng.integers(array.size))
    kind = array.dtype.kind
    if kind in "US":
        value: Any = pick(rng, WORDS)
    elif kind == "b":
        value = not array.reshape(-1)[place]
    else:
        value = pick(rng, EXTREME) if kind == "f" else int(rng.integers(np.iinfo(array.dtype).max))
    array.reshape(-1)[place : place + 1] = value
    np.savez_compressed(file, **arrays)
    return f"{name}[{place}] = {value}"


def npz_shape(original: Path, file: Path, _sent: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator) -> str:
    """Drop, retype, shorten, turn or unpack an array beyond all bounds."""
    with np.load(original) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = pick(rng, sorted(arrays))
    how = pick(rng, ["dropped", "retyped", "shortened", "reversed", "bomb"])
    array = arrays.pop(name)
    if how == "retyped":
        others = ["U4", "S4", "S40"] if array.dtype.kind in "US" else [np.float32, np.int32, np.complex64, "U4", bool]
        array = array.astype(pick(rng, others))
    elif how == "shortened":
        array = np.ravel(array)[:-1]
    elif how == "reversed":
        array = array[::-1].copy() if array.ndim else np.array([array])
    if how not in ("dropped", "bomb"):
        arrays[name] = array
    np.savez_compressed(file, **arrays)
    if how == "bomb":
        head = io.BytesIO()
        np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (10**8, 2)})
        with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            archive.writestr(f"{name}.npy", head.getvalue() + bytes(2**28))
    return f"{name} {how}"


def npz_cut(original: Path, file: Path, _sent: Sequence[Sent], _o: dict[str, Any], rng: np.random.Generator) -> str:
    """Cut anywhere."""
    content = original.read_bytes()
    cut = int(rng.integers(len(content)))
    file.write_bytes(content[:cut])
    return f"cut to {cut} of {len(content)} bytes"


MUTATORS: dict[str, Mutator] = {
    "bits": flip,
    "fields of records": field,
    "truncation": truncate,
    "records dropped, doubled, exchanged": shuffle_records,
    "index, checksum right": index,
    "fields of messages, checksums right": forge,
    "extreme values, checksums right": extreme,
    "messages dropped, doubled, exchanged": messages,
    "bombs": bomb,
}
NPZ_MUTATORS: dict[str, Mutator] = {
    "bits": flip,
    "truncation": npz_cut,
    "arrays, checksums right": npz_member,
    "values, checksums right": npz_value,
    "shapes, types, bombs": npz_shape,
}
