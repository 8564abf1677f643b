"""Simulator and adversary in the evaluator's process: three nodes, one executor, and the car under test apart.

What the three say to each other goes by a call; the wire carries states to the car and its commands back, and whatever
somebody else listens to. While the adversary plans, the car decides.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

from rclpy.context import Context
from rclpy.node import Node
from skd_adversary.nodes.adversary_node import AdversaryNode
from skd_sim.episode.aborts import AbortKind, abort_reason
from skd_sim.nodes.composition.exchange import Exchange
from skd_sim.nodes.composition.place import LogFile, Place
from skd_sim.nodes.support import (
    ADVERSARY_ODOMETRY,
    CLOCK,
    EGO_ODOMETRY,
    EPISODE,
    EPISODE_RECEIPT,
    EPISODE_RESULT,
    ROBOT_DESCRIPTION,
    TF,
    TF_STATIC,
    VELOCITY_COMMAND,
)
from skd_sim.nodes.vehicle_simulator import VehicleSimulator

from skd_evaluator.assessing.graph_options import GraphOptions
from skd_evaluator.ros.programs.node_logs import ADVERSARY, SIMULATOR

_BY_CALL = (
    *(CLOCK, TF, TF_STATIC, ROBOT_DESCRIPTION, EGO_ODOMETRY, ADVERSARY_ODOMETRY),
    *(VELOCITY_COMMAND, EPISODE, EPISODE_RECEIPT, EPISODE_RESULT),
)


class Composed:
    """The nodes that an evaluator has beside it in its process.

    Attributes:
        exchange: by which the evaluator speaks with them.
        nodes: simulator and adversary, which the evaluator's executor has to run.
    """

    def __init__(self, context: Context, options: GraphOptions, secret: bytes, log_folder: Path) -> None:
        """Make them.

        Args:
            context: ROS context of the graph.
            options: how to run it.
            secret: by which what is said of episodes is shut.
            log_folder: folder for what the nodes log, each in a file of its own.
        """
        self.exchange = Exchange([f"/{topic.lstrip('/')}" for topic in _BY_CALL])  # its nodes have no namespace
        self._problems: list[str] = []
        place = partial(Place, context=context, secret=secret or None, exchange=self.exchange, failed=self._failed)
        # First: where they cannot be, no node is left behind.
        logs = {name: LogFile(log_folder / f"{name}.log", name) for name in (SIMULATOR, ADVERSARY)}
        self.nodes: tuple[Node, ...] = (
            VehicleSimulator(place(values=options.simulator_parameters(), log=logs[SIMULATOR])),
            AdversaryNode(place(log=logs[ADVERSARY])),
        )

    def _failed(self, name: str, error: Exception) -> None:
        said = str(error).partition("\n")[0]
        self._problems.append(abort_reason(AbortKind.FAILED, f"{name}: {type(error).__name__}: {said}"))

    def check(self) -> str | None:
        """Return what was wrong since it was asked last; none where all are well."""
        problems, self._problems = self._problems, []
        return " and ".join(dict.fromkeys(problems)) or None
