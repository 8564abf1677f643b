"""What was heard during an episode, kept as it came, and the bag that it is written to.

A bag holds all that figures follow from, and what RViz and Foxglove show: transforms and the car's looks as they were
heard, of any sender, and markers and figures, which are made when the bag is written.

It is a rosbag2 folder as `ros2 bag record` of Jazzy writes it: MCAP storage, metadata.yaml, type hashes. The file is
written by mcap's own writer, with the checksums of the format: rosbags' takes longer than a whole episode, for its
YAML, and leaves them out.
"""

from __future__ import annotations

import functools
import io
import math
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.writer import CompressionType, Writer
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from skd_msgs.msg import EpisodeResult
from skd_sim.ros.support import Topic
from skd_sim.ros.to_messages import header
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, tick_stamp
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from skd_evaluator.assessment.plan import follows_other_trajectory, model_digest
from skd_evaluator.assessment.run.episodes import EpisodeEnd, EpisodeKey, Samples
from skd_evaluator.bags.messages import complete, typestore
from skd_evaluator.ros.visualization import episode_markers, recorded_figures
from skd_evaluator.version import version

_BAG_VERSION = 9  # the metadata format of ROS 2 Jazzy
_ROS_DISTRO = "jazzy"
_CHUNK = 1 << 20


class RecordedMessage(NamedTuple):
    """One message: topic, message class, stamp (ns of simulation time), CDR bytes, and whether its topic is latched."""

    topic: str
    kind: type
    stamp: int
    data: bytes
    latched: bool = False


def type_name(kind: type) -> str:
    """Return a message class's ROS name, as in `nav_msgs/msg/Odometry`."""
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


def write_bag(path: Path, messages: Sequence[RecordedMessage]) -> None:
    """Write messages, in order of their stamps, as a bag that appears whole or not at all.

    Args:
        path: folder of the bag; it must not exist.
        messages: what to write, at least one; log times are the simulation's.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    ordered = sorted(messages, key=lambda message: message.stamp)
    file = f"{path.name}.mcap"
    about = _information(file, ordered)
    temporary = Path(tempfile.mkdtemp(prefix=".bag.", dir=path.parent))
    try:
        (temporary / file).write_bytes(_mcap(ordered, _yaml(about)))
        (temporary / "metadata.yaml").write_text(_yaml({"rosbag2_bagfile_information": about}), encoding="utf-8")
        temporary.chmod(0o755)
        temporary.rename(path)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def _mcap(messages: Sequence[RecordedMessage], about: str) -> bytes:
    output = io.BytesIO()
    writer = Writer(output, chunk_size=_CHUNK, compression=CompressionType.NONE, enable_data_crcs=True)
    writer.start(profile="ros2", library=f"skd {version()}")
    schemas: dict[str, int] = {}
    channels: dict[str, int] = {}
    for sequence, message in enumerate(messages):
        if message.topic not in channels:
            name = type_name(message.kind)
            text, digest = _definition(name)
            if name not in schemas:
                schemas[name] = writer.register_schema(name, "ros2msg", text.encode())
            channels[message.topic] = writer.register_channel(
                message.topic,
                "cdr",
                schemas[name],
                {"offered_qos_profiles": _yaml([_offered(message.latched)]), "topic_type_hash": digest},
            )
        writer.add_message(
            channels[message.topic], log_time=message.stamp, publish_time=message.stamp, sequence=sequence,
            data=message.data,
        )  # fmt: skip
    writer.add_metadata("rosbag2", {"serialized_metadata": about, "ROS_DISTRO": _ROS_DISTRO})
    writer.finish()  # type: ignore[no-untyped-call]
    return output.getvalue()


def _information(file: str, messages: Sequence[RecordedMessage]) -> dict[str, Any]:
    """Return what rosbag2 calls the information on a bag file, as plain data."""
    counts = Counter(message.topic for message in messages)
    first = {message.topic: message for message in reversed(messages)}
    topics = []
    for topic, count in sorted(counts.items()):
        name = type_name(first[topic].kind)
        about = {
            "name": topic,
            "type": name,
            "serialization_format": "cdr",
            "offered_qos_profiles": [_offered(first[topic].latched)],
            "type_description_hash": _definition(name)[1],
        }
        topics.append({"topic_metadata": about, "message_count": count})

    def span() -> dict[str, Any]:
        start, end = messages[0].stamp, messages[-1].stamp
        return {
            "duration": {"nanoseconds": end - start},
            "starting_time": {"nanoseconds_since_epoch": start},
            "message_count": len(messages),
        }

    return {
        "version": _BAG_VERSION,
        "storage_identifier": "mcap",
        **span(),
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file],
        "files": [{"path": file, **span()}],
        "custom_data": None,
        "ros_distro": _ROS_DISTRO,
    }


def _offered(latched: bool) -> dict[str, Any]:
    """Return the quality of service that publishers of a topic offer: `ros2 bag play` offers the same."""
    forever = {"sec": 9223372036, "nsec": 854775807}  # rmw's infinite duration
    times = ("deadline", "lifespan", "liveliness_lease_duration")
    return {
        "history": "keep_last",
        "depth": 100,
        "reliability": "reliable",
        "durability": "transient_local" if latched else "volatile",  # of markers each adds to those before
        "liveliness": "automatic",
        **{name: dict(forever) for name in times},
        "avoid_ros_namespace_conventions": False,
    }


def _yaml(data: Any) -> str:
    return str(yaml.dump(data, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper), sort_keys=False))


@functools.cache
def _definition(name: str) -> tuple[str, str]:
    """Return a type's definition, as a bag holds it, and its hash."""
    store = typestore()
    complete(store, name)
    return store.generate_msgdef(name, ros_version=2)[0], store.hash_rihs01(name)


SETTLE = 0.05
"""s for which a recording waits, after the result, for what other topics still have on the way."""
_STATES = 2.0  # s in which all states come that this process has published itself
_LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""As tf2 listens: each of several nodes may have latched transforms of its own."""


def recorded_name(node: Node, topic: str) -> str:
    """Return the name of a topic in a bag: in the node's namespace, but not remapped, so that any bag is read alike."""
    return str(expand_topic_name(topic, node.get_name(), node.get_namespace()))


def bag_name(episode: EpisodeSpec) -> str:
    """Return the name of an episode's bag, another one for each episode of a campaign."""
    number, mode = episode.episode_id, episode.mode.name.lower()
    if episode.mode != Mode.KAMIKAZE:
        return f"{mode}_{number:016x}"
    model = model_digest(number, episode.car_model)
    # Those of several objectives have the same ids, and so have those by which a car is learned.
    return "_".join(filter(None, (mode, episode.objective, f"{number:016x}", model)))


class BagRecorder:
    """Records one episode after another, each to a bag of its own."""

    def __init__(
        self,
        node: Node,
        folder: Path,
        drive_topic: str,
        walk_topic: str,
        *,
        own_world: bool,
        patience: float,
        say: Callable[[str], None],
    ) -> None:
        """Record nothing yet, and listen to what the car looks like.

        Args:
            node: node that listens to the topics.
            folder: folder for the bags.
            drive_topic: topic of the car's commands, as it is recorded.
            walk_topic: topic of the adversary's commands, as it is recorded.
            own_world: whether the simulator is SKD's own, and so publishes transforms.
            patience: how long to wait, after a result, for the commands of all ticks, wall seconds.
            say: called with a line about a recording that lacks something.
        """
        self._node, self._folder, self._say = node, folder, say
        self._drive_topic, self._walk_topic = drive_topic, walk_topic
        self._own_world, self._patience = own_world, patience
        self._written: set[str] = set()
        self._messages: list[RecordedMessage] = []
        self._key = EpisodeKey("", -1, 0)
        self._now = self._latest_end = 0
        self._fixed: dict[str, Any] = {}
        self._description: String | None = None
        node.create_subscription(TFMessage, Topic.TF_STATIC, self._on_fixed_transforms, _LATCHED)
        node.create_subscription(String, Topic.ROBOT_DESCRIPTION, self._on_description, _LATCHED)

    def _on_fixed_transforms(self, message: TFMessage) -> None:
        self._fixed |= {transform.child_frame_id: transform for transform in message.transforms}

    def _on_description(self, message: String) -> None:
        self._description = message

    def takes(self, episode: EpisodeSpec) -> bool:
        """Whether the bag of an episode is kept: thousands of ways that were tried would bury those that count.

        Nor is one that is run again, to see whether it goes as before.
        """
        return not follows_other_trajectory(episode) and bag_name(episode) not in self._written

    def begin(self, key: EpisodeKey, latest_end: int) -> None:
        """Forget the last episode.

        Args:
            key: key of the episode to come.
            latest_end: stamp of the last tick that the episode can have, ns.
        """
        self._messages.clear()
        self._key, self._latest_end = key, latest_end
        self._now = key.start

    def keep(self, topic: str, kind: type, stamp: int, data: bytes) -> None:
        """Keep a message, unless it is of an earlier episode.

        Args:
            topic: topic that the message came on, as it is recorded.
            kind: type of the message.
            stamp: time stamp of the message, ns; 0 where it has none.
            data: the message's bytes as they came.
        """
        log_time = self._log_time(topic, stamp)
        if log_time is not None:
            self._messages.append(RecordedMessage(topic, kind, log_time, data))

    def _log_time(self, topic: str, stamp: int) -> int | None:
        """Return the simulation time (ns) of a message to record; none for one of an earlier episode."""
        if topic in (self._drive_topic, self._walk_topic, Topic.TF):
            if not 0 < stamp <= self._latest_end:  # others may have sent it: not stamped, or by another clock
                return self._now
            return stamp if stamp >= self._key.start else None
        if stamp < self._key.start:
            return None
        self._now = max(self._now, stamp)
        return stamp

    def settle(self, episode: EpisodeSpec, result: EpisodeEnd, listen: Callable[[float], None]) -> None:
        """Wait, a moment at most, for messages that topics without common order deliver after the result.

        Args:
            episode: the episode that is over.
            result: its result.
            listen: takes messages that come within this time, s.
        """
        step, begin = episode.scenario.time_step, time.monotonic()
        last, decided = (tick_stamp(self._key.start, tick, step) for tick in (result.ticks, result.ticks - 1))
        states, of_adversary, applied = (
            recorded_name(self._node, one) for one in (Topic.EGO_ODOMETRY, Topic.ADVERSARY_ODOMETRY, Topic.COMMAND)
        )
        needed = {states: last, of_adversary: last, Topic.CLOCK: last, self._walk_topic: decided}
        while True:  # messages of a topic come in order: where the last one is there, all are
            latest: dict[str, int] = {}
            answered = decided
            for kept in self._messages:
                latest[kept.topic] = max(latest.get(kept.topic, 0), kept.stamp)
                if kept.topic == states and kept.stamp < last:  # another one followed, so the car has answered it
                    answered = max(answered, kept.stamp)
            needed[self._drive_topic] = answered
            if self._own_world:  # another simulator need not publish any
                needed |= {Topic.TF: last, applied: answered}
            lacking = [topic for topic, stamp in needed.items() if latest.get(topic, 0) < stamp]
            patience = max(self._patience, _STATES) if {states, of_adversary} & set(lacking) else self._patience
            if not lacking or time.monotonic() > begin + patience:
                return
            listen(SETTLE)

    def write(
        self, specification: Any, log: EpisodeLog, samples: Samples, result: EpisodeEnd, end: int, *, unsaid: bool
    ) -> None:
        """Write the bag of the episode.

        Args:
            specification: the message that began the episode.
            log: what happened in the episode.
            samples: all states of it that have come.
            result: the episode's result, as published.
            end: stamp of the episode's end, ns.
            unsaid: whether the simulator has not said how the episode ended, so that the evaluator has to.

        Raises:
            OSError: it cannot be written.
        """
        heard = {kept.topic for kept in self._messages}
        lacking = [topic for topic in (self._drive_topic, self._walk_topic) if topic not in heard]
        if result.ticks and lacking:
            self._say(f"the bag of episode {log.episode.episode_id} holds no message on {' and '.join(lacking)}")
        messages = list(self._messages)
        if unsaid:
            messages = [kept for kept in messages if kept.kind is not EpisodeResult]
            messages.append(self._own(Topic.EPISODE_RESULT, self._ending(specification, result, end), end))
        name, start = bag_name(log.episode), self._key.start
        self._written.add(name)
        latched = {Topic.EPISODE: specification, Topic.ROBOT_DESCRIPTION: self._description}
        if self._fixed:
            latched[Topic.TF_STATIC] = TFMessage(transforms=list(self._fixed.values()))
        shown = [self._own(topic, one, start, latched=True) for topic, one in latched.items() if one is not None]
        for stamp in sorted({start, *samples.car}):
            markers = episode_markers(log.episode, samples, stamp, fixed=stamp == start)
            shown.append(self._own(Topic.MARKERS, markers, stamp, latched=True))
        shown += [self._own(*figure) for figure in recorded_figures(log, start)]
        write_bag(self._folder / name, [*shown, *messages])

    def _ending(self, specification: Any, result: EpisodeEnd, end: int) -> EpisodeResult:
        return EpisodeResult(
            header=header(end, specification.header.frame_id),
            campaign=self._key.campaign,
            episode_id=self._key.episode_id,
            start=specification.header.stamp,
            outcome=int(result.outcome),
            ticks=result.ticks,
            impact_time=math.nan,
            impact_speed=math.nan,
            reason=result.reason,
        )

    def _own(self, topic: str, message: Any, stamp: int, *, latched: bool = False) -> RecordedMessage:
        data = serialize_message(message)
        return RecordedMessage(recorded_name(self._node, topic), type(message), stamp, data, latched=latched)
