"""Files that are damaged, cut short, or none of MCAP: what of them counts is right, and the rest is named."""

import struct
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_forge import Sent, campaign_messages, write_mcap
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import CompressionType
from skd_evaluator.bags.checks import Damage
from skd_evaluator.bags.read import read_bags
from skd_sim import EpisodeLog, UsageError

Write = Callable[..., Path]
Replay = Callable[..., Any]
_WRITTEN: dict[str, dict[str, Any]] = {
    "small chunks": {"chunk_size": 2048},
    "zstd": {"chunk_size": 2048, "compression": CompressionType.ZSTD},
    "lz4": {"chunk_size": 2048, "compression": CompressionType.LZ4},
    "no chunks": {"chunks": False},
}


def records(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of each record of a file."""
    place = 8
    while place < len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, place)
        yield opcode, place, place + 9 + length
        place += 9 + length


def chunks(content: bytes) -> list[tuple[int, int]]:
    return [(start, end) for opcode, start, end in records(content) if opcode == Opcode.CHUNK]


def contents(path: Path, damage: Damage | None = None) -> dict[int, tuple[bytes, ...]] | None:
    """Return what the episodes of a recording say, by their numbers; None where it is refused."""
    try:
        found = [one.log for one in read_bags([path], damage).episodes]
    except UsageError:
        return None
    return {
        log.episode.episode_id: (log.adversary.tobytes(), log.car.tobytes(), np.float64(log.impact_time).tobytes())
        for log in found
    }


@pytest.fixture(scope="module")
def whole(logs: list[EpisodeLog], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, bytes]]:
    """A folder to write into, and a right recording as one of several writers has it."""
    folder, sent = tmp_path_factory.mktemp("files"), campaign_messages(logs)

    @cache
    def written(name: str) -> tuple[Path, bytes]:
        file = write_mcap(folder / f"{name}.mcap", [message for one in sent for message in one], **_WRITTEN[name])
        return file.with_name(f"{name} damaged.mcap"), file.read_bytes()

    return written


@pytest.mark.parametrize("name", _WRITTEN)
@settings(max_examples=30, deadline=None)
@given(st.data())
def test_whatever_is_damaged_is_noticed_or_says_the_same(whole, name, data):
    """A bit anywhere, or a part that is cut out: no episode is ever another one, and none is lost without a word."""
    file, content = whole(name)
    file.write_bytes(content)
    right = contents(file)
    assert right
    begin = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        length = data.draw(st.integers(1, len(content) - begin))
        damaged = content[:begin] + content[begin + length :]
    else:
        flipped = content[begin] ^ 1 << data.draw(st.integers(0, 7))
        damaged = content[:begin] + bytes([flipped]) + content[begin + 1 :]
    file.write_bytes(damaged)
    assert contents(file) in (None, right)
    damage = Damage(skip=True)
    kept = contents(file, damage)
    if kept is not None:
        assert kept.items() <= right.items()
        assert kept == right or damage.left_out


def test_files_without_checksums_are_named(sent: list[list[Sent]], recorded: Write, replay: Replay) -> None:
    with_them, without = replay(recorded(sent)), replay(recorded(sent, "bare", checksums=False))
    assert without.episodes == with_them.episodes
    (line,) = without.lines
    assert "1 file without checksums" in line
    assert "bare.mcap" in line


def test_a_damaged_chunk_is_left_out_and_what_it_held_is_named(logs, sent, recorded, refused, replay):
    """A chunk an episode, so that one is lost and no other."""
    file = recorded(sent, chunk_size=max(sum(len(one.bytes()) + 40 for one in each) for each in sent))
    content = bytearray(file.read_bytes())
    start, end = chunks(bytes(content))[3]
    content[(start + end) // 2] ^= 4
    file.write_bytes(content)
    assert "chunk 4 does not match its checksum" in refused(file)
    done = replay(file, "--skip-damaged")
    assert "chunk 4 does not match its checksum" in done.result["left_out"][0]
    kept = set(np.load(done.path / "episodes.npz")["episode_id"].tolist())
    assert kept < {log.episode.episode_id for log in logs} | {0}
    assert done.result["left_out"][1:] or "left out, no result" in done.err


def test_a_cut_recording_is_salvaged_up_to_its_last_whole_chunk(sent, recorded, refused, replay):
    """One chunk a message: the episodes before the cut count, and no number is changed without a word."""
    file = recorded(sent, chunk_size=1)
    content = file.read_bytes()
    ends = [end for _, end in chunks(content)]
    lengths = np.cumsum([len(one) for one in sent])
    for count in (5, 3):
        expected = replay(recorded(sent[:count], "expected"))
        file.write_bytes(content[: ends[lengths[count - 1] - 1] + 40])
        assert f"{file}: it is cut short" in refused(file)
        done = replay(file, "--skip-damaged")
        assert done.episodes == expected.episodes
        assert "cut short" in done.result["left_out"][0]
        assert "what is whole of it is read" in done.result["left_out"][0]
