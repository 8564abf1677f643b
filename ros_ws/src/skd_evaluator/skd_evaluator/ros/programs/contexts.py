"""Contexts of this process, one a domain, that are not taken down before its end.

The last node of a context takes its participant with it, and that may hang for ever in the middleware, in a loop that
holds Python's global lock (eProsima/Fast-DDS issue 6513), with an assessment that is not written yet. So a graph that
has ended leaves its context and its nodes as they are. The next graph of this process takes both over: then its
predecessor's nodes go, but not the participant, which a node without anything keeps. Python's own end takes down all
that is left, within a bound (`skd_sim.start`).
"""

from __future__ import annotations

import atexit
import contextlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from skd_evaluator.ros.programs.domain import give_back


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
    """Yield a context of a domain, and a list for nodes that are to live as long as it does.

    Contexts of other domains that nobody uses any more are taken down.
    """
    with _lock:
        place = _idle.pop(domain, None)
        others = [_idle.pop(other) for other in list(_idle)]
    for other in others:
        other.end()
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
        give_back(domain)
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
