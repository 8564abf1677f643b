"""A drive through the node graph: a user at the keys is the adversary, a node of this process, and sees it all."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from skd_adversary.adversary import make_adversary
from skd_adversary.ros.adversary_node import AdversaryNode
from skd_sim.ros.support import spin
from skd_sim.world.episode import EpisodeLog, EpisodeSpec

from skd_evaluator.driving.drive import Drive, HandFor, LeftError, Show, Wish
from skd_evaluator.ros.evaluator import Evaluator

_FAREWELL = 2.0  # s for the node's thread to end


class Watched:
    """What a graph needs so that a user can watch and take part.

    Attributes:
        show: called with each situation.
    """

    def __init__(self, hand_for: HandFor, show: Show, look: Callable[[], Wish]) -> None:
        """Prepare.

        Args:
            hand_for: gives who moves the adversary.
            show: called with each situation.
            look: says what the user wishes.
        """
        self._hand_for, self.show, self._look = hand_for, show, look
        self._evaluator: Evaluator | None = None

    @contextmanager
    def adversary(self, context: Context) -> Iterator[Node]:
        """Run the adversary's node in a context, in a thread, as long as this lasts, and yield it."""
        node = AdversaryNode(make=lambda one: self._hand_for(one) or make_adversary(one), context=context)
        over = threading.Event()

        def run() -> None:
            with suppress(ExternalShutdownException):
                spin(node, over.is_set)

        thread = threading.Thread(target=run, name="skd-drive", daemon=True)
        thread.start()
        try:
            yield node
        finally:
            over.set()
            thread.join(_FAREWELL)

    def check(self) -> None:
        """Do what the user wishes; to be called while the evaluator waits.

        Raises:
            LeftError: the user has seen enough.
        """
        wish = self._look()
        if wish is Wish.QUIT:
            raise LeftError
        if wish is Wish.AGAIN and self._evaluator is not None:
            self._evaluator.give_up("the user began anew")

    def driver(self, evaluator: Evaluator) -> Drive:
        """Return what runs an episode of an evaluator's graph."""
        self._evaluator = evaluator

        def drive(episode: EpisodeSpec) -> EpisodeLog:
            log = evaluator.run_episode(episode)
            if self._look() is not Wish.NONE:
                raise LeftError
            return log

        return drive
