"""QoS profiles."""

from __future__ import annotations

import pytest
from rosless.duration import Duration
from rosless.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rosless.qos_compatibility import qos_check_compatible

from rosless import qos, qos_dds


def test_defaults() -> None:
    profile = QoSProfile(depth=7)
    assert profile.history == HistoryPolicy.KEEP_LAST
    assert profile.reliability == ReliabilityPolicy.RELIABLE
    assert profile.durability == DurabilityPolicy.VOLATILE
    assert profile.depth == 7


def test_history_or_depth_is_required() -> None:
    with pytest.raises(qos.InvalidQoSProfileException):
        QoSProfile()
    with pytest.raises(qos.InvalidQoSProfileException):
        QoSProfile(history=HistoryPolicy.KEEP_LAST)
    assert QoSProfile(history=HistoryPolicy.KEEP_ALL).depth == 10
    with pytest.raises(AssertionError):
        QoSProfile(depth=1, speed=3)
    with pytest.warns(UserWarning, match="zero depth"):
        QoSProfile(depth=0)


def test_presets() -> None:
    assert qos.qos_profile_sensor_data.reliability == ReliabilityPolicy.BEST_EFFORT
    assert qos.QoSPresetProfiles.get_from_short_key("sensor_data") is qos.qos_profile_sensor_data
    assert ReliabilityPolicy.RELIABLE.short_key == "reliable"
    assert ReliabilityPolicy.get_from_short_key("best_effort") == ReliabilityPolicy.BEST_EFFORT


@pytest.mark.parametrize("reliability", [ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT])
@pytest.mark.parametrize("durability", [DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL])
@pytest.mark.parametrize("liveliness", [LivelinessPolicy.AUTOMATIC, LivelinessPolicy.MANUAL_BY_TOPIC])
def test_policies_reach_dds_and_come_back(
    reliability: ReliabilityPolicy, durability: DurabilityPolicy, liveliness: LivelinessPolicy
) -> None:
    profile = QoSProfile(
        depth=3,
        reliability=reliability,
        durability=durability,
        liveliness=liveliness,
        deadline=Duration(seconds=1),
        lifespan=Duration(seconds=2),
        liveliness_lease_duration=Duration(seconds=3),
    )
    back = qos_dds.from_dds(qos_dds.to_dds(profile, b"", writer=True))
    for name in (
        "reliability",
        "durability",
        "liveliness",
        "deadline",
        "lifespan",
        "liveliness_lease_duration",
    ):
        assert getattr(back, name) == getattr(profile, name)


def test_compatibility() -> None:
    reliable, best_effort = QoSProfile(depth=1), qos.qos_profile_sensor_data
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    assert qos_check_compatible(reliable, best_effort) == (qos.QoSCompatibility.OK, "")
    assert qos_check_compatible(best_effort, reliable)[0] == qos.QoSCompatibility.ERROR
    assert qos_check_compatible(reliable, latched)[0] == qos.QoSCompatibility.ERROR
    assert qos_check_compatible(latched, reliable)[0] == qos.QoSCompatibility.OK
    assert qos_check_compatible(qos.qos_profile_system_default, reliable)[0] == qos.QoSCompatibility.WARNING
