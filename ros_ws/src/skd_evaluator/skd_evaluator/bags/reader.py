"""Reads episodes back from MCAP files, ours or recorded by `ros2 bag record`.

Nothing is assumed of the order of messages, of how they are split over chunks and files, or of what else was recorded.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.reader import McapReader, NonSeekingReader, make_reader
from mcap.records import Schema
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore
from skd_sim.episode import EpisodeLog, Outcome
from skd_sim.errors import UsageError
from skd_sim.from_messages import from_stamp, message_to_episode, odometry_to_car, odometry_to_pedestrian

from skd_evaluator.assembly import EpisodeKey, Result, Samples, aborted, result_from_message
from skd_evaluator.bags.types import typestore

_TOPICS = {
    "/ego/odometry": "nav_msgs/msg/Odometry",
    "/pedestrian/odometry": "nav_msgs/msg/Odometry",
    "/skd/episode": "skd_msgs/msg/Episode",
    "/skd/episode_result": "skd_msgs/msg/EpisodeResult",
}

_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True)
class RecordedEpisode:
    """An episode found in a bag: identity and log."""

    key: EpisodeKey
    log: EpisodeLog


@dataclass(frozen=True)
class Recorded:
    """What recordings hold.

    Attributes:
        episodes: those that ended, each once, in the order of their ids.
        unfinished: campaign and id of those that were announced and never ended, sorted.
    """

    episodes: list[RecordedEpisode]
    unfinished: list[tuple[str, int]]


@dataclass
class _Recording:
    """What one recording holds, by identity and by stamp."""

    samples: Samples
    episodes: dict[EpisodeKey, Any]
    results: dict[EpisodeKey, Result]


def find_recordings(paths: Sequence[Path]) -> list[list[Path]]:
    """Return the recordings below `paths`, each as its .mcap files: a bag folder's together, a lone file by itself.

    Raises:
        UsageError: a path does not exist, or holds no .mcap file.
    """
    recordings: dict[Path, list[Path]] = {}
    for path in paths:
        if not path.exists():
            raise UsageError(f"{path}: no such file or folder")
        files = sorted(path.rglob("*.mcap")) if path.is_dir() else [path]
        if not files and any(path.rglob("*.mcap.zstd")):
            raise UsageError(f"{path}: its files are compressed as a whole; unpack them first (zstd -d *.mcap.zstd)")
        if not files:
            raise UsageError(f"{path}: holds no .mcap file; record with the MCAP storage (ros2 bag record -s mcap)")
        for file in files:
            if file.suffix != ".mcap":
                raise UsageError(f"{file}: is no .mcap file; give a bag folder, an .mcap file, or a folder of them")
            bag = file.parent if (file.parent / "metadata.yaml").exists() else file
            if file not in recordings.setdefault(bag, []):
                recordings[bag].append(file)
    return list(recordings.values())


def read_episodes(paths: Sequence[Path]) -> list[RecordedEpisode]:
    """Return all episodes that ended; errors as `read_bags`."""
    return read_bags(paths).episodes


def read_bags(paths: Sequence[Path]) -> Recorded:
    """Return all episodes of recordings.

    Raises:
        UsageError: a file cannot be read, or holds an episode with states missing.
    """
    found: dict[EpisodeKey, RecordedEpisode] = {}
    announced: set[tuple[str, int]] = set()
    for files in find_recordings(paths):
        recording = _Recording(Samples(), {}, {})
        for file in files:
            try:
                _read_file(file, recording)
            except UsageError as error:
                raise UsageError(f"{file}: {error}") from error
            except Exception as error:  # a damaged file can make those who read it raise anything
                raise UsageError(f"{file}: not a complete MCAP recording of the graph ({_reason(error)})") from error
        announced.update((key.campaign, key.episode_id) for key in recording.episodes)
        for episode in _episodes(recording, files[0]):
            found.setdefault(episode.key, episode)
    ended = {(key.campaign, key.episode_id) for key in found}
    ordered = sorted(found, key=lambda key: (key.campaign, key.episode_id, key.start))
    return Recorded([found[key] for key in ordered], sorted(announced - ended))


def _reason(error: Exception) -> str:
    """Return an error in a few words on one line."""
    said = " ".join(f"{type(error).__name__}: {error}".split()).rstrip(": ")
    return said if len(said) <= 120 else f"{said[:120]}…"


def _episodes(recording: _Recording, file: Path) -> Iterator[RecordedEpisode]:
    for key, result in recording.results.items():
        if key not in recording.episodes:
            raise UsageError(
                f"{file}: has the result of episode {key.episode_id} but not the episode: record /skd/episode"
            )
        message = recording.episodes[key]
        try:
            episode = message_to_episode(message)
        except ValueError as error:
            raise UsageError(f"{file}: episode {key.episode_id} is not valid ({_reason(error)})") from error
        missing = recording.samples.missing(episode, key.start, result)
        if missing and result.outcome != Outcome.ABORTED:
            raise UsageError(
                f"{file}: {missing} states of episode {key.episode_id} are missing: was recording begun too late, "
                "or were /ego/odometry and /pedestrian/odometry not recorded?"
            )
        log = aborted(episode, result.reason) if missing else recording.samples.log(episode, key.start, result)
        yield RecordedEpisode(key, log)


def _read_file(file: Path, recording: _Recording) -> None:
    store = typestore()
    with file.open("rb") as stream:
        reader: McapReader = make_reader(stream)
        summary = reader.get_summary()
        wanted = None
        if summary is not None and not summary.channels:
            # Written without a list of its channels, which reading by index needs: read it from end to end.
            stream.seek(0)
            reader = NonSeekingReader(stream)
        elif summary is not None and summary.channels:
            wanted = [channel.topic for channel in summary.channels.values() if _role(channel.topic) is not None]
            if not wanted:
                return
        for schema, channel, message in reader.iter_messages(topics=wanted, log_time_order=False):
            role = _role(channel.topic)
            if role is None or schema is None:
                continue
            if schema.name != _TOPICS[role]:
                raise UsageError(f"{channel.topic} has type {schema.name}, expected {_TOPICS[role]}")
            if message.data.startswith(_ZSTD_MAGIC):
                raise UsageError(
                    "its messages are compressed one by one; unpack it with ros2 bag convert, or record with "
                    "--storage-preset-profile zstd_fast instead of --compression-mode message"
                )
            _add(role, _decoder(store, schema).deserialize_cdr(message.data, schema.name), recording)


def _role(topic: str) -> str | None:
    """Return which of our topics this is, in whatever namespace the graph ran."""
    return next((role for role in _TOPICS if topic.endswith(role)), None)


_SCHEMA_STORES: dict[bytes, Typestore] = {}


def _decoder(store: Typestore, schema: Schema) -> Typestore:
    """Return a store that knows the type as the file defines it, where that differs from what is installed."""
    if not schema.name.startswith("skd_msgs/") or schema.encoding != "ros2msg":
        return store
    if schema.data not in _SCHEMA_STORES:
        theirs = get_types_from_msg(schema.data.decode(), schema.name)
        if theirs[schema.name] == get_types_from_msg(_text(store, schema.name), schema.name)[schema.name]:
            _SCHEMA_STORES[schema.data] = store
        else:
            raise UsageError(f"{schema.name} was recorded by another version of SKD; replay it with that one")
    return _SCHEMA_STORES[schema.data]


def _text(store: Typestore, name: str) -> str:
    return store.generate_msgdef(name, ros_version=2)[0]


def _add(role: str, message: Any, recording: _Recording) -> None:
    if role == "/skd/episode":
        key = EpisodeKey(message.campaign, int(message.episode_id), from_stamp(message.header.stamp))
        recording.episodes[key] = message
    elif role == "/skd/episode_result":
        key = EpisodeKey(message.campaign, int(message.episode_id), from_stamp(message.start))
        recording.results[key] = result_from_message(message)
    elif role == "/ego/odometry":
        car = odometry_to_car(message)
        recording.samples.add_car(from_stamp(message.header.stamp), car.x, car.y, car.speed)
    else:
        pedestrian = odometry_to_pedestrian(message)
        recording.samples.add_pedestrian(from_stamp(message.header.stamp), pedestrian.x, pedestrian.y)
