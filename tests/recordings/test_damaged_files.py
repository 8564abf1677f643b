"""Files that are damaged, cut, made to burst, or no files at all."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from bag_forge import RESULT, Sent, forged
from common import run_skd
from mcap.opcode import Opcode
from mcap.writer import CompressionType
from mutators import HEAD, records
from recordings_support import MOST_MEMORY, MOST_TIME
from skd_sim.episode.episode import EpisodeLog
from watched import Ended, watched

Write = Callable[..., Path]
Refused = Callable[..., str]
Replay = Callable[..., Any]


def chunks(content: bytes) -> list[tuple[int, int]]:
    return [(start, end) for opcode, start, end in records(content) if opcode == Opcode.CHUNK]


def watched_replay(*arguments: object) -> Ended:
    """`skd replay` in a child, which may take so much and no more."""
    ended = watched(lambda: run_skd("replay", *arguments), seconds=MOST_TIME)
    assert ended.in_time, "it hangs"
    assert ended.traceback == ""
    assert ended.memory < MOST_MEMORY
    return ended


def assert_refuses(ended: Ended) -> None:
    assert ended.value == 2, ended
    assert ended.said.count("\n") == 1, ended.said


# --- checksums


@pytest.mark.parametrize("compression", list(CompressionType))
def test_any_flipped_bit_is_noticed(
    sent: list[list[Sent]], recorded: Write, refused: Refused, replay: Replay, compression: CompressionType
) -> None:
    file = recorded(sent, compression=compression, chunk_size=4096)
    whole, right = file.read_bytes(), replay(file)
    assert right.err == ""
    rng = np.random.default_rng(1)
    for place in rng.integers(8, len(whole), 25).tolist():
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        assert str(file) in refused(file)


def test_a_flipped_bit_without_chunks(
    sent: list[list[Sent]], recorded: Write, refused: Refused, replay: Replay
) -> None:
    """Only the data section has a checksum then, which comes last: nothing may count before."""
    file = recorded(sent, chunks=False)
    content = bytearray(file.read_bytes())
    messages = [(start, end) for opcode, start, end in records(bytes(content)) if opcode == Opcode.MESSAGE]
    content[messages[5][1] - 300] ^= 1
    file.write_bytes(content)
    assert "do not match their checksum" in refused(file)
    done = replay(file, "--skip-damaged")
    assert done.code == 2
    assert "do not match their checksum" in done.lines[0]
    assert "no kamikaze or replay episode" in done.lines[-1]


def test_files_without_checksums_are_named(sent: list[list[Sent]], recorded: Write, replay: Replay) -> None:
    with_them, without = replay(recorded(sent)), replay(recorded(sent, "bare", checksums=False))
    assert without.episodes == with_them.episodes
    (line,) = without.lines
    assert "1 file without checksums" in line
    assert "bare.mcap" in line


def test_a_damaged_chunk_is_left_out_and_what_it_held_is_named(
    logs: list[EpisodeLog], sent: list[list[Sent]], recorded: Write, refused: Refused, replay: Replay
) -> None:
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


def test_an_index_that_hides_a_chunk(sent: list[list[Sent]], recorded: Write, replay: Replay, refused: Refused) -> None:
    """It is not used; with its checksum made right again, the numbers are the same."""
    file = recorded(sent, chunk_size=4096)
    right = replay(file)
    content = file.read_bytes()
    indices = [(start, end) for opcode, start, end in records(content) if opcode == Opcode.CHUNK_INDEX]
    start, end = indices[2]
    # The summary's checksum reaches to the footer's, and the offsets in between are of no interest.
    body = content[:start] + content[end:]
    (footer,) = (begin for opcode, begin, _ in records(body) if opcode == Opcode.FOOTER)
    (begin,) = struct.unpack_from("<Q", body, footer + HEAD.size)
    checked = body[begin : footer + HEAD.size + 16]
    file.write_bytes(body[: footer + HEAD.size + 16] + struct.pack("<I", zlib.crc32(checked)) + body[-8:])
    assert replay(file).episodes == right.episodes
    file.write_bytes(body)
    assert "summary does not match its checksum" in refused(file)


def test_a_chunk_that_is_gone_is_missed(
    sent: list[list[Sent]], recorded: Write, refused: Refused, replay: Replay
) -> None:
    """Also without checksums: the statistics count the messages."""
    file = recorded(sent, chunk_size=4096, checksums=False)
    content = file.read_bytes()
    start, end = chunks(content)[4]
    (_, _, after) = next(record for record in records(content) if record[1] >= end and record[0] == Opcode.CHUNK)
    following = next(begin for opcode, begin, _ in records(content) if begin >= end and opcode == Opcode.CHUNK)
    assert after > following
    file.write_bytes(content[:start] + content[following:])
    line = refused(file)
    assert "states of episode" in line or "messages" in line


# --- what is cut short


def test_a_cut_recording_is_salvaged_up_to_its_last_whole_chunk(
    logs: list[EpisodeLog], sent: list[list[Sent]], recorded: Write, refused: Refused, replay: Replay
) -> None:
    """One chunk an episode: those before the cut count, and no number is changed without a word."""
    file = recorded(sent, chunk_size=1)
    content = file.read_bytes()
    ends = [end for _, end in chunks(content)]
    # With a chunk a message, an episode ends with its last one.
    lengths = np.cumsum([len(one) for one in sent])
    for whole in (len(sent), 5, 3):
        expected = replay(recorded(sent[:whole], "expected"))
        for beyond in (0, 5, 40):
            end = ends[lengths[whole - 1] - 1] + beyond
            file.write_bytes(content[: min(end, len(content) - 1)])
            line = refused(file)
            assert "cut short" in line
            assert str(file) in line
            done = replay(file, "--skip-damaged")
            assert done.episodes == expected.episodes
            assert "cut short" in done.result["left_out"][0]
            assert "messages of it count" in done.err


def test_cut_anywhere(sent: list[list[Sent]], recorded: Write, refused: Refused, replay: Replay) -> None:
    file = recorded(sent, chunk_size=2048, compression=CompressionType.ZSTD)
    content = file.read_bytes()
    for end in [0, 1, 7, 8, 9, *np.linspace(10, len(content) - 1, 12, dtype=int).tolist()]:
        file.write_bytes(content[:end])
        assert str(file) in refused(file)
        done = replay(file, "--skip-damaged")
        assert done.code == 2 or done.result["left_out"]


# --- bombs


def test_a_flipped_bit_in_the_number_of_ticks_takes_no_memory(sent: list[list[Sent]], recorded: Write) -> None:
    for bit in (20, 24, 31):
        last = len(sent[0]) - 1
        ticks = sent[0][last].content.ticks | 1 << bit
        file = recorded([forged(sent[0], last, "ticks", ticks), *sent[1:]])
        ended = watched_replay(file)
        assert_refuses(ended)
        assert f"is said to have {ticks} ticks" in ended.said


def chunk(content: bytes, size: int, compression: bytes = b"zstd", checksum: int = 0) -> bytes:
    """A chunk record."""
    body = struct.pack("<QQQI", 0, 0, size, checksum)
    body += struct.pack("<I", len(compression)) + compression + struct.pack("<Q", len(content)) + content
    return HEAD.pack(Opcode.CHUNK, len(body)) + body


def spliced(file: Path, extra: bytes, times: int = 1) -> Path:
    """The file with something before the first chunk of its own."""
    content = file.read_bytes()
    start = chunks(content)[0][0]
    file.write_bytes(content[:start] + times * extra + content[start:])
    return file


def test_a_chunk_that_unpacks_to_gigabytes(sent: list[list[Sent]], recorded: Write) -> None:
    """Its episode used to be dropped without a word; whether it says its size or not."""
    bomb = zstandard.ZstdCompressor(level=1, write_content_size=True).compress(bytes(1500 * 2**20))
    assert len(bomb) < 200_000
    for content, size in ((bomb, 1500 * 2**20), (bomb, 1000), (bomb, 60 * 2**20)):
        ended = watched_replay(spliced(recorded(sent), chunk(content, size)))
        assert_refuses(ended)
        assert "chunk 1" in ended.said


def test_many_chunks_that_unpack_to_much(sent: list[list[Sent]], recorded: Write) -> None:
    piece = zstandard.compress(bytes(32 * 2**20))
    ended = watched_replay(spliced(recorded(sent), chunk(piece, 32 * 2**20), 400))
    assert_refuses(ended)


def test_many_tiny_messages(sent: list[list[Sent]], recorded: Write) -> None:
    record = HEAD.pack(Opcode.MESSAGE, 22) + struct.pack("<HIQQ", 77, 0, 0, 0)
    piece = record * (40 * 2**20 // len(record))
    ended = watched_replay(spliced(recorded(sent), chunk(zstandard.compress(piece), len(piece))))
    assert_refuses(ended)


def test_many_states(sent: list[list[Sent]], recorded: Write) -> None:
    """As many as fit into what a file may unpack to."""
    state = sent[0][1]
    data = bytearray(state.bytes())
    file = recorded([*sent[:1]])
    pieces = []
    for number in range(130_000):
        struct.pack_into("<ii", data, 4, 100_000 + number, 0)
        body = struct.pack("<HIQQ", 2, 0, 0, 0) + data
        pieces.append(HEAD.pack(Opcode.MESSAGE, len(body)) + body)
    content = file.read_bytes()
    end = chunks(content)[0][1]
    extra = b""
    for begin in range(0, len(pieces), 40_000):
        piece = b"".join(pieces[begin : begin + 40_000])
        extra += chunk(zstandard.compress(piece), len(piece))
    file.write_bytes(content[:end] + extra + content[end:])
    watched_replay(file)


@pytest.mark.parametrize("option", [(), ("--skip-damaged",)])
def test_a_pipe_is_no_recording(sent: list[list[Sent]], recorded: Write, tmp_path: Path, option: Sequence[str]) -> None:
    (tmp_path / "bags").mkdir()
    os.mkfifo(tmp_path / "bags" / "pipe.mcap")
    for path in (tmp_path / "bags", tmp_path / "bags" / "pipe.mcap"):
        ended = watched_replay(path, *option)
        assert ended.value == 2
        assert "regular file" in ended.said


def test_a_device_is_no_recording(tmp_path: Path, refused: Refused) -> None:
    (tmp_path / "zero.mcap").symlink_to("/dev/zero")
    assert "no regular file" in refused(tmp_path / "zero.mcap")


def test_a_folder_named_as_a_file_is_looked_into(
    sent: list[list[Sent]], recorded: Write, replay: Replay, tmp_path: Path
) -> None:
    """As `ros2 bag record -o night.mcap` makes it."""
    file = recorded(sent)
    (tmp_path / "night.mcap").mkdir()
    file.rename(tmp_path / "night.mcap" / "night_0.mcap")
    assert replay(tmp_path / "night.mcap").code == 0


def test_a_length_beyond_the_end_is_not_allocated(sent: list[list[Sent]], recorded: Write) -> None:
    file = recorded(sent, chunk_size=4096, checksums=False)
    content = file.read_bytes()
    for opcode, start, _ in records(content)[:12]:
        for bit in (31, 40, 63):
            damaged = bytearray(content)
            (length,) = struct.unpack_from("<Q", damaged, start + 1)
            struct.pack_into("<Q", damaged, start + 1, length | 1 << bit)
            file.write_bytes(damaged)
            ended = watched_replay(file)
            assert_refuses(ended)
            assert "cut short" in ended.said, opcode


def test_results_are_still_read_from_the_topic_they_are_on(sent: list[list[Sent]]) -> None:
    """The tests above look for what they think they do."""
    assert sent[0][-1].topic == RESULT
