"""Which DDS domain, over which interfaces: ROS's environment variables as Cyclone DDS configuration."""

from __future__ import annotations

import os
import uuid
from collections.abc import Mapping
from xml.sax.saxutils import quoteattr

from rosless.exceptions import RCLError

# RTPS maps a domain id to UDP ports; above this the ports would leave the 16-bit range.
MAX_DOMAIN_ID = 232
# How many processes of one domain find each other on one host without multicast.
MAX_PARTICIPANT_INDEX = 32

_LOOPBACK_HOSTS = ("127.0.0.1", "localhost")
_RANGES = ("LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT")


def domain_id(requested: int | None, environment: Mapping[str, str] = os.environ) -> int:
    """The domain id asked for, or that of ROS_DOMAIN_ID, or 0."""
    source = "domain_id"
    if requested is None:
        text = environment.get("ROS_DOMAIN_ID", "").strip()
        source = "ROS_DOMAIN_ID"
        if not text:
            return 0
        if not text.isdecimal() or not text.isascii():
            raise RCLError(f"{source} must be an integer from 0 to {MAX_DOMAIN_ID}, got {text!r}")
        requested = int(text)
    if not 0 <= requested <= MAX_DOMAIN_ID:
        raise RCLError(f"{source} must be an integer from 0 to {MAX_DOMAIN_ID}, got {requested}")
    return requested


def configuration(environment: Mapping[str, str] = os.environ) -> str:
    """Cyclone DDS configuration of the domain.

    A CYCLONEDDS_URI decides alone, as whoever sets it has chosen the interfaces. Otherwise
    ROS_AUTOMATIC_DISCOVERY_RANGE and ROS_STATIC_PEERS do; without them the graph stays on the loopback
    interface.
    """
    uri = environment.get("CYCLONEDDS_URI", "")
    if uri:
        return uri
    # ROS 2 itself defaults to SUBNET; a graph that judges a car should not leave the machine unasked.
    wanted = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").strip().upper() or "LOCALHOST"
    if wanted not in _RANGES:
        raise RCLError(f"ROS_AUTOMATIC_DISCOVERY_RANGE must be one of {', '.join(_RANGES)}, got {wanted!r}")
    peers = [peer.strip() for peer in environment.get("ROS_STATIC_PEERS", "").split(";") if peer.strip()]
    if wanted == "SYSTEM_DEFAULT":
        return ""
    if wanted == "OFF":
        # Participants with different tags ignore each other, on one machine as well.
        tag = f"<Tag>ros_discovery_off_{uuid.uuid4().hex}</Tag>"
        return _document(general=_loopback(), discovery=tag)
    if wanted == "SUBNET":
        return _document(general="", discovery=_unicast(peers))
    remote = any(peer not in _LOOPBACK_HOSTS for peer in peers)
    general = "<AllowMulticast>false</AllowMulticast>" if remote else _loopback()
    return _document(general=general, discovery=_unicast(["127.0.0.1", *peers]))


def _loopback() -> str:
    interface = '<Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>'
    return f"{interface}<AllowMulticast>false</AllowMulticast>"


def _unicast(peers: list[str]) -> str:
    index = (
        "<ParticipantIndex>auto</ParticipantIndex>"
        f"<MaxAutoParticipantIndex>{MAX_PARTICIPANT_INDEX}</MaxAutoParticipantIndex>"
    )
    if not peers:
        return index
    addresses = "".join(f"<Peer address={quoteattr(peer)}/>" for peer in dict.fromkeys(peers))
    return f"{index}<Peers>{addresses}</Peers>"


def _document(*, general: str, discovery: str) -> str:
    # A writer that is deleted waits so long for readers that have not acknowledged everything. Those that died without
    # saying goodbye never will, and with the default, 1 s, a node with several publishers would take seconds to end.
    internal = "<WriterLingerDuration>100 ms</WriterLingerDuration>"
    content = f"<General>{general}</General><Discovery>{discovery}</Discovery><Internal>{internal}</Internal>"
    return f'<CycloneDDS><Domain id="any">{content}</Domain></CycloneDDS>'
