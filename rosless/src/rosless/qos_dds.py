"""rclpy's QoS profiles as Cyclone DDS policies, and back."""

from __future__ import annotations

from typing import Any

from cyclonedds.qos import Policy, Qos

from rosless.constants import DURATION_INFINITE_NS
from rosless.duration import Duration
from rosless.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)

# How long a write may wait for room in a full history. ROS 2 waits for ever; then a reader that stopped would
# stop its writers too, and a write cannot be interrupted.
MAX_BLOCKING_TIME_NS = 1_000_000_000

# DDS policy ids (DDS 1.4, 2.2.3) -> rmw's kinds
POLICY_KINDS = {
    2: QoSPolicyKind.DURABILITY,
    4: QoSPolicyKind.DEADLINE,
    8: QoSPolicyKind.LIVELINESS,
    11: QoSPolicyKind.RELIABILITY,
    13: QoSPolicyKind.HISTORY,
    21: QoSPolicyKind.LIFESPAN,
}


def user_data(type_hash: str) -> bytes:
    """What ROS 2 wants to find in the user data of an endpoint."""
    return f"typehash={type_hash};".encode()


def to_dds(profile: QoSProfile, type_hash: str, *, writer: bool) -> Qos:
    """Policies of a writer or reader."""
    if profile.history == HistoryPolicy.KEEP_ALL:
        history: Any = Policy.History.KeepAll
    else:
        history = Policy.History.KeepLast(depth=max(1, profile.depth))
    policies = [
        history,
        Policy.Userdata(user_data(type_hash)),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        _reliability(profile, writer=writer),
        _liveliness(profile),
    ]
    if writer:
        policies.append(Policy.WriterDataLifecycle(autodispose=False))
    if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        policies.append(Policy.Durability.TransientLocal)
        # Cyclone keeps historical data by this policy, not by the history of the writer
        policies.append(
            Policy.DurabilityService(
                cleanup_delay=0,
                history=history,
                max_samples=-1,
                max_instances=-1,
                max_samples_per_instance=-1,
            )
        )
    else:
        policies.append(Policy.Durability.Volatile)
    if writer and profile.lifespan.nanoseconds:
        policies.append(Policy.Lifespan(lifespan=profile.lifespan.nanoseconds))
    if 0 < profile.deadline.nanoseconds < DURATION_INFINITE_NS - 1:
        policies.append(Policy.Deadline(deadline=profile.deadline.nanoseconds))
    return Qos(*policies)


def _reliability(profile: QoSProfile, *, writer: bool) -> Any:
    if profile.reliability == ReliabilityPolicy.BEST_EFFORT:
        return Policy.Reliability.BestEffort
    if profile.reliability == ReliabilityPolicy.BEST_AVAILABLE and not writer:
        # matches every writer; a best-available writer offers the most and matches every reader
        return Policy.Reliability.BestEffort
    return Policy.Reliability.Reliable(max_blocking_time=MAX_BLOCKING_TIME_NS)


def _liveliness(profile: QoSProfile) -> Any:
    lease = profile.liveliness_lease_duration.nanoseconds
    if lease == 0 or lease >= DURATION_INFINITE_NS - 1:
        lease = DURATION_INFINITE_NS
    if profile.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC:
        return Policy.Liveliness.ManualByTopic(lease_duration=lease)
    return Policy.Liveliness.Automatic(lease_duration=lease)


def from_dds(qos: Qos) -> QoSProfile:
    """The profile of a discovered endpoint. History is not part of the discovery data of DDS."""
    reliable = qos[Policy.Reliability] != Policy.Reliability.BestEffort
    transient_local = qos[Policy.Durability] == Policy.Durability.TransientLocal
    liveliness = qos[Policy.Liveliness]
    manual = isinstance(liveliness, Policy.Liveliness.ManualByTopic)
    return QoSProfile(
        history=HistoryPolicy.UNKNOWN,
        depth=0,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if transient_local else DurabilityPolicy.VOLATILE,
        lifespan=_duration(qos, Policy.Lifespan, "lifespan"),
        deadline=_duration(qos, Policy.Deadline, "deadline"),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC if manual else LivelinessPolicy.AUTOMATIC,
        liveliness_lease_duration=Duration(nanoseconds=liveliness.lease_duration if liveliness else 0),
    )


def _duration(qos: Qos, policy: type, attribute: str) -> Duration:
    found = qos[policy]
    return Duration(nanoseconds=getattr(found, attribute) if found is not None else DURATION_INFINITE_NS)
