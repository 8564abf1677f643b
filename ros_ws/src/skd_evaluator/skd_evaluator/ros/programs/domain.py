"""A ROS domain of one's own, so that two graphs on one machine do not see each other."""

from __future__ import annotations

import os
import random
import socket
import sys
from collections.abc import Collection

from skd_sim.errors import UsageError

_HIGHEST_DOMAIN = 101  # above it, DDS ports run into Linux's ephemeral range
_PORT_BASE, _PORTS_PER_DOMAIN, _FIRST_UNICAST = 7400, 250, 10  # DDSI-RTPS 2.2, section 9.6.1


_reserved: list[socket.socket] = []
"""Held until this process ends, so that no other chooses the same domain before its nodes are up."""


def _reserve(domain: int) -> bool:
    """Whether the domain is now ours among all processes that choose one by this function (Linux only, else always)."""
    if not sys.platform.startswith("linux"):
        return True
    holder = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        holder.bind(f"\0skd-ros-domain-{domain}")
    except OSError:
        holder.close()
        return False
    _reserved.append(holder)
    return True


_given_back: list[int] = []
"""Domains in which a graph of this process has ended; its participant is still there, for the next one."""


def give_back(domain: int) -> None:
    """Say that a graph of this process has ended in a domain: the next one may be there."""
    if domain not in _given_back:
        _given_back.append(domain)


def _in_use(domain: int) -> bool:
    """Whether a participant of this machine holds the domain's first unicast discovery port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("0.0.0.0", _PORT_BASE + _PORTS_PER_DOMAIN * domain + _FIRST_UNICAST))
        except OSError:
            return True
    return False


def choose_domain() -> int:
    """Return $ROS_DOMAIN_ID where it is set, else a domain that nobody on this machine uses.

    Raises:
        UsageError: the variable is not a domain.
    """
    given = os.environ.get("ROS_DOMAIN_ID", "")
    if given:
        if not (given.isdecimal() and int(given) <= 232):
            raise UsageError(f"ROS_DOMAIN_ID must be a whole number from 0 to 232, got {given!r}")
        return int(given)
    return free_domain()


def free_domain(others: Collection[int] = ()) -> int:
    """Return a domain that nobody on this machine uses.

    Args:
        others: domains that are taken, although nobody may be there yet.

    Raises:
        UsageError: there is none.
    """
    for domain in [*_given_back]:
        if domain not in others:
            _given_back.remove(domain)
            return domain
    candidates = random.SystemRandom().sample(range(1, _HIGHEST_DOMAIN + 1), _HIGHEST_DOMAIN)
    for domain in candidates:
        if domain not in others and not _in_use(domain) and _reserve(domain):
            return domain
    raise UsageError("every ROS domain from 1 to 101 is in use on this machine; set ROS_DOMAIN_ID")
