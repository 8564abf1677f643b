"""What has to be so before an episode begins: the stack is as it should be, and who listens is found by who speaks."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from rclpy.node import Node
from skd_sim.nodes.publishers import living_publishers

_WAKE = 0.1  # s: how often who waits looks after the processes


class Readiness:
    """Gets the stack ready for one episode after the other."""

    def __init__(
        self,
        node: Node,
        topic: str,
        before_episode: Callable[[], str | None],
        look_after_processes: Callable[[], str | None],
    ) -> None:
        """Do nothing yet.

        Args:
            node: node through which the graph is seen.
            topic: full name of the topic of the car's commands.
            before_episode: resets the stack; returns why it cannot, as the reason of an abort.
            look_after_processes: called while waiting; returns what is wrong with them, if anything.
        """
        self._node = node
        self._topic = topic
        self._before_episode = before_episode
        self._look_after_processes = look_after_processes
        self._done = False
        self._hindrance: str | None = None

    def prepare(self, patience: float = 0.0) -> None:
        """Make the stack ready for the next episode; one that is ready already stays so.

        Args:
            patience: how long to wait for somebody who publishes commands of the car, wall seconds.
        """
        if self._done:
            return
        self._done = True
        self._hindrance = self._before_episode()
        latest = time.monotonic() + patience
        while not self._hindrance and time.monotonic() < latest and not living_publishers(self._node, self._topic):
            self._hindrance = self._look_after_processes()
            time.sleep(_WAKE)

    def take(self) -> str | None:
        """Return why the next episode cannot begin, and begin anew for the one after it."""
        self.prepare()
        self._done = False
        return self._hindrance

    def find_publishers(
        self, subscriptions: Sequence[Any], spin_once: Callable[[float], None], patience: float, *, anew: bool
    ) -> None:
        """Wait, a moment at most, until something is heard on all subscriptions: nodes find each other one by one.

        The simulator begins as soon as *it* hears a controller, so a recording that did not wait for one which takes
        seconds to start would lack its first commands.

        Args:
            subscriptions: subscriptions of the node.
            spin_once: spins the node for this time, s.
            patience: how long to wait at most, wall seconds.
            anew: whether the car's controller has just been started, so that messages of the one before it do not
                count.
        """
        looked = time.monotonic()
        latest = looked + patience
        while time.monotonic() < latest and not (
            all(one.get_publisher_count() for one in subscriptions)
            and (not anew or living_publishers(self._node, self._topic))
        ):
            spin_once(0.01)
            if time.monotonic() - looked > _WAKE:
                looked = time.monotonic()
                self._look_after_processes()
