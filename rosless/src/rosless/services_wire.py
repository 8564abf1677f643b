"""Services on the wire, as rmw_cyclonedds_cpp has them: two topics, and a request id before the members."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from cyclonedds.qos import Policy, Qos

from rosless import wire
from rosless.context import Context
from rosless.interfaces import cdr, definitions
from rosless.interfaces.idl import service_struct
from rosless.qos import QoSProfile
from rosless.qos_dds import MAX_BLOCKING_TIME_NS, user_data

_ID = struct.Struct("<Qq")
_PREFIX_LENGTH = len(cdr.LITTLE_ENDIAN_HEADER) + _ID.size


@dataclass(frozen=True)
class RequestId:
    """Who asked, and which of its requests this is."""

    client: int
    sequence: int


def request_topic(service: str) -> str:
    """The topic of a service's requests."""
    return f"rq{service}Request"


def reply_topic(service: str) -> str:
    """The topic of a service's replies."""
    return f"rr{service}Reply"


def check_service_type(srv_type: Any) -> None:
    """TypeError if it is no service class."""
    if not hasattr(srv_type, "Request") or not hasattr(srv_type, "Response"):
        raise TypeError(f"Expected a service class, got {srv_type!r}")


class TwoWay:
    """A reader of one half of a service and a writer of the other."""

    def __init__(
        self,
        context: Context,
        receives: type[Any],
        receive_topic: str,
        sends: type[Any],
        send_topic: str,
        qos: QoSProfile,
    ) -> None:
        self._receives: str = receives.__msgtype__
        package, _, half = self._receives.split("/")
        type_hash = definitions.service_type_hash(package, half.rpartition("_")[0])
        self._sends = sends
        self._append = cdr.serializer(sends.__msgtype__)
        cdr.deserializer(self._receives)
        policies = Qos(
            Policy.Reliability.Reliable(max_blocking_time=MAX_BLOCKING_TIME_NS),
            Policy.History.KeepAll,
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.Userdata(user_data(type_hash)),
        )
        participant = context.participant
        self._reader = participant.reader(receive_topic, service_struct(self._receives), policies)
        self._writer = participant.writer(send_topic, service_struct(sends.__msgtype__), policies)
        self.reader_gid: bytes = self._reader.get_guid().bytes
        self.writer_gid: bytes = self._writer.get_guid().bytes
        self._reader_entity: int = self._reader._ref
        self._writer_entity: int = self._writer._ref
        self.wait_entity = wire.read_condition(self._reader_entity)

    def send(self, request_id: RequestId, message: Any) -> None:
        """Send one half, with the id that connects it with the other."""
        if message.__class__ is not self._sends:
            raise TypeError(f"Expected {self._sends}, got {type(message)}")
        out = bytearray(cdr.LITTLE_ENDIAN_HEADER + _ID.pack(request_id.client, request_id.sequence))
        cdr.append_checked(self._append, out, message)
        wire.write(self._writer_entity, bytes(out) + bytes(-len(out) % 4))

    def receive(self) -> tuple[RequestId, Any] | None:
        """The next of the other half, or None."""
        if not self._reader_entity:
            return None
        sample = wire.take_one(self._reader_entity)
        if sample is None:
            return None
        data = bytearray(sample[0])
        order = "<" if data[1] else ">"
        if len(data) < _PREFIX_LENGTH:
            raise cdr.DeserializationError(f"{len(data)} bytes are too few for a {self._receives}")
        client, sequence = struct.unpack_from(f"{order}Qq", data, len(cdr.LITTLE_ENDIAN_HEADER))
        message = cdr.read_checked(cdr.deserializer(self._receives, order), data, self._receives, _PREFIX_LENGTH)
        return RequestId(client, sequence), message

    @property
    def matched(self) -> tuple[int, int]:
        """Number of readers that the writer, and of writers that the reader, is connected with."""
        return (
            wire.matched_count(self._writer_entity, is_writer=True),
            wire.matched_count(self._reader_entity, is_writer=False),
        )

    def close(self) -> None:
        """Delete both endpoints."""
        entities, self._reader_entity, self._writer_entity = (self._reader_entity, self._writer_entity), 0, 0
        self.wait_entity = 0
        for entity in entities:
            if entity:
                wire.delete(entity)
