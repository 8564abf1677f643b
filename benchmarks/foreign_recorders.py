"""Ways in which other tools write what a recording says: bytes, files, texts and times; see `mutations.py`.

What says the same is to change no number; what says two things at once is to be refused. Each has the signature of a
`mutators.Mutator`.
"""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from bag_forge import ADVERSARY, CAR, EPISODE, RESULT, TYPES, Sent, base, changed, store, write_mcap
from forging import each
from mutators import Mutator, pick
from recorders import METADATA


def other_bytes(
    _original: Path, file: Path, sent: Sequence[Sent], options: dict[str, Any], rng: np.random.Generator
) -> str:
    """Serialize the messages of a topic, or every third message, in another way, or only say so."""
    how = pick(rng, ["big endian", "parameter list", "CDR 2", "option bits", "bytes after it", "a byte too few"])
    topic = pick(rng, [*sorted({one.topic for one in sent}), ""])
    numbers = itertools.count()

    def encode(one: Sent) -> bytes:
        data = one.bytes()
        if one.topic != topic and (topic or next(numbers) % 3):
            return data
        if how == "big endian":
            return bytes(store.serialize_cdr(one.content, TYPES[base(one.topic)], little_endian=False))
        if how in ("parameter list", "CDR 2"):
            return bytes([0, 3 if how == "parameter list" else 7]) + data[2:]
        if how == "option bits":
            return data[:2] + b"\x00\x03" + data[4:]
        return data[:-1] if how == "a byte too few" else data + bytes(int(rng.integers(1, 9)))

    write_mcap(file, sent, **options, encode=encode)
    return f"{topic or 'every third message'}: {how}"


def split_files(
    _original: Path, file: Path, sent: Sequence[Sent], options: dict[str, Any], rng: np.random.Generator
) -> str:
    """Write a bag that a recorder split into files, at any message; its metadata names all of them, or not."""
    cuts = sorted({0, len(sent), *rng.integers(1, len(sent), int(rng.integers(1, 4))).tolist()})
    parts = [list(sent[low:high]) for low, high in itertools.pairwise(cuts)]
    how = pick(rng, ["right", "right", "the other way round", "the last not named", "one gone", "no metadata"])
    latched = [one for one in sent if one.topic == EPISODE] if rng.random() < 0.3 else []
    names = [file.name, *(f"{file.stem}_{number}.mcap" for number in range(1, len(parts)))]
    for name, part in zip(names, parts, strict=True):
        write_mcap(file.parent / name, [*latched, *part], **options)
    if how == "one gone":
        (file.parent / names[-1]).unlink()
    named = {"the other way round": names[::-1], "the last not named": names[:-1]}.get(how, names)
    paths = "".join(f"  - {name}\n" for name in named)
    count = len(sent) + len(latched) * len(parts)
    about = f"version: 9\nstorage_identifier: mcap\nmessage_count: {count}\nrelative_file_paths:\n{paths}"
    text = "rosbag2_bagfile_information:\n" + "".join(f"  {line}\n" for line in about.splitlines())
    if how != "no metadata":
        (file.parent / METADATA).write_text(text, encoding="utf-8")
    return f"in {len(parts)} files, {how}, {'specifications repeated in each' if latched else 'as they came'}"


def other_json(
    _original: Path, file: Path, sent: Sequence[Sent], options: dict[str, Any], rng: np.random.Generator
) -> str:
    """Write the scenario or the options of all episodes as another serializer does, or with something said twice."""
    field = pick(rng, ["scenario", "options"])
    how = pick(rng, ["sorted", "spaces", "exponents", "escapes", "twice, ours last", "twice, ours first", "no JSON"])

    def edit(one: Any) -> Any:
        text = getattr(one, field)
        data = json.loads(text or "{}")
        key = next((name for name, value in data.items() if isinstance(value, (int, float))), None)
        if how == "sorted":
            text = json.dumps(dict(sorted(data.items(), reverse=True)))
        elif how == "spaces":
            text = json.dumps(data, indent=3, separators=(" ,\t", " :\n"))
        elif how == "exponents":
            text = text.replace("0.3,", "3e-1,").replace("1.0,", "1.00E+0,")
        elif how == "escapes":
            text = "".join(f"\\u{ord(one):04x}" if one.isalpha() and rng.random() < 0.1 else one for one in text)
            text = text if _parses(text, data) else json.dumps(data)
        elif how == "no JSON":
            text = text + pick(rng, ["{", "\x00", " // right", ",", "\ufeff"])
        elif key is not None:
            other = json.dumps({key: data[key] * 2 + 1})[1:-1]
            text = f"{{{other}, {text[1:]}" if how.endswith("last") else f"{text[:-1]}, {other}}}"
        return changed(one, field, text)

    write_mcap(file, each(sent, [EPISODE], edit), **options)
    return f"{field} of all: {how}"


def _parses(text: str, data: Any) -> bool:
    try:
        return bool(json.loads(text) == data)
    except ValueError:
        return False


def other_rate(
    _original: Path, file: Path, sent: Sequence[Sent], options: dict[str, Any], rng: np.random.Generator
) -> str:
    """Record odometry of a stack that publishes more often than there are ticks, or before and after episodes, too."""
    how, new = pick(rng, ["between", "before", "after", "between, the first again late"]), list[Sent]()
    for one in sent:
        if one.topic in (CAR, ADVERSARY) and how.startswith("between"):
            new.append(_stamped(one, int(pick(rng, [1, 10**6, 10**8])), float(pick(rng, [0.0, 0.1, 3.0]))))
        new.append(one)
        if one.topic == EPISODE and how == "before":
            new += [_stamped(state, -(10**6), 1.0) for state in sent if state.topic in (CAR, ADVERSARY)][:2]
        if one.topic == RESULT and how == "after":
            new += [_stamped(state, 10**12, 1.0) for state in sent if state.topic in (CAR, ADVERSARY)][-2:]
    if how.endswith("late"):
        new.append(next(one for one in sent if one.topic == CAR))
    write_mcap(file, new, **options)
    return f"more states, {how}"


def _stamped(one: Sent, later: int, away: float) -> Sent:
    """Return a state at another stamp and place."""
    stamp = one.content.header.stamp
    total = stamp.sec * 10**9 + stamp.nanosec + later
    content = changed(one.content, "header.stamp.sec", total // 10**9)
    content = changed(content, "header.stamp.nanosec", total % 10**9)
    content = changed(content, "pose.pose.position.y", content.pose.pose.position.y + away)
    return dataclasses.replace(one, content=content)


FOREIGN: dict[str, Mutator] = {
    "other bytes of messages": other_bytes,
    "a bag in several files": split_files,
    "other JSON": other_json,
    "more states than ticks": other_rate,
}
