"""Whether a publisher's and a subscription's profile fit."""

from __future__ import annotations

from rosless.duration import Duration
from rosless.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
)

_OPEN = ("SYSTEM_DEFAULT", "UNKNOWN")


def qos_check_compatible(publisher_qos: QoSProfile, subscription_qos: QoSProfile) -> tuple[QoSCompatibility, str]:
    """Compatibility of two profiles, and the reason if they are not (surely) compatible."""
    errors, warnings = [], []
    if (publisher_qos.reliability, subscription_qos.reliability) == (
        ReliabilityPolicy.BEST_EFFORT,
        ReliabilityPolicy.RELIABLE,
    ):
        errors.append("Best effort publisher and reliable subscription")
    if (publisher_qos.durability, subscription_qos.durability) == (
        DurabilityPolicy.VOLATILE,
        DurabilityPolicy.TRANSIENT_LOCAL,
    ):
        errors.append("Volatile publisher and transient local subscription")
    if _longer(publisher_qos.deadline, subscription_qos.deadline):
        errors.append("Publisher's deadline is longer than the subscription's")
    if (publisher_qos.liveliness, subscription_qos.liveliness) == (
        LivelinessPolicy.AUTOMATIC,
        LivelinessPolicy.MANUAL_BY_TOPIC,
    ):
        errors.append("Publisher's liveliness is automatic and subscription's is manual by topic")
    if _longer(publisher_qos.liveliness_lease_duration, subscription_qos.liveliness_lease_duration):
        errors.append("Publisher's liveliness lease duration is longer than the subscription's")
    for policy in ("reliability", "durability", "liveliness"):
        names = [getattr(profile, policy).name for profile in (publisher_qos, subscription_qos)]
        if policy != "liveliness" and any(name in _OPEN for name in names):
            warnings.append(f"{policy} is {' and '.join(names)}")
    if errors:
        return QoSCompatibility.ERROR, "".join(f"ERROR: {error};" for error in errors)
    if warnings:
        return QoSCompatibility.WARNING, "".join(f"WARNING: {warning};" for warning in warnings)
    return QoSCompatibility.OK, ""


def _longer(offered: Duration, requested: Duration) -> bool:
    if requested.nanoseconds == 0:
        return False
    return offered.nanoseconds == 0 or offered > requested
