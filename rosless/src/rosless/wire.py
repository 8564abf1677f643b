"""The calls into Cyclone DDS that happen per message or per wait.

They go to the wheel's C functions directly: the Python layer above them costs more than the transport does.
The wheel's version is pinned for that reason. WaitSets only, never listeners: a write holds the interpreter
lock, and a listener waiting for that lock while a write waits for the listener's thread would stop both.
"""

from __future__ import annotations

import ctypes as ct
from collections.abc import Iterator
from typing import Any

from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.core import DDSException, InstanceState, SampleState, ViewState
from cyclonedds.domain import DomainParticipant
from cyclonedds.internal import DDS, dds_c_t

from rosless.exceptions import RCLError

ANY_STATE = SampleState.Any | ViewState.Any | InstanceState.Any

# Longest time in one call, so that a signal is answered: Python handles it when the call returns.
LONGEST_WAIT_NS = 100_000_000

_library = DDS._dll_handle


def _function(name: str, *argument_types: Any) -> Any:
    function = getattr(_library, name)
    function.restype = ct.c_int32
    function.argtypes = list(argument_types)
    return function


_attach = _function("dds_waitset_attach", ct.c_int32, ct.c_int32, ct.c_ssize_t)
_detach = _function("dds_waitset_detach", ct.c_int32, ct.c_int32)
_wait = _function("dds_waitset_wait", ct.c_int32, ct.c_void_p, ct.c_size_t, ct.c_int64)
_create_waitset = _function("dds_create_waitset", ct.c_int32)
_create_guard = _function("dds_create_guardcondition", ct.c_int32)
_set_guard = _function("dds_set_guardcondition", ct.c_int32, ct.c_bool)
_create_condition = _function("dds_create_readcondition", ct.c_int32, ct.c_uint32)
_delete = _function("dds_delete", ct.c_int32)
_set_mask = _function("dds_set_status_mask", ct.c_int32, ct.c_uint32)
_status_changes = _function("dds_get_status_changes", ct.c_int32, ct.c_void_p)
_matched_readers = _function("dds_get_matched_subscriptions", ct.c_int32, ct.c_void_p, ct.c_size_t)
_matched_writers = _function("dds_get_matched_publications", ct.c_int32, ct.c_void_p, ct.c_size_t)
_wait_for_acks = _function("dds_wait_for_acks", ct.c_int32, ct.c_int64)
_assert_liveliness = _function("dds_assert_liveliness", ct.c_int32)


def check(code: int, what: str) -> int:
    """The code itself, if it is no error."""
    if code < 0:
        raise RCLError(f"failed to {what}: {DDSException(code)}")
    return code


def write(writer: int, data: bytes) -> None:
    """Send CDR bytes, header included, padded to a multiple of 4."""
    code = ddspy_write(writer, data)
    if code < 0:
        check(code, "publish")


def take(reader: int, limit: int = 1) -> list[tuple[bytes, Any]]:
    """Up to ``limit`` samples with their info, without waiting; samples without data are left out."""
    samples = ddspy_take(reader, ANY_STATE, limit)
    if isinstance(samples, int):
        check(samples, "take")
    return [sample for sample in samples if sample[1].valid_data]


def take_one(reader: int) -> tuple[bytes, Any] | None:
    """The next sample with data, or None."""
    while True:
        samples = ddspy_take(reader, ANY_STATE, 1)
        if samples.__class__ is int:
            check(samples, "take")
        if not samples:
            return None
        sample: tuple[bytes, Any] = samples[0]
        if sample[1].valid_data:
            return sample


def read_condition(reader: int) -> int:
    """A condition that holds while the reader has samples."""
    return check(_create_condition(reader, ANY_STATE), "create a read condition")


def delete(entity: int) -> None:
    """Delete an entity and what belongs to it; one that is gone already is fine."""
    _delete(entity)


def set_status_mask(entity: int, mask: int) -> None:
    """Choose the statuses of a reader or writer that wake a wait set."""
    check(_set_mask(entity, mask), "set a status mask")


def status_changes(entity: int) -> int:
    """The statuses of a reader or writer that changed since they were last read."""
    mask = ct.c_uint32()
    check(_status_changes(entity, ct.byref(mask)), "read status changes")
    return mask.value


def status(entity: int, name: str, kind: Any) -> Any:
    """Read a status (``dds_get_<name>_status``), which also resets its change counters."""
    result = kind()
    check(_function(f"dds_get_{name}_status", ct.c_int32, ct.c_void_p)(entity, ct.byref(result)), f"read {name}")
    return result


def matched_count(entity: int, *, is_writer: bool) -> int:
    """Number of endpoints that this reader or writer is connected with."""
    function = _matched_readers if is_writer else _matched_writers
    return check(function(entity, None, 0), "count matched endpoints")


def wait_for_acks(writer: int, timeout_ns: int) -> bool:
    """True once every matched reliable reader has acknowledged everything; the calling thread waits."""
    code = _wait_for_acks(writer, timeout_ns)
    if code == DDSException.DDS_RETCODE_TIMEOUT:
        return False
    check(code, "wait for acknowledgements")
    return True


def assert_liveliness(writer: int) -> None:
    """Say that a writer is alive."""
    check(_assert_liveliness(writer), "assert liveliness")


class GuardHandle:
    """A condition that another thread can set; it keeps the number, not the time, of no trigger."""

    def __init__(self, participant: DomainParticipant) -> None:
        self.entity = check(_create_guard(participant._ref), "create a guard condition")

    def trigger(self) -> None:
        """Wake every wait set that this condition is attached to."""
        if self.entity:
            _set_guard(self.entity, True)

    def clear(self) -> None:
        """Back to not triggered."""
        if self.entity:
            _set_guard(self.entity, False)

    def delete(self) -> None:
        """Delete the condition."""
        entity, self.entity = self.entity, 0
        if entity:
            delete(entity)


class WaitSet:
    """Waits for any of the attached entities; each comes with a number of the caller's."""

    def __init__(self, participant: DomainParticipant) -> None:
        self._handle = check(_create_waitset(participant._ref), "create a wait set")
        self._capacity = 16
        self._triggered = (ct.c_ssize_t * self._capacity)()
        self._attached: dict[int, int] = {}

    def attach(self, entity: int, cookie: int) -> None:
        """Add an entity; waiting returns its cookie."""
        check(_attach(self._handle, entity, cookie), "attach to a wait set")
        self._attached[entity] = cookie
        if len(self._attached) > self._capacity:
            self._capacity *= 2
            self._triggered = (ct.c_ssize_t * self._capacity)()

    def detach(self, entity: int) -> None:
        """Remove an entity; deleted ones have gone by themselves."""
        if self._attached.pop(entity, None) is not None:
            _detach(self._handle, entity)

    def entities(self) -> Iterator[int]:
        """The attached entities."""
        return iter(tuple(self._attached))

    def wait(self, timeout_ns: int) -> list[int]:
        """Cookies of what is triggered, after at most this time."""
        count = _wait(self._handle, self._triggered, self._capacity, timeout_ns)
        if count == 0:
            return []
        if count < 0:
            check(count, "wait")
        return self._triggered[: min(count, self._capacity)]

    def delete(self) -> None:
        """Delete the wait set."""
        handle, self._handle = self._handle, 0
        if handle:
            delete(handle)


STATUS_TYPES: dict[str, Any] = {
    "publication_matched": dds_c_t.publication_matched_status,
    "subscription_matched": dds_c_t.subscription_matched_status,
    "offered_incompatible_qos": dds_c_t.offered_incompatible_qos_status,
    "requested_incompatible_qos": dds_c_t.requested_incompatible_qos_status,
    "offered_deadline_missed": dds_c_t.offered_deadline_missed_status,
    "requested_deadline_missed": dds_c_t.requested_deadline_missed_status,
    "liveliness_lost": dds_c_t.liveliness_lost_status,
    "liveliness_changed": dds_c_t.liveliness_changed_status,
    "sample_lost": dds_c_t.sample_lost_status,
}
