"""Nodes that do what no node should: controllers, second simulators, and a simulator that lies."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Sequence
from typing import Any

from fake_nodes import run
from geometry_msgs.msg import AccelStamped, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from skd_adversary.nodes.adversary_node import AdversaryNode
from skd_msgs.msg import Episode, EpisodeResult
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Outcome
from skd_sim.episode.stamps import NANOSECONDS, next_start, tick_stamp
from skd_sim.nodes.support import LATCHED, STREAM
from skd_sim.nodes.vehicle_simulator import VehicleSimulator

COMMANDS = "/ego/acceleration_command"
ANSWERS = {"twice": (0.0, -5.0), "echo": (0.0, 0.0), "nan": (math.nan,), "rocket": (50.0,)}  # to a tick, m/s²


class Hostile(Node):
    """Answers the car's odometry in a way of its own."""

    def __init__(self, kind: str) -> None:
        super().__init__(f"hostile_{kind}")
        self._kind = kind
        topic = {"elsewhere": "/brake", "patient": "/adversary/velocity_command"}.get(kind, COMMANDS)
        quality = QoSProfile(depth=10)
        if kind == "unreliable":
            quality.reliability = ReliabilityPolicy.BEST_EFFORT
        self._type = TwistStamped if kind == "patient" else AccelStamped
        self._publisher = self.create_publisher(self._type, topic, quality)
        self._heard = 0
        self._stamps: list[tuple[int, int]] = []
        self.create_subscription(Odometry, "/ego/odometry", self._on_odometry, 10)

    def _on_odometry(self, odometry: Odometry) -> None:
        self._heard += 1
        if self._kind == "patient":
            self._stamps.append((odometry.header.stamp.sec, odometry.header.stamp.nanosec))
            first = self._stamps[-1] == self._stamps[0]
            for _ in range(2 * (self._heard > 1) if first else 1):
                self._publisher.publish(TwistStamped(header=odometry.header))
            return
        if self._kind == "mute":
            return
        for value in {"twice": (0.0, -5.0), "echo": (0.0, 0.0), "nan": (math.nan,), "rocket": (50.0,)}.get(
            self._kind, (0.0,)
        ):
            message = AccelStamped(header=odometry.header)
            if self._kind == "stamps":
                message.header.stamp.nanosec += 1
            message.accel.linear.x = value
            self._publisher.publish(message)


class Forger(Node):
    """Says of each episode, as soon as it is handed out, that it went well: what a car under test might like."""

    def __init__(self, kind: str) -> None:
        super().__init__(f"hostile_{kind}")
        self._publisher = self.create_publisher(EpisodeResult, "/skd/episode_result", STREAM)
        self.create_subscription(Episode, "/skd/episode", self._on_episode, LATCHED)

    def _on_episode(self, episode: Episode) -> None:
        result = EpisodeResult(header=episode.header, campaign=episode.campaign, episode_id=episode.episode_id)
        result.start = episode.header.stamp
        result.outcome, result.ticks = int(Outcome.ARRIVED), 0
        result.impact_time = result.impact_speed = math.nan
        self._publisher.publish(result)


class Announcer(Node):
    """Hands out the evaluator's next episode before the evaluator does, with one simulation a decision."""

    def __init__(self, kind: str) -> None:
        super().__init__(f"hostile_{kind}")
        self._publisher = self.create_publisher(Episode, "/skd/episode", LATCHED)
        self._episode: Episode | None = None
        self.create_subscription(Episode, "/skd/episode", self._on_episode, LATCHED)
        self.create_subscription(EpisodeResult, "/skd/episode_result", self._on_result, STREAM)

    def _on_episode(self, episode: Episode) -> None:
        self._episode = episode

    def _on_result(self, _result: EpisodeResult) -> None:
        episode = self._episode
        if episode is None or episode.simulations == 1:
            return
        scenario = load_scenario("crossing")
        start = episode.header.stamp.sec * NANOSECONDS + episode.header.stamp.nanosec
        following = next_start(tick_stamp(start, scenario.ticks, scenario.time_step))
        episode.header.stamp.sec, episode.header.stamp.nanosec = divmod(following, NANOSECONDS)
        episode.episode_id += 1
        episode.simulations = 1
        self._publisher.publish(episode)


class Frugal(AdversaryNode):
    """Plans with one simulation, whatever the evaluator hands out: as if somebody else had handed out that."""

    def _on_begin(self, episode: Any) -> None:
        super()._on_begin(dataclasses.replace(episode, simulations=1))


class SecondSimulator(Node):
    """Publishes the car's state as well."""

    def __init__(self, kind: str) -> None:
        super().__init__(f"hostile_{kind}")
        self._publisher = self.create_publisher(Odometry, "/ego/odometry", STREAM)


class Liar(VehicleSimulator):
    """Simulates well, and says of a collision what is not so."""

    def __init__(self, lie: str) -> None:
        super().__init__()
        self._lie = lie

    def _publish_result(self, outcome: Outcome, ticks: int, end: int, contact: Any, reason: str) -> None:
        lie = self._lie
        if contact is not None and lie == "impact_speed":
            contact = contact._replace(speed=contact.speed + 0.1)
        if contact is not None and lie == "impact_time":
            contact = contact._replace(fraction=0.5 * contact.fraction)
        if lie == "outcome":
            outcome, contact = Outcome.ARRIVED, None
        if lie == "ticks":
            ticks -= 1
        if lie == "many":
            ticks = 4_000_000_000
        super()._publish_result(outcome, ticks, end, contact, reason)


def make(kind: str) -> Node:
    """Make the node of a name."""
    if kind.startswith("liar:"):
        return Liar(kind.removeprefix("liar:"))
    if kind == "frugal":
        return Frugal()
    return {"forger": Forger, "second_simulator": SecondSimulator, "announcer": Announcer}.get(kind, Hostile)(kind)


def main(args: Sequence[str]) -> int:
    """Run the node that the first argument names."""
    return run(lambda: make(args[0]), args)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
