"""Reads episodes back from MCAP files, written by SKD or by `ros2 bag record`.

Nothing is assumed about the order of messages, how they are split over chunks and files, or what else was recorded; and
everything that can be recomputed is checked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel, Schema
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore
from skd_sim.choices.options import shared_options
from skd_sim.episode.episode import EpisodeLog, Outcome
from skd_sim.errors import UsageError

from skd_evaluator.bags.inventory import METADATA, find_recordings, messages_said
from skd_evaluator.bags.mcap_file import Condition, Received, read_messages
from skd_evaluator.bags.recording import (
    ADVERSARY,
    CAR,
    EPISODE,
    RESULT,
    EpisodeName,
    RecordedEpisode,
    Recording,
    shortened,
)
from skd_evaluator.bags.types import typestore, typestore_with
from skd_evaluator.bags.validation import Damage, Found, accept

_TOPICS = {
    CAR: "nav_msgs/msg/Odometry",
    ADVERSARY: "nav_msgs/msg/Odometry",
    EPISODE: "skd_msgs/msg/Episode",
    RESULT: "skd_msgs/msg/EpisodeResult",
}
_LATER = {
    "skd_msgs/msg/Episode": 3,
    "skd_msgs/msg/EpisodeResult": 4,
}  # fields at a message's end that its first recordings do not have
_LONGEST_DEFINITION = 64 * 1024  # bytes; ours have a few thousand
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True)
class Recorded:
    """What recordings hold.

    Attributes:
        episodes: the episodes that ended and count, each once, in the order of their names.
        unfinished: names of those that were announced and never ended, sorted.
        announced: names of all that were announced, whatever became of them.
        files: the files that were read.
    """

    episodes: list[RecordedEpisode]
    unfinished: list[EpisodeName]
    announced: set[EpisodeName]
    files: list[Path]


@dataclass(frozen=True)
class _Place:
    """An episode and the file in which it was found."""

    episode: RecordedEpisode
    where: str


def read_episodes(paths: Sequence[Path], damage: Damage | None = None) -> list[RecordedEpisode]:
    """Return all episodes that ended; otherwise like `read_bags`."""
    return read_bags(paths, damage).episodes


def read_bags(paths: Sequence[Path], damage: Damage | None = None) -> Recorded:
    """Return all episodes of recordings that can have happened.

    Args:
        paths: bag folders, .mcap files, or folders of them.
        damage: told what is left out and what is to be said; by default whatever is damaged is refused.

    Raises:
        UsageError: a file cannot be read, or something is damaged and must not be left out.
    """
    damage = damage or Damage()
    found: dict[EpisodeName, list[_Place]] = {}
    announced: set[EpisodeName] = set()
    recordings = find_recordings(paths, damage)
    for files in recordings:
        graphs: dict[str, Recording] = {}
        conditions = [Condition() for _ in files]
        for file, condition in zip(files, conditions, strict=True):
            _read_file(file, graphs, condition, damage)
            if condition.unchecked:
                damage.unchecked.append(file)
        _hold_against_count(files, conditions, damage)
        for recording in graphs.values():
            announced.update(recording.announced())
            for episode in recording.logs(str(files[0]), damage):
                found.setdefault(episode.name, []).append(_Place(episode, str(files[0])))
    places = [place for name in sorted(found) if (place := _one_of(found[name], damage)) is not None]
    counting = accept([Found(one.episode.log, one.where, one.episode.key.campaign) for one in places], damage)
    episodes = [places[index].episode for index in counting]
    return Recorded(
        episodes, sorted(announced - set(found)), announced, [file for files in recordings for file in files]
    )


def _hold_against_count(files: Sequence[Path], conditions: Sequence[Condition], damage: Damage) -> None:
    """See that a bag holds as many messages as its metadata says: else an episode may be missing, whole."""
    said, found = messages_said(files), sum(one.messages for one in conditions)
    if said not in (None, found) and not any(one.damage or one.refuted for one in conditions):
        damage.warn(
            f"{files[0].parent / METADATA}: counts {said} messages, its files hold {found}: some are missing, or were "
            "added"
        )


def _one_of(places: Sequence[_Place], damage: Damage) -> _Place | None:
    """Return the one recording of an episode that counts.

    The same one may be given twice, and an episode may have been run again after it was aborted.
    """
    completed = [one for one in places if one.episode.log.outcome != Outcome.ABORTED]
    first = (completed or places)[0]
    different = [one for one in completed or places if _content(one.episode.log) != _content(first.episode.log)]
    if different:
        number = first.episode.key.episode_id
        damage.leave_out(f"{first.where}: episode {number} is another one in {different[0].where}: give one of them")
        return None
    starts = {one.episode.key.start for one in completed}
    if len(starts) > 1:
        number = first.episode.key.episode_id
        damage.warn(f"{first.where}: episode {number} was run {len(starts)} times with the same result: it counts once")
    return first


def _content(log: EpisodeLog) -> tuple[object, ...]:
    """Return what two recordings of one episode have in common, to the last bit."""
    spec, phi = log.episode, log.episode.safe_trajectory
    return (
        log.outcome,
        *(array.tobytes() for array in (log.adversary, log.car)),
        *(value.hex() for value in (log.impact_time, log.impact_speed, spec.multiplier)),
        *(spec.mode, spec.seed, *shared_options(spec).values()),
        *(spec.scenario, None if phi is None else phi.positions.tobytes()),
    )


def _read_file(file: Path, graphs: dict[str, Recording], condition: Condition, damage: Damage) -> None:
    """Add the messages of a file to the graphs, by namespace; damaged ones are refused or left out."""
    try:
        if damage.skip:
            # The checksum of the whole comes last, and what it contradicts must not be used.
            first = Condition()
            for _ in read_messages(file, lambda _topic: False, first):
                pass
            if first.refuted:
                damage.leave_out(f"{file}: {first.damage[-1]}")
                return
        count = _gather(file, graphs, condition, damage)
    except UsageError as error:
        if not damage.skip:
            raise
        damage.leave_out(str(error))
        return
    for what in condition.damage:
        damage.leave_out(f"{file}: {what}" + (f" ({count} messages of it count)" if damage.skip else ""))


def _gather(file: Path, graphs: dict[str, Recording], condition: Condition, damage: Damage) -> int:
    """Add the messages of a file to the graphs, by namespace; return how many there were.

    Raises:
        UsageError: it is no recording of this version's messages, or something must not be left out.
    """
    store = typestore()
    places: dict[str, tuple[str, str] | None] = {}

    def place(topic: str) -> tuple[str, str] | None:
        if topic not in places:
            places[topic] = _namespace_and_role(topic)
        return places[topic]

    count = 0
    senders: set[str] = set()
    for message in read_messages(file, lambda topic: place(topic) is not None, condition):
        found = place(message.channel.topic)
        assert found is not None
        namespace, role = found
        try:
            decoder = _decoder_for(message, role, store)
        except UsageError as error:
            raise UsageError(f"{file}: {error}") from error
        name = message.schema.name
        try:
            content = decoder.deserialize_cdr(message.data, name)
            recording = graphs.setdefault(namespace, Recording())
            recording.add(role, content, message.data, lambda: bytes(decoder.serialize_cdr(content, name)))  # noqa: B023
        except UsageError as error:
            raise UsageError(f"{file}: {error}") from error
        except Exception as error:  # what damaged bytes are taken for can raise anything
            said = shortened(f"{type(error).__name__}: {error}")
            damage.leave_out(f"{file}: a message on {message.channel.topic} cannot be read ({said})")
        count += 1
        if role == RESULT and message.channel.topic not in senders and _publishers(message.channel) > 1:
            senders.add(message.channel.topic)
            damage.warn(
                f"{file}: {_publishers(message.channel)} nodes published {message.channel.topic}, which is the "
                "simulator's alone"
            )
    return count


def _namespace_and_role(topic: str) -> tuple[str, str] | None:
    """Return the namespace of a topic of SKD's, and which of them it is."""
    name = next((name for name in _TOPICS if topic.endswith(name)), None)
    return None if name is None else (topic.removesuffix(name), name)


def _publishers(channel: Channel) -> int:
    """Return how many publishers of a topic the recorder saw: it keeps what each offered, as a list in YAML."""
    return str(channel.metadata.get("offered_qos_profiles", "")).count("reliability:")


_SCHEMA_STORES: dict[bytes, Typestore] = {}


def _decoder_for(message: Received, role: str, store: Typestore) -> Typestore:
    """Return a store that knows a message's type.

    Raises:
        UsageError: the message is of another type than its topic's, or not as this version writes it.
    """
    schema, channel = message.schema, message.channel
    if schema.name != _TOPICS[role]:
        raise UsageError(f"{channel.topic} has type {shortened(schema.name)}, expected {_TOPICS[role]}")
    if channel.message_encoding != "cdr":
        raise UsageError(f"{channel.topic} is encoded as {shortened(channel.message_encoding)}, expected cdr")
    if message.data.startswith(_ZSTD_MAGIC):
        raise UsageError(
            "its messages are compressed one by one; unpack it with ros2 bag convert, or record with "
            "--storage-preset-profile zstd_fast instead of --compression-mode message"
        )
    return _decoder(store, schema)


def _decoder(store: Typestore, schema: Schema) -> Typestore:
    """Return a store that knows the type as the file defines it, where that differs from what is installed."""
    if not schema.name.startswith("skd_msgs/") or schema.encoding != "ros2msg":
        return store
    if len(schema.data) > _LONGEST_DEFINITION:
        raise UsageError(f"the definition of {schema.name} has {len(schema.data)} bytes, more than any of a message")
    if schema.data not in _SCHEMA_STORES:
        try:
            theirs = get_types_from_msg(schema.data.decode(), schema.name)[schema.name]
        except Exception as error:  # its parser raises whatever the text makes it raise
            raise UsageError(f"the definition of {schema.name} cannot be read") from error
        constants, fields = get_types_from_msg(_text(store, schema.name), schema.name)[schema.name]
        known = [fields[: len(fields) - later] for later in range(_LATER.get(schema.name, 0) + 1)]
        if theirs not in [(constants, earlier) for earlier in known]:
            raise UsageError(f"{schema.name} was recorded by another version of SKD; replay it with that one")
        _SCHEMA_STORES[schema.data] = store if theirs[1] == fields else typestore_with({schema.name: theirs})
    return _SCHEMA_STORES[schema.data]


def _text(store: Typestore, name: str) -> str:
    return store.generate_msgdef(name, ros_version=2)[0]
