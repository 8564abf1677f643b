"""Node `car_controller`: the built-in car under test, or a `package.module:Class`, behind standard topics."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import AccelStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from skd_sim.controllers.controller import (
    Controller,
    SensingController,
    make_controller,
    require_control_period,
    require_sensor,
    sight_of,
)
from skd_sim.errors import NoNumberError, UsageError
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.options.options import option
from skd_sim.ros import from_messages
from skd_sim.ros.support import STREAM, EpisodeFollower, GraphNode, Moments, Topic, declare, run_node
from skd_sim.ros.to_messages import acceleration_command


@dataclass(frozen=True)
class _ControllerOptions:
    """The table of the node's parameters."""

    controller: str = option(
        "", "basic, cal, carla, rss, …, or package.module:Class", unset="the one that the episode names"
    )
    multiplier: float = option(
        -1.0, "C of the basic controller; negative: the one that the episode names", within=(-1.0, 100.0)
    )


TABLES = (_ControllerOptions,)


class CarController(GraphNode):
    """Answers each state with the acceleration for the coming control period."""

    def __init__(self) -> None:
        """Declare parameters and topics."""
        super().__init__("car_controller")
        self._settings = declare(self, *TABLES)
        if self._settings["controller"]:
            make_controller(self._settings["controller"], max(0.0, self._settings["multiplier"]))
        self._controller: Controller | None = None
        self._moments = Moments(Topic.EGO_ODOMETRY, Topic.ADVERSARY_ODOMETRY)
        self._scans: Any = None  # subscription, while the controller senses
        self._answered: dict[int, AccelStamped] = {}
        self._command = self.create_publisher(AccelStamped, Topic.ACCELERATION_COMMAND, STREAM)
        self._follower = EpisodeFollower(self, from_messages.message_to_car_episode, self._on_begin, self._on_frame)
        self.create_subscription(
            Odometry, Topic.EGO_ODOMETRY, partial(self._hear, Topic.EGO_ODOMETRY, from_messages.odometry_to_car), STREAM
        )
        of_adversary = partial(self._hear, Topic.ADVERSARY_ODOMETRY, from_messages.odometry_to_adversary)
        self.create_subscription(Odometry, Topic.ADVERSARY_ODOMETRY, of_adversary, STREAM)

    def _on_begin(self, episode: from_messages.CarEpisode) -> None:
        name = self._settings["controller"] or episode.controller
        chosen = self._settings["multiplier"]
        car = CarUnderTest(name, chosen if chosen >= 0.0 else episode.multiplier)
        if car.is_external:
            raise UsageError("controller is external: this node is not the car under test")
        self._controller = make_controller(car.controller, car.multiplier)
        require_sensor(self._controller, name, episode.scenario)
        require_control_period(self._controller, name, episode.scenario)
        self._sight = sight_of(self._controller, episode.scenario)
        self._listen_to_scans(senses=isinstance(self._controller, SensingController))
        self._controller.reset(episode.scenario, episode.rng)
        self._answered.clear()

    def _listen_to_scans(self, *, senses: bool) -> None:
        """Subscribe only for a controller that senses: a scan is not made unless a node listens."""
        self._moments.needed = {Topic.EGO_ODOMETRY, Topic.ADVERSARY_ODOMETRY} | ({Topic.EGO_SCAN} if senses else set())
        if senses and self._scans is None:
            of_laser = partial(self._hear, Topic.EGO_SCAN, from_messages.message_to_scan)
            self._scans = self.create_subscription(LaserScan, Topic.EGO_SCAN, of_laser, STREAM)
        elif not senses and self._scans is not None:
            self.destroy_subscription(self._scans)
            self._scans = None

    def _hear(self, topic: str, read: Callable[[Any], Any], message: Any) -> None:
        stamp = from_messages.from_stamp(message.header.stamp)
        if (seen := self._moments.put(stamp, topic, read(message))) is not None:
            self._follower.deliver(stamp, seen)

    def _on_frame(self, tick: int, period: int, stamp: int, seen: dict[str, Any]) -> None:
        # A tick may be repeated while other nodes start; the controller must see it once.
        if stamp not in self._answered:
            assert self._controller is not None
            if isinstance(self._controller, SensingController):
                if Topic.EGO_SCAN not in seen:
                    return  # tick 0 of the first episode, before the subscription was there: it will be repeated
                self._controller.sense(seen[Topic.EGO_SCAN])
            car, adversary = seen[Topic.EGO_ODOMETRY], seen[Topic.ADVERSARY_ODOMETRY]
            try:
                command = self._controller.command(car, self._sight(car, adversary, tick, period))
            except NoNumberError as error:
                self.get_logger().error(str(error))
                command = math.nan  # the simulator ends the episode for it
            self._answered = {stamp: acceleration_command(command, stamp)}
        self._command.publish(self._answered[stamp])


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_node(CarController, args)


if __name__ == "__main__":
    raise SystemExit(main())
