"""Simulator and adversary as plain objects in the evaluator's process: they hear each other by calls.

Topics carry the states to the car and its commands back, and whatever somebody else listens to. While the adversary
plans, the car decides.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.node import Node
from skd_adversary.ros.adversary_node import GraphAdversary
from skd_msgs.msg import Episode as EpisodeMsg
from skd_sim.ros.simulator_node import GraphSimulator
from skd_sim.simulators.named_simulator import NamedSimulator
from skd_sim.world.aborts import AbortKind, abort_reason
from skd_sim.world.episode import Episode, Outcome
from skd_sim.world.simulator import Frame
from skd_sim.world.state import CarState

from skd_evaluator.assessment.stages.graph_options import GraphOptions


class Composed:
    """Both sides of an episode, through the evaluator's own node."""

    def __init__(
        self,
        node: Node,
        options: GraphOptions,
        on_frame: Callable[[int, Frame], None],
        on_result: Callable[[Any], None],
    ) -> None:
        """Make both.

        Args:
            node: the evaluator, through which they speak with everybody else.
            options: how the graph is run.
            on_frame: called with each state and its stamp (ns).
            on_result: called with the result of each episode.
        """
        self._on_frame, self._on_result = on_frame, on_result
        self._simulator = GraphSimulator(node, NamedSimulator(), options.simulator_parameters(), alone=False)
        self._simulator.on_frame = self._hear_frame
        self._simulator.on_result = self._hear_result
        self._adversary = GraphAdversary(node)
        self._due: Callable[[], None] | None = None
        self._problem: str | None = None

    def begin(self, episode: Episode, message: EpisodeMsg) -> None:
        """Begin an episode, which a message says to others; what goes wrong is said by `problem`."""
        self._due = self._problem = None
        try:
            self._adversary.begin(episode)
        except Exception as error:  # an objective may be of somebody else's package
            self._fail(error)
        else:
            self._simulator.begin(message)

    def work(self) -> None:
        """Let the adversary decide, if it is its turn; to be called when all others have been heard."""
        due, self._due = self._due, None
        if due is not None:
            due()

    def problem(self) -> str | None:
        """Return why the episode cannot go on, as the reason of an abort; none where it can."""
        return self._problem

    def _hear_frame(self, stamp: int, frame: Frame) -> None:
        self._on_frame(stamp, frame)
        if not frame.period and frame.outcome == Outcome.RUNNING:  # the car decides in between, the adversary does not
            self._due = partial(self._decide, frame.tick, stamp, frame.car)

    def _hear_result(self, result: Any) -> None:
        self._due = None  # nobody waits for an answer to the last state
        self._on_result(result)

    def _decide(self, tick: int, stamp: int, car: CarState) -> None:
        try:
            velocity = self._adversary.answer(tick, stamp, car)
        except Exception as error:
            self._fail(error)
            return
        if velocity is not None:
            self._simulator.walk(stamp, velocity)

    def _fail(self, error: Exception) -> None:
        said = str(error).partition("\n")[0]
        self._problem = abort_reason(AbortKind.FAILED, f"adversary: {type(error).__name__}: {said}")
