"""One DDS participant per context: domain, topics, endpoints, user data."""

from __future__ import annotations

import atexit
import threading
import weakref
from collections import Counter
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from rosless import domain, wire
from rosless.exceptions import RCLError

_lock = threading.Lock()
_domains: dict[int, Domain] = {}
_users: Counter[int] = Counter()  # open participants per domain: the domain itself holds sockets and threads
_open: weakref.WeakSet[Participant] = weakref.WeakSet()


class Participant:
    """This process in one domain, from a context's init to its shutdown."""

    def __init__(self, domain_id: int) -> None:
        self.domain_id = domain_id
        try:
            with _lock:
                if domain_id not in _domains:
                    # a domain's configuration can only be given when it is made
                    _domains[domain_id] = Domain(domain_id, domain.configuration())
                self.entity = DomainParticipant(domain_id, Qos(Policy.Userdata(b"enclave=/;")))
                _users[domain_id] += 1
        except DDSException as error:
            raise RCLError(
                f"cannot join DDS domain {domain_id}: {error}. If CYCLONEDDS_URI is set, check it; if not, "
                f"there may be more than {domain.MAX_PARTICIPANT_INDEX + 1} processes in this domain on this machine."
            ) from error
        self.gid = self.entity.get_guid().bytes
        self._topics: dict[tuple[str, str], Topic[Any]] = {}
        self._topics_lock = threading.Lock()
        self._closed = False
        _open.add(self)

    def topic(self, name: str, struct: type[Any]) -> Topic[Any]:
        """The DDS topic of this name and type."""
        key = name, struct.__idl__.idl_transformed_typename
        with self._topics_lock:
            if key not in self._topics:
                try:
                    self._topics[key] = Topic(self.entity, name, struct)
                except DDSException as error:
                    raise RCLError(f"cannot create topic {name} of type {key[1]}: {error}") from error
            return self._topics[key]

    def writer(self, topic: str, struct: type[Any], qos: Qos) -> DataWriter[Any]:
        """A writer of raw CDR."""
        return DataWriter(self.entity, self.topic(topic, struct), qos)

    def reader(self, topic: str, struct: type[Any], qos: Qos) -> DataReader[Any]:
        """A reader of raw CDR."""
        return DataReader(self.entity, self.topic(topic, struct), qos)

    def close(self) -> None:
        """Leave the domain, so that peers know at once and not after the lease has run out."""
        if not self._closed:
            self._closed = True
            with _lock:
                wire.delete(self.entity._ref)
                _users[self.domain_id] -= 1
                if _users[self.domain_id] == 0:
                    wire.delete(_domains.pop(self.domain_id)._ref)

    @property
    def closed(self) -> bool:
        """True after :meth:`close`."""
        return self._closed


@atexit.register
def _close_all() -> None:
    for participant in list(_open):
        participant.close()
