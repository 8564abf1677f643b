"""Reads episodes back from MCAP files, written by SKD or by `ros2 bag record`.

Nothing is assumed about the order of messages, how they are split over chunks and files, or what else was recorded; and
everything that can be recomputed is checked.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap.records import Channel
from skd_sim.errors import UsageError
from skd_sim.options.options import shared_options
from skd_sim.world.episode import EpisodeLog, Outcome

from skd_evaluator.bags.acceptance import Damage, Found, accept
from skd_evaluator.bags.inventory import find_recordings
from skd_evaluator.bags.mcap_file import Condition, Received, read_messages, shortened
from skd_evaluator.bags.recording import (
    ADVERSARY,
    CAR,
    EPISODE,
    RESULT,
    EpisodeName,
    RecordedEpisode,
    Recording,
)
from skd_evaluator.bags.types import types_in, typestore

_TOPICS = {
    CAR: "nav_msgs/msg/Odometry",
    ADVERSARY: "nav_msgs/msg/Odometry",
    EPISODE: "skd_msgs/msg/Episode",
    RESULT: "skd_msgs/msg/EpisodeResult",
}


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
        for file in files:
            _read_file(file, graphs, damage)
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


def _read_file(file: Path, graphs: dict[str, Recording], damage: Damage) -> None:
    """Add the messages of a file to the graphs, by namespace; damaged ones are refused or left out.

    Raises:
        UsageError: it is no recording of this version's messages, or something must not be left out.
    """
    count, condition = 0, Condition()
    senders: set[str] = set()
    for message in read_messages(file, lambda topic: _namespace_and_role(topic) is not None, condition):
        topic = message.channel.topic
        namespace, role = _namespace_and_role(topic) or ("", "")
        _check_type(message, role, file)
        try:
            content = message.decoded()
        except UsageError as error:
            damage.leave_out(f"{file}: {error}")
            continue
        try:
            graphs.setdefault(namespace, Recording()).add(role, content, message)
        except UsageError as error:
            raise UsageError(f"{file}: {error}") from error
        except ValueError as error:
            damage.leave_out(f"{file}: a message on {topic} is not valid ({shortened(str(error))})")
        count += 1
        if role == RESULT and topic not in senders and _publishers(message.channel) > 1:
            senders.add(topic)
            damage.warn(
                f"{file}: {_publishers(message.channel)} nodes published {topic}, which is the simulator's alone"
            )
    if condition.refuted:
        raise UsageError(f"{file}: {condition.damage[-1]}, and it has no other: leave the file out")
    if condition.unchecked:
        damage.unchecked.append(file)
    for what in condition.damage:
        damage.leave_out(f"{file}: {what}" + (f" ({count} messages of it count)" if damage.skip else ""))


@functools.cache
def _namespace_and_role(topic: str) -> tuple[str, str] | None:
    """Return the namespace of a topic of SKD's, and which of them it is."""
    name = next((name for name in _TOPICS if topic.endswith(name)), None)
    return None if name is None else (topic.removesuffix(name), name)


def _publishers(channel: Channel) -> int:
    """Return how many publishers of a topic the recorder saw: it keeps what each offered, as a list in YAML."""
    return str(channel.metadata.get("offered_qos_profiles", "")).count("reliability:")


def _check_type(message: Received, role: str, file: Path) -> None:
    """Refuse a message of another type than its topic's, or of another version of SKD."""
    schema = message.schema
    if schema.name != _TOPICS[role]:
        raise UsageError(f"{file}: {message.channel.topic} has type {shortened(schema.name)}, expected {_TOPICS[role]}")
    if schema.name.startswith("skd_msgs/"):
        theirs = types_in(schema.name, schema.encoding, schema.data).fielddefs[schema.name]
        if theirs != typestore().fielddefs[schema.name]:
            raise UsageError(f"{file}: {schema.name} was recorded by another version of SKD; replay it with that one")
