"""Writes an episode as a rosbag2 folder: MCAP storage, metadata.yaml, type hashes, as `ros2 bag record` of Jazzy does.

The file is written by mcap's own writer, with the checksums of the format: rosbags' takes longer than a whole episode,
for its YAML, and leaves them out.
"""

from __future__ import annotations

import functools
import io
import shutil
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from mcap.writer import CompressionType, Writer

from skd_evaluator.bags.messages import complete, typestore
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
