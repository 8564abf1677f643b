"""One topic of commands, as the simulator sees it: who publishes there, what was answered, and what was of no use."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

from rclpy.node import Node

from skd_sim.aborts import AbortKind, abort_reason
from skd_sim.nodes.publishers import living_publishers, publisher_names
from skd_sim.stamps import NANOSECONDS


class CommandSource:
    """What is known of those who send one kind of command.

    Attributes:
        who: what the sender is called in messages.
        topic: of its commands.
        subscription: to it; to be set before the first episode.
    """

    def __init__(self, node: Node, topic: str, who: str) -> None:
        """Know nothing yet."""
        self.who = who
        self.topic = topic
        self.subscription: Any = None
        self._node = node
        self._alone = f"{who} ({topic})"
        self.begin()

    def begin(self) -> None:
        """Forget the last episode."""
        self._answers: dict[int, Hashable] = {}
        self._ignored = 0
        self._newest = 0

    def ignore(self, stamp: int) -> None:
        """Take note of a command that is for no tick that is wanted."""
        self._ignored += 1
        self._newest = max(self._newest, stamp)

    def contradicts(self, stamp: int, answer: Hashable, start: int) -> str | None:
        """Take note of an answer to a tick, and return what is wrong with it beside an earlier one, if anything.

        Which of two would count would depend on which comes first. Tick 0 is repeated, and so may its answer be.

        Args:
            stamp: of the tick, ns.
            answer: to it.
            start: stamp of tick 0, ns.
        """
        known = self._answers.setdefault(stamp, answer)
        if known is answer:
            return None
        if stamp == start and known == answer:
            return None
        names = publisher_names(self._node, self.topic)
        by = f" (it has {len(names)} publishers: {', '.join(names)})" if len(names) > 1 else ""
        how = "with different commands" if known != answer else "with the same command"
        return abort_reason(
            AbortKind.SECOND_SENDER,
            f"{self._alone} answered the tick at {_seconds(stamp - start)} of the episode twice, {how}{by}",
        )

    def crowd(self) -> str | None:
        """Return who the senders are where they are several; none where there is one, or nobody."""
        if self.subscription.get_publisher_count() < 2 or len(living_publishers(self._node, self.topic)) < 2:
            return None
        names = publisher_names(self._node, self.topic)
        return abort_reason(
            AbortKind.SECOND_SENDER, f"{len(names)} nodes publish {self.topic}, one may: {', '.join(names)}"
        )

    def silence(self, wanted: int, limit: float, tick: int) -> str:
        """Return why there is no answer to a tick, as a reason.

        Args:
            wanted: stamp of the tick, ns.
            limit: how long it was waited for, s of wall time.
            tick: its number.
        """
        silent = f"{self._alone} stayed silent for {limit:g} s at tick {tick}"
        if self._ignored:
            return abort_reason(
                AbortKind.WRONG_STAMP,
                f"{silent}: its commands carry other stamps ({self._ignored} came; newest {_seconds(self._newest)}, "
                f"wanted {_seconds(wanted)})",
            )
        if self.subscription.get_publisher_count():
            return abort_reason(AbortKind.NO_ANSWER, silent)
        name = self._node.resolve_topic_name(self.topic)
        unfit = self._node.count_publishers(name)
        if unfit:
            return abort_reason(
                AbortKind.NOT_STARTED,
                f"{silent}: type or quality of service of what comes on {name} do not fit (it has to be reliable)",
            )
        return abort_reason(AbortKind.NOT_STARTED, f"{silent}: nobody publishes on {name}{self._elsewhere(name)}")

    def _elsewhere(self, name: str) -> str:
        """Return on which other topics somebody publishes what would be commands."""
        kind = f"{self.subscription.msg_type.__module__.split('.')[0]}/msg/{self.subscription.msg_type.__name__}"
        others = [
            topic
            for topic, kinds in self._node.get_topic_names_and_types()
            if kind in kinds and topic != name and self._node.count_publishers(topic)
        ]
        others = [topic for topic in others if not topic.endswith("/velocity_command")]
        return f", but somebody does so on {', '.join(others)}" if others else ""


def _seconds(stamp: int) -> str:
    return f"{stamp / NANOSECONDS:.3f} s"
