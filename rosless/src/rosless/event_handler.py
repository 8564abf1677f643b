"""rclpy.event_handler: what happens to an endpoint besides messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from cyclonedds.core import DDSStatus

from rosless import wire
from rosless.exceptions import UnsupportedEventTypeError
from rosless.logging import RcutilsLogger
from rosless.qos import QoSPolicyKind, qos_policy_name_from_kind
from rosless.qos_dds import POLICY_KINDS

__all__ = [
    "EventHandler",
    "IncompatibleTypeInfo",
    "PublisherEventCallbacks",
    "QoSLivelinessChangedInfo",
    "QoSLivelinessLostInfo",
    "QoSMessageLostInfo",
    "QoSOfferedDeadlineMissedInfo",
    "QoSOfferedIncompatibleQoSInfo",
    "QoSPublisherEventType",
    "QoSPublisherMatchedInfo",
    "QoSRequestedDeadlineMissedInfo",
    "QoSRequestedIncompatibleQoSInfo",
    "QoSSubscriptionEventType",
    "QoSSubscriptionMatchedInfo",
    "SubscriptionEventCallbacks",
    "UnsupportedEventTypeError",
]

Callback = Callable[[Any], Any]

# DDS reports a type that does not fit as one of these two policies
_TYPE_POLICY_IDS = frozenset([23, 24])


class QoSPublisherEventType(IntEnum):
    """Events of a publisher."""

    RCL_PUBLISHER_OFFERED_DEADLINE_MISSED = 0
    RCL_PUBLISHER_LIVELINESS_LOST = 1
    RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS = 2
    RCL_PUBLISHER_INCOMPATIBLE_TYPE = 3
    RCL_PUBLISHER_MATCHED = 4


class QoSSubscriptionEventType(IntEnum):
    """Events of a subscription."""

    RCL_SUBSCRIPTION_REQUESTED_DEADLINE_MISSED = 0
    RCL_SUBSCRIPTION_LIVELINESS_CHANGED = 1
    RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS = 2
    RCL_SUBSCRIPTION_MESSAGE_LOST = 3
    RCL_SUBSCRIPTION_INCOMPATIBLE_TYPE = 4
    RCL_SUBSCRIPTION_MATCHED = 5


@dataclass
class _CountInfo:
    total_count: int = 0
    total_count_change: int = 0


class QoSRequestedDeadlineMissedInfo(_CountInfo):
    """A subscription missed its deadline."""


class QoSOfferedDeadlineMissedInfo(_CountInfo):
    """A publisher missed its deadline."""


class QoSLivelinessLostInfo(_CountInfo):
    """A publisher failed to say that it is alive."""


class QoSMessageLostInfo(_CountInfo):
    """Messages were lost."""


class IncompatibleTypeInfo(_CountInfo):
    """An endpoint with the same topic and another type was found."""


@dataclass
class QoSRequestedIncompatibleQoSInfo(_CountInfo):
    """An endpoint with incompatible QoS was found."""

    last_policy_kind: int = QoSPolicyKind.INVALID


QoSOfferedIncompatibleQoSInfo = QoSRequestedIncompatibleQoSInfo


@dataclass
class QoSLivelinessChangedInfo:
    """Publishers of a topic came alive or went silent."""

    alive_count: int = 0
    not_alive_count: int = 0
    alive_count_change: int = 0
    not_alive_count_change: int = 0


@dataclass
class QoSPublisherMatchedInfo(_CountInfo):
    """An endpoint was connected or disconnected."""

    current_count: int = 0
    current_count_change: int = 0


QoSSubscriptionMatchedInfo = QoSPublisherMatchedInfo


@dataclass(kw_only=True)
class SubscriptionEventCallbacks:
    """Functions to call at events of a subscription."""

    deadline: Callback | None = None
    incompatible_qos: Callback | None = None
    liveliness: Callback | None = None
    message_lost: Callback | None = None
    incompatible_type: Callback | None = None
    matched: Callback | None = None
    use_default_callbacks: bool = True

    def create_event_handlers(self, reader: int, logger: RcutilsLogger, topic: str) -> list[EventHandler]:
        """What waits for these events."""
        defaults = self.use_default_callbacks
        qos, type_ = _default_callbacks(logger, topic, "publisher", "offering", "received from")
        statuses = {
            "requested_deadline_missed": _Status(QoSRequestedDeadlineMissedInfo, self.deadline),
            "requested_incompatible_qos": _Status(
                QoSRequestedIncompatibleQoSInfo, self.incompatible_qos or (qos if defaults else None)
            ),
            "liveliness_changed": _Status(QoSLivelinessChangedInfo, self.liveliness),
            "sample_lost": _Status(QoSMessageLostInfo, self.message_lost),
            "subscription_matched": _Status(QoSSubscriptionMatchedInfo, self.matched),
        }
        return [EventHandler(reader, statuses, self.incompatible_type or (type_ if defaults else None))]


@dataclass(kw_only=True)
class PublisherEventCallbacks:
    """Functions to call at events of a publisher."""

    deadline: Callback | None = None
    liveliness: Callback | None = None
    incompatible_qos: Callback | None = None
    incompatible_type: Callback | None = None
    matched: Callback | None = None
    use_default_callbacks: bool = True

    def create_event_handlers(self, writer: int, logger: RcutilsLogger, topic: str) -> list[EventHandler]:
        """What waits for these events."""
        defaults = self.use_default_callbacks
        qos, type_ = _default_callbacks(logger, topic, "subscription", "requesting", "sent to")
        statuses = {
            "offered_deadline_missed": _Status(QoSOfferedDeadlineMissedInfo, self.deadline),
            "liveliness_lost": _Status(QoSLivelinessLostInfo, self.liveliness),
            "offered_incompatible_qos": _Status(
                QoSOfferedIncompatibleQoSInfo, self.incompatible_qos or (qos if defaults else None)
            ),
            "publication_matched": _Status(QoSPublisherMatchedInfo, self.matched),
        }
        return [EventHandler(writer, statuses, self.incompatible_type or (type_ if defaults else None))]


def _default_callbacks(
    logger: RcutilsLogger, topic: str, other: str, verb: str, direction: str
) -> tuple[Callback, Callback]:
    def on_incompatible_qos(event: QoSRequestedIncompatibleQoSInfo) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        logger.warn(
            f"New {other} discovered on topic '{topic}', {verb} incompatible QoS. "
            f"No messages will be {direction} it. Last incompatible policy: {policy}"
        )

    def on_incompatible_type(event: IncompatibleTypeInfo) -> None:
        logger.warn(f"Incompatible type on topic '{topic}', no messages will be {direction} it.")

    return on_incompatible_qos, on_incompatible_type


@dataclass
class _Status:
    info: type[Any]
    callback: Callback | None


_MASKS = {
    "offered_deadline_missed": DDSStatus.OfferedDeadlineMissed,
    "requested_deadline_missed": DDSStatus.RequestedDeadlineMissed,
    "offered_incompatible_qos": DDSStatus.OfferedIncompatibleQos,
    "requested_incompatible_qos": DDSStatus.RequestedIncompatibleQos,
    "sample_lost": DDSStatus.SampleLost,
    "liveliness_lost": DDSStatus.LivelinessLost,
    "liveliness_changed": DDSStatus.LivelinessChanged,
    "publication_matched": DDSStatus.PublicationMatched,
    "subscription_matched": DDSStatus.SubscriptionMatched,
}


class EventHandler:
    """All events of one endpoint, as one thing that an executor waits for."""

    def __init__(self, entity: int, statuses: dict[str, _Status], on_type: Callback | None) -> None:
        self._statuses = {
            name: status
            for name, status in statuses.items()
            if status.callback is not None or (on_type is not None and name.endswith("incompatible_qos"))
        }
        self._on_type = on_type
        self._entity = entity
        wire.set_status_mask(entity, sum(_MASKS[name] for name in self._statuses))

    @property
    def wait_entity(self) -> int:
        """What a wait set attaches; 0 if there is nothing to wait for."""
        return self._entity if self._statuses else 0

    def take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        """Read what changed, and say what to run."""
        if not self._entity:
            return None
        changes = wire.status_changes(self._entity)
        calls: list[tuple[Callback, Any]] = []
        for name, status in self._statuses.items():
            if not changes & _MASKS[name]:
                continue
            data = wire.status(self._entity, name, wire.STATUS_TYPES[name])
            info = self._info(name, status, data)
            callback = self._on_type if isinstance(info, IncompatibleTypeInfo) else status.callback
            if callback is not None:
                calls.append((callback, info))
        return (_call_all, (calls,)) if calls else None

    def _info(self, name: str, status: _Status, data: Any) -> Any:
        if name.endswith("incompatible_qos"):
            if data.last_policy_id in _TYPE_POLICY_IDS:
                return IncompatibleTypeInfo(data.total_count, data.total_count_change)
            kind = POLICY_KINDS.get(data.last_policy_id, QoSPolicyKind.INVALID)
            return QoSRequestedIncompatibleQoSInfo(data.total_count, data.total_count_change, kind)
        members = status.info.__dataclass_fields__
        return status.info(**{member: getattr(data, member) for member in members})

    def destroy(self) -> None:
        """Stop waiting."""
        self._entity = 0


def _call_all(calls: list[tuple[Callback, Any]]) -> None:
    for callback, info in calls:
        callback(info)


QoSEventHandler = EventHandler
