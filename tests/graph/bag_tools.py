"""Rewriting bags as other recorders would have written them, with the mcap package's own reader and writer."""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer


@dataclass(frozen=True)
class Item:
    """One message with its channel and schema."""

    topic: str
    type_name: str
    definition: str
    log_time: int
    data: bytes


def read_items(files: Iterable[Path]) -> list[Item]:
    """Every message of some files, in file order."""
    items = []
    for file in files:
        with file.open("rb") as stream:
            for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                assert schema is not None
                items.append(
                    Item(channel.topic, schema.name, schema.data.decode(), message.log_time, bytes(message.data))
                )
    return items


def write_items(
    file: Path,
    items: Sequence[Item],
    *,
    compression: CompressionType = CompressionType.NONE,
    chunk_size: int = 4096,
    chunks: bool = True,
    summary: bool = True,
) -> None:
    """Write messages in the order given, as `ros2 bag record` would name their channels."""
    with file.open("wb") as stream:
        writer = Writer(
            stream,
            chunk_size=chunk_size,
            compression=compression,
            use_chunking=chunks,
            use_statistics=summary,
            use_summary_offsets=summary,
            repeat_channels=summary,
            repeat_schemas=summary,
        )
        writer.start(profile="ros2", library="libmcap 1.1.0")
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for sequence, item in enumerate(items):
            if item.type_name not in schemas:
                schemas[item.type_name] = writer.register_schema(item.type_name, "ros2msg", item.definition.encode())
            if item.topic not in channels:
                channels[item.topic] = writer.register_channel(item.topic, "cdr", schemas[item.type_name])
            writer.add_message(channels[item.topic], item.log_time, item.data, item.log_time, sequence)
        writer.finish()


def shuffled(items: Sequence[Item], seed: int = 0) -> list[Item]:
    """The same messages in another order, log times included: what they mean is in their own stamps."""
    mixed = list(items)
    random.Random(seed).shuffle(mixed)
    return [
        Item(i.topic, i.type_name, i.definition, 1_700_000_000_000_000_000 + n, i.data) for n, i in enumerate(mixed)
    ]
