"""The graph as this process sees it, and what the others see of this process.

Endpoints come from DDS discovery itself. Which node an endpoint belongs to is ROS's own addition: every
participant publishes its nodes and their endpoints on ``ros_discovery_info``.
"""

from __future__ import annotations

import contextlib
import threading
from dataclasses import dataclass
from typing import Any

from cyclonedds.builtin import (
    BuiltinDataReader,
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import InstanceState
from cyclonedds.qos import Policy, Qos

from rosless import names, qos_dds, wire
from rosless.endpoint_info import TopicEndpointInfo, TopicEndpointTypeEnum, TypeHash
from rosless.interfaces import cdr, definitions
from rosless.interfaces.classes import message_class
from rosless.interfaces.idl import idl_struct, ros_type_name
from rosless.participant import Participant

_INFO_TOPIC = "ros_discovery_info"
_INFO_TYPE = "rmw_dds_common/msg/ParticipantEntitiesInfo"
_UNKNOWN_NODE = ("_NODE_NAME_UNKNOWN_", "_NODE_NAMESPACE_UNKNOWN_")
_BATCH = 256


@dataclass(frozen=True)
class Endpoint:
    """A discovered writer or reader."""

    gid: bytes
    topic: str  # as on the wire: rt/…
    type_name: str  # as on the wire: pkg::msg::dds_::Name_
    qos: Qos

    @property
    def ros_type(self) -> str:
        """The type as ROS writes it, or as it is."""
        return ros_type_name(self.type_name) or self.type_name


@dataclass
class NodeEntry:
    """A node of this process and the GIDs of its endpoints."""

    name: str
    namespace: str
    readers: dict[bytes, None]
    writers: dict[bytes, None]

    @property
    def fully_qualified_name(self) -> str:
        """``/ns/name``."""
        return names.join(self.namespace, self.name)


class Graph:
    """Nodes and endpoints of one domain, from the point of view of one participant."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant
        self._lock = threading.RLock()
        self._local: list[NodeEntry] = []
        self._remote: dict[bytes, list[Any]] = {}  # participant's gid -> NodeEntitiesInfo messages
        struct = idl_struct(_INFO_TYPE)
        common = [
            Policy.Reliability.Reliable(qos_dds.MAX_BLOCKING_TIME_NS),
            Policy.Durability.TransientLocal,
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(qos_dds.user_data(definitions.type_hash(_INFO_TYPE))),
        ]
        service = Policy.DurabilityService(0, Policy.History.KeepLast(1), -1, -1, -1)
        self._writer = participant.writer(_INFO_TOPIC, struct, Qos(*common, Policy.History.KeepLast(1), service))
        self._reader = participant.reader(
            _INFO_TOPIC, struct, Qos(*common, Policy.History.KeepAll, Policy.IgnoreLocal.Participant)
        )
        self._endpoints: dict[bool, dict[bytes, Endpoint]] = {True: {}, False: {}}  # is it a writer?
        self._participants: set[bytes] = set()
        self._participant_reader = BuiltinDataReader(participant.entity, BuiltinTopicDcpsParticipant)
        # made when first asked for: every endpoint that they report costs about 0.1 ms
        self._endpoint_readers: tuple[tuple[BuiltinDataReader, bool], ...] | None = None
        self.wait_entity = wire.read_condition(self._reader._ref)

    # What the others see of this process

    def add_node(self, name: str, namespace: str) -> NodeEntry:
        """Announce a node."""
        entry = NodeEntry(name, namespace, {}, {})
        with self._lock:
            self._local.append(entry)
            self._announce()
        return entry

    @property
    def has_local_nodes(self) -> bool:
        """True while this process has nodes here."""
        return bool(self._local)

    def remove_node(self, entry: NodeEntry) -> None:
        """Take an announced node back."""
        with self._lock:
            if entry in self._local:
                self._local.remove(entry)
                self._announce()

    def add_endpoint(self, entry: NodeEntry, gid: bytes, *, is_writer: bool) -> None:
        """Announce an endpoint of a node."""
        with self._lock:
            (entry.writers if is_writer else entry.readers)[gid] = None
            self._announce()

    def remove_endpoint(self, entry: NodeEntry, gid: bytes, *, is_writer: bool) -> None:
        """Take an announced endpoint back."""
        with self._lock:
            (entry.writers if is_writer else entry.readers).pop(gid, None)
            self._announce()

    def _announce(self) -> None:
        if self._participant.closed:
            return
        node_info = message_class("rmw_dds_common/msg/NodeEntitiesInfo")
        nodes = [
            node_info(
                node_namespace=entry.namespace,
                node_name=entry.name,
                reader_gid_seq=[_gid_message(gid) for gid in entry.readers],
                writer_gid_seq=[_gid_message(gid) for gid in entry.writers],
            )
            for entry in self._local
        ]
        message = message_class(_INFO_TYPE)(gid=_gid_message(self._participant.gid), node_entities_info_seq=nodes)
        data = cdr.serialize(message)
        wire.write(self._writer._ref, data + bytes(-len(data) % 4))

    # What this process sees of the others

    def nodes(self) -> list[tuple[str, str]]:
        """Name and namespace of every node."""
        with self._lock:
            self._refresh()
            found = [(entry.name, entry.namespace) for entry in self._local]
            for messages in self._remote.values():
                found += [(message.node_name, message.node_namespace) for message in messages]
            return found

    def has_node(self, name: str, namespace: str) -> bool:
        """True if there is such a node."""
        return (name, namespace) in self.nodes()

    def endpoints(self, *, writers: bool) -> list[Endpoint]:
        """All writers, or all readers."""
        with self._lock:
            self._refresh()
            return list(self._endpoints[writers].values())

    def count(self, dds_topic: str, *, writers: bool) -> int:
        """Number of writers (or readers) of a topic."""
        return sum(1 for endpoint in self.endpoints(writers=writers) if endpoint.topic == dds_topic)

    def endpoints_of_node(self, name: str, namespace: str, *, writers: bool) -> list[Endpoint]:
        """The writers (or readers) of one node."""
        with self._lock:
            found = self.endpoints(writers=writers)
            owners = self._owners()
            return [endpoint for endpoint in found if owners.get(endpoint.gid) == (name, namespace)]

    def infos(self, dds_topic: str, *, writers: bool) -> list[TopicEndpointInfo]:
        """What is known of each writer (or reader) of a topic."""
        with self._lock:
            found = [endpoint for endpoint in self.endpoints(writers=writers) if endpoint.topic == dds_topic]
            owners = self._owners()
        kind = TopicEndpointTypeEnum.PUBLISHER if writers else TopicEndpointTypeEnum.SUBSCRIPTION
        result = []
        for endpoint in found:
            name, namespace = owners.get(endpoint.gid, _UNKNOWN_NODE)
            user_data = endpoint.qos[Policy.Userdata]
            result.append(
                TopicEndpointInfo(
                    node_name=name,
                    node_namespace=namespace,
                    topic_type=endpoint.ros_type,
                    topic_type_hash=TypeHash.from_user_data(user_data.data if user_data else b""),
                    endpoint_type=kind,
                    endpoint_gid=list(endpoint.gid),
                    qos_profile=qos_dds.from_dds(endpoint.qos),
                )
            )
        return result

    def _owners(self) -> dict[bytes, tuple[str, str]]:
        owners: dict[bytes, tuple[str, str]] = {}
        for entry in self._local:
            for gid in (*entry.readers, *entry.writers):
                owners[gid] = entry.name, entry.namespace
        for messages in self._remote.values():
            for message in messages:
                for gid_message in (*message.reader_gid_seq, *message.writer_gid_seq):
                    owners[bytes(gid_message.data)] = message.node_name, message.node_namespace
        return owners

    def _refresh(self) -> None:
        if self._participant.closed:
            return
        self.drain()
        if self._endpoint_readers is None:
            entity = self._participant.entity
            self._endpoint_readers = (
                (BuiltinDataReader(entity, BuiltinTopicDcpsPublication), True),
                (BuiltinDataReader(entity, BuiltinTopicDcpsSubscription), False),
            )
        for reader, is_writer in self._endpoint_readers:
            known = self._endpoints[is_writer]
            for sample in _take_all(reader):
                gid = sample.key.bytes
                if _is_alive(sample) and sample.topic_name is not None:
                    known[gid] = Endpoint(gid, sample.topic_name, sample.type_name, sample.qos)
                else:
                    known.pop(gid, None)

    def drain(self) -> None:
        """Take in what other participants announced; executors call this, so that it does not pile up."""
        with self._lock:
            if self._participant.closed:
                return
            while samples := wire.take(self._reader._ref, _BATCH):
                for data, _ in samples:
                    # an older ROS 2 in the same domain announces its nodes in another format
                    with contextlib.suppress(cdr.DeserializationError):
                        message = cdr.deserialize(data, _INFO_TYPE)
                        self._remote[bytes(message.gid.data)] = message.node_entities_info_seq
            # after the announcements: whoever made one of them has been discovered by then
            for sample in _take_all(self._participant_reader):
                if _is_alive(sample):
                    self._participants.add(sample.key.bytes)
                else:
                    self._participants.discard(sample.key.bytes)
            for gid in [gid for gid in self._remote if gid not in self._participants]:
                del self._remote[gid]


def _take_all(reader: BuiltinDataReader) -> list[Any]:
    samples: list[Any] = []
    while batch := reader.take(_BATCH):
        samples += batch
        if len(batch) < _BATCH:
            break
    return samples


def _is_alive(sample: Any) -> bool:
    info = sample.sample_info
    return bool(info.valid_data) and info.instance_state == InstanceState.Alive


def _gid_message(gid: bytes) -> Any:
    return message_class("rmw_dds_common/msg/Gid")(data=gid)
