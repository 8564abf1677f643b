"""Writes an episode as a rosbag2 folder: MCAP storage, metadata.yaml, type hashes."""

from __future__ import annotations

import functools
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer

from skd_evaluator.bags.types import typestore

_BAG_VERSION: Literal[9] = 9  # the metadata format of ROS 2 Jazzy


class RecordedMessage(NamedTuple):
    """One message: topic, message class, stamp (ns of simulation time), CDR bytes, and whether its topic is latched."""

    topic: str
    kind: type
    stamp: int
    data: bytes
    latched: bool = False


def _latched() -> Qos:
    """Return what the publisher of a latched topic offered; of others, it is what `ros2 bag play` offers by itself."""
    unlimited = QosTime(9223372036, 854775807)  # rmw's infinite duration
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=unlimited,
        lifespan=unlimited,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=unlimited,
        avoid_ros_namespace_conventions=False,
    )


def type_name(kind: type) -> str:
    """Return a message class's ROS name, as in `nav_msgs/msg/Odometry`."""
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


@functools.cache
def _definition(name: str) -> tuple[str, str]:
    """Return a type's definition, as a bag holds it, and its hash."""
    store = typestore()
    return store.generate_msgdef(name, ros_version=2)[0], store.hash_rihs01(name)


def write_bag(path: Path, messages: Sequence[RecordedMessage]) -> None:
    """Write messages, in order of their stamps, as a bag that appears whole or not at all.

    Args:
        path: of the bag's folder; it must not exist.
        messages: what to write; log times are the simulation's.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(prefix=".bag.", dir=path.parent))
    try:
        connections: dict[str, Connection] = {}
        with Writer(temporary / path.name, version=_BAG_VERSION, storage_plugin=StoragePlugin.MCAP) as writer:
            for message in sorted(messages, key=lambda message: message.stamp):
                if message.topic not in connections:
                    name = type_name(message.kind)
                    text, digest = _definition(name)
                    connections[message.topic] = writer.add_connection(
                        message.topic,
                        name,
                        msgdef=text,
                        rihs01=digest,
                        offered_qos_profiles=[_latched()] if message.latched else [],
                    )
                writer.write(connections[message.topic], message.stamp, message.data)
        (temporary / path.name).rename(path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
