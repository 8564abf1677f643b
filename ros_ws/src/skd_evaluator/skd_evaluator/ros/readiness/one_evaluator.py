"""Whether the evaluator alone hands out episodes: what another node announces, car and adversary would run as well.

Nodes take the first announcement of an episode and ignore what is said of it again. So whoever announces the next
episode first decides how it is run, with however few simulations, and the evaluator's own announcement comes to
nothing. The evaluator hears all of them, too.
"""

from __future__ import annotations

from collections import deque
from typing import Any

from rclpy.node import Node
from rclpy.serialization import serialize_message
from skd_msgs.msg import Episode as EpisodeMsg
from skd_sim.messages.read_message import read_message
from skd_sim.messages.stream_cdr import CdrError
from skd_sim.nodes.publishers import living_publishers, publisher_names
from skd_sim.nodes.support import EPISODE, LATCHED

from skd_evaluator.errors import AssessmentError

_REMEMBERED = 16  # announcements, own ones and foreign ones: what is heard may lag behind what is said


class OneEvaluator:
    """Hears who announces episodes of a campaign; cheap as long as nobody else does.

    Attributes:
        subscription: to what is announced.
    """

    def __init__(self, node: Node, campaign: str) -> None:
        """Listen on behalf of an evaluator.

        Args:
            node: the evaluator, which publishes on `EPISODE` itself.
            campaign: name of its campaign; episodes of other campaigns are ignored.
        """
        self._node, self._campaign = node, campaign
        self._own: deque[Any] = deque(maxlen=_REMEMBERED)
        self._own_bytes: deque[bytes] = deque(maxlen=_REMEMBERED)
        self._foreign: deque[Any] = deque(maxlen=_REMEMBERED)
        self.subscription = node.create_subscription(EpisodeMsg, EPISODE, self._on_episode, LATCHED, raw=True)

    def announce(self, message: Any) -> bytes:
        """Note what the evaluator is about to announce, and return the bytes that it has to publish for that.

        What is between fields is left to chance by whoever makes bytes of a message.
        """
        data = bytes(serialize_message(message))
        self._own.append(message)
        self._own_bytes.append(data)
        return data

    def _on_episode(self, data: bytes) -> None:
        if bytes(data) in self._own_bytes:
            return
        try:
            message = read_message(data, EpisodeMsg)
        except CdrError:
            return  # nobody can take it for an episode; who has sent it is seen as a second publisher
        if message.campaign == self._campaign and message not in self._own:
            self._foreign.append(message)

    def require(self) -> None:
        """Refuse a graph in which somebody else hands out episodes.

        Raises:
            AssessmentError: with the names of all who do.
        """
        topic = self._node.resolve_topic_name(EPISODE)
        several = self._node.count_publishers(topic) > 1 and len(living_publishers(self._node, EPISODE)) > 1
        if not several and not self._foreign:
            return
        names = publisher_names(self._node, EPISODE, least=2)
        if several:
            said = f"{len(names)} nodes publish {topic}, which is the evaluator's alone: {' and '.join(names)}"
        else:
            number = int(self._foreign[0].episode_id)
            said = f"a node that is gone has published {topic}, which is the evaluator's alone, of episode {number}"
        raise AssessmentError(f"{said}; end all but one")
