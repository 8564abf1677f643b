"""ROS domains in which no two graphs of one machine see each other, and this process's contexts in them.

The last node of a context takes its participant with it, and that may hang for ever in the middleware, in a loop that
holds Python's global lock (eProsima/Fast-DDS issue 6513), with an assessment that is not written yet. So a graph that
has ended leaves its context and its nodes as they are. The next graph of this process in that domain takes both over:
then its predecessor's nodes go, but not the participant, which a node without anything keeps. Python's own end takes
down all that is left, within a bound (`skd_sim.start`).
"""

from __future__ import annotations

import atexit
import contextlib
import os
import random
import socket
import sys
import threading
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from skd_sim.errors import UsageError

_HIGHEST_DOMAIN = 101  # above it, DDS ports run into Linux's ephemeral range
_PORT_BASE, _PORTS_PER_DOMAIN, _FIRST_UNICAST = 7400, 250, 10  # DDSI-RTPS 2.2, section 9.6.1
_reserved: list[socket.socket] = []
"""Held until this process ends, so that no other chooses the same domain before its nodes are up."""


def choose_domain() -> int:
    """Return $ROS_DOMAIN_ID where it is set, else a domain that nobody on this machine uses.

    Raises:
        UsageError: the variable is not a domain.
    """
    given = os.environ.get("ROS_DOMAIN_ID", "")
    if not given:
        return free_domain()
    if not (given.isdecimal() and int(given) <= 232):
        raise UsageError(f"ROS_DOMAIN_ID must be a whole number from 0 to 232, got {given!r}")
    return int(given)


def free_domain(others: Collection[int] = ()) -> int:
    """Return a domain that nobody on this machine uses, or in which a graph of this process has ended.

    Args:
        others: domains that are taken, although nobody may be there yet.

    Raises:
        UsageError: there is none.
    """
    candidates = random.SystemRandom().sample(range(1, _HIGHEST_DOMAIN + 1), _HIGHEST_DOMAIN)
    for domain in [*_idle, *candidates]:
        if domain not in others and (domain in _idle or (not _in_use(domain) and _reserve(domain))):
            return domain
    raise UsageError("every ROS domain from 1 to 101 is in use on this machine; set ROS_DOMAIN_ID")


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


def _in_use(domain: int) -> bool:
    """Whether a participant of this machine holds the domain's first unicast discovery port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("0.0.0.0", _PORT_BASE + _PORTS_PER_DOMAIN * domain + _FIRST_UNICAST))
        except OSError:
            return True
    return False


@dataclass
class _Place:
    """A context, the node that keeps its participant, and nodes that have done their work."""

    context: Context
    keeper: Node
    done: list[Node] = field(default_factory=list)

    def clear(self) -> None:
        while self.done:
            self.done.pop().destroy_node()

    def end(self) -> None:
        self.clear()
        self.keeper.destroy_node()
        rclpy.try_shutdown(context=self.context)


_idle: dict[int, _Place] = {}
_lock = threading.Lock()  # of these


@contextlib.contextmanager
def context_of(domain: int) -> Iterator[tuple[Context, list[Node]]]:
    """Yield a context of a domain, and a list for nodes that are to live as long as it does."""
    with _lock:
        place = _idle.pop(domain, None)
    if place is None:
        context = Context()
        rclpy.init(args=[], context=context, domain_id=domain)
        keeper = Node("_skd_context", context=context, start_parameter_services=False, enable_rosout=False)
        place = _Place(context, keeper)
    place.clear()
    try:
        yield place.context, place.done
    finally:
        with _lock:
            second = _idle.get(domain)  # another graph's in the same domain
            _idle[domain] = place
        if second is not None:
            second.end()


@atexit.register
def end_contexts() -> None:
    """Take down all contexts that nobody uses."""
    with _lock:
        places = list(_idle.values())
        _idle.clear()
    for place in places:
        place.end()
