"""A node that drives by what SKD says of an episode, where it says it: it brakes for who is known to attack.

It writes down what it has heard, a line of JSON for each message.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from fake_nodes import run
from geometry_msgs.msg import AccelStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from skd_msgs.msg import Episode, EpisodeReceipt
from std_msgs.msg import Float64
from visualization_msgs.msg import MarkerArray

_ALL = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class ListeningCar(Node):
    """Stands still as long as an adversary is known to attack; else it never brakes."""

    def __init__(self, file: Path) -> None:
        super().__init__("listening_car")
        self._file = file
        self._mode = 0
        self._command = self.create_publisher(AccelStamped, "/ego/acceleration_command", 10)
        self.create_subscription(Episode, "/skd/episode", self._on_episode, _ALL)
        self.create_subscription(EpisodeReceipt, "/skd/episode_receipt", self._on_receipt, _ALL)
        self.create_subscription(MarkerArray, "/skd/markers", self._on_markers, 10)
        self.create_subscription(Odometry, "/ego/odometry", self._on_odometry, 10)
        for figure in ("/skd/clearance", "/skd/deformation"):
            self.create_subscription(Float64, figure, partial(self._on_figure, figure), 100)
        self.create_subscription(Odometry, "/skd/believed_car", self._on_belief, 100)

    def _note(self, **heard: object) -> None:
        with self._file.open("a") as file:
            file.write(json.dumps(heard) + "\n")

    def _on_episode(self, message: Any) -> None:
        self._mode = message.mode
        self._note(
            what="episode",
            mode=message.mode,
            telling=[
                message.episode_id,
                message.seed,
                message.simulations,
                message.objective,
                message.car_model,
                message.safe_trajectory_name,
                len(message.safe_trajectory),
                message.options,
            ],
            campaign=message.campaign,
            scenario=bool(message.scenario),
        )

    def _on_receipt(self, message: Any) -> None:
        self._note(what="receipt", telling=[message.episode_id], specification=message.specification)

    def _on_markers(self, message: Any) -> None:
        self._note(what="markers", ids=[marker.id for marker in message.markers])

    def _on_figure(self, name: str, message: Any) -> None:
        self._note(what=name, value=message.data)

    def _on_belief(self, message: Any) -> None:
        self._note(what="/skd/believed_car", value=message.twist.twist.linear.x)

    def _on_odometry(self, odometry: Any) -> None:
        message = AccelStamped(header=odometry.header)
        message.accel.linear.x = -9.0 if self._mode == Episode.MODE_KAMIKAZE else 0.0
        self._command.publish(message)


def main(args: Sequence[str]) -> int:
    """Run the node; the argument is the file that it writes."""
    return run(lambda: ListeningCar(Path(args[0])), args)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
