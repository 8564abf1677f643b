"""What a node needs to follow the episodes: which one it is, and which tick a stamp belongs to.

Topics have no common order: the state of a new episode may arrive before the episode's own message, and is then kept.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar

from rclpy.node import Node
from skd_msgs.msg import Episode as EpisodeMsg

from skd_sim.ros.from_messages import from_stamp
from skd_sim.ros.support import EPISODE, LATCHED
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.stamps import period_of


class _Told(Protocol):
    """What a node is told of an episode: the scenario at least."""

    @property
    def scenario(self) -> Scenario:
        """In which both move."""


_Episode = TypeVar("_Episode", bound=_Told)


class EpisodeFollower(Generic[_Episode]):
    """Hands each message to its tick, and control period, of the current episode.

    Attributes:
        episode: the current one, once there is one.
        announced: the message that announced the one that begins, or has begun, as it was published.
    """

    def __init__(
        self,
        node: Node,
        read: Callable[[Any], _Episode],
        begin: Callable[[_Episode], None],
        at_frame: Callable[[int, int, int, Any], None],
    ) -> None:
        """Subscribe to episodes.

        Args:
            node: node that follows the episodes.
            read: gives what the node is told of an episode by the message that announces it.
            begin: called with each new episode; a ValueError from it or from `read` is logged, the episode ignored.
            at_frame: called with (tick, control period in it, stamp in ns, item) for each item of the current episode.
        """
        self.episode: _Episode | None = None
        self.announced: Any = None
        self._start = 0
        self._node, self._read = node, read
        self._begin = begin
        self._at_frame = at_frame
        self._identity = ("", -1, 0)
        self._latest = (0, 0)
        self._early: list[tuple[int, Any]] = []
        node.create_subscription(EpisodeMsg, EPISODE, self._on_episode, LATCHED)

    def _on_episode(self, message: Any) -> None:
        start = from_stamp(message.header.stamp)
        identity = (str(message.campaign), int(message.episode_id), start)
        if self.episode is not None and identity == self._identity:
            return  # said again, because it had not begun everywhere
        self._identity = identity
        self.announced, self._start = message, start
        try:
            episode = self._read(message)
            self._begin(episode)
        except ValueError as error:
            self._node.get_logger().error(f"an episode is ignored: {error}")
            self.episode = None
            return
        self.episode, self._latest = episode, (0, 0)
        early, self._early = self._early, []
        for stamp, item in early:
            self.deliver(stamp, item)

    def deliver(self, stamp: int, item: Any) -> None:
        """Hand over what was stamped `stamp` (ns), now or when its episode begins."""
        if self.episode is not None:
            scenario = self.episode.scenario
            place = period_of(stamp, self._start, scenario.time_step, scenario.control_periods)
            if place is not None and self._latest <= place <= (scenario.ticks, 0):
                self._latest = place
                self._at_frame(*place, stamp, item)
                return
            if place is not None and place < self._latest:
                # Time ran back: another evaluator has begun, and its episode is still on its way. Answering as in the
                # old one would be wrong.
                self.episode = None
        # Only tick 0 of the next episode can come early: everybody waits for everybody there.
        self._early = [*self._early[-1:], (stamp, item)]
