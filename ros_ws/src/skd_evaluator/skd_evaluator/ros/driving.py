"""The adversary of a drive through the node graph: a node of this process, which also sees what happens."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from skd_adversary.adversary import Adversary, make_adversary
from skd_adversary.ros.adversary_node import AdversaryNode
from skd_sim.options.options import CommandOptions
from skd_sim.ros.commands import Quantity, car_commands
from skd_sim.ros.from_messages import from_stamp, odometry_to_adversary
from skd_sim.ros.support import ADVERSARY_ODOMETRY, STREAM, Moments, spin
from skd_sim.world.episode import EpisodeLog, EpisodeSpec
from skd_sim.world.state import AdversaryState, CarState
from skd_sim.world.timing import CommandAges

from skd_evaluator.driving.drive import Drive, HandFor, LeftError, Onlooker, Show, Wish
from skd_evaluator.ros.evaluator import Evaluator

_UNITS = {Quantity.ACCELERATION: "m/s²", Quantity.SPEED: "m/s"}
_FAREWELL = 2.0  # s for the node's thread to end


class DrivingNode(AdversaryNode):
    """The adversary's node, moved by a hand or along φ; it shows each state of the car as it comes."""

    def __init__(self, context: Context, commands: CommandOptions, hand_for: HandFor, show: Show) -> None:
        """Declare its topics.

        Args:
            context: ROS context of the graph.
            commands: what the car under test publishes.
            hand_for: gives who moves the adversary.
            show: called with each situation.
        """

        def make(episode: EpisodeSpec) -> Adversary:
            return hand_for(episode) or make_adversary(episode)

        super().__init__(make=make, context=context)
        self._heard = car_commands(commands)
        self._show, self._unit = show, _UNITS[self._heard.format.quantity]
        self._ages = CommandAges(waited_for=False)
        self._onlooker: Onlooker | None = None
        self._forget()
        self.create_subscription(Odometry, ADVERSARY_ODOMETRY, self._on_adversary, STREAM)
        self.create_subscription(self._heard.kind, commands.command_topic, self._on_drive, STREAM)

    def _on_begin(self, episode: EpisodeSpec) -> None:
        super()._on_begin(episode)
        self._onlooker = Onlooker(episode, self._unit)
        self._forget()

    def _forget(self) -> None:
        self._moment = (-1, -1)
        self._moments = Moments(CarState, AdversaryState)
        self._drive = math.nan
        self._ages.begin()

    def _on_frame(self, tick: int, period: int, stamp: int, car: CarState) -> None:
        super()._on_frame(tick, period, stamp, car)
        now = time.monotonic()
        if not math.isnan(self._drive) and (tick, period) != self._moment:
            self._ages.use(now)
        self._moment = tick, period
        self._ages.publish(stamp, now)
        self._look(stamp, CarState, (tick, period, car))

    def _on_adversary(self, message: Odometry) -> None:
        stamp = from_stamp(message.header.stamp)
        self._look(stamp, AdversaryState, odometry_to_adversary(message))

    def _on_drive(self, message: Any) -> None:
        if self._moment != (-1, -1):
            stamp, command = self._heard.read(message)
            self._drive = command[0]
            self._ages.come(stamp or None, time.monotonic())

    def _look(self, stamp: int, part: type, value: Any) -> None:
        """Show a moment of which both states are there."""
        if self._onlooker is not None and (both := self._moments.put(stamp, part, value)) is not None:
            age = self._ages.ages[-1] if self._ages.ages else math.nan
            tick, period, car = both[CarState]
            self._show(self._onlooker.see(tick, period, car, both[AdversaryState], self._drive, age))


class Watched:
    """What a graph needs so that a user can watch and take part."""

    def __init__(self, commands: CommandOptions, hand_for: HandFor, show: Show, look: Callable[[], Wish]) -> None:
        """Prepare.

        Args:
            commands: what the car under test publishes.
            hand_for: gives who moves the adversary.
            show: called with each situation, in a thread of its own.
            look: says what the user wishes.
        """
        self._commands, self._hand_for, self._show, self._look = commands, hand_for, show, look
        self._evaluator: Evaluator | None = None

    @contextmanager
    def adversary(self, context: Context) -> Iterator[Node]:
        """Run the adversary's node in a context, in a thread, as long as this lasts, and yield it."""
        node = DrivingNode(context, self._commands, self._hand_for, self._show)
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
