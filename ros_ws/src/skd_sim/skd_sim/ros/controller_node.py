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

from skd_sim.controllers import (
    Controller,
    SensingController,
    make_controller,
    require_control_period,
    require_sensor,
    sight_of,
)
from skd_sim.errors import NoNumberError, UsageError
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.options.options import option
from skd_sim.ros.from_messages import (
    CarEpisode,
    from_stamp,
    message_to_car_episode,
    message_to_scan,
    odometry_to_adversary,
    odometry_to_car,
)
from skd_sim.ros.support import (
    ACCELERATION_COMMAND,
    ADVERSARY_ODOMETRY,
    EGO_ODOMETRY,
    EGO_SCAN,
    STREAM,
    EpisodeFollower,
    GraphNode,
    declare,
    run_node,
)
from skd_sim.ros.to_messages import acceleration_command


@dataclass(frozen=True)
class _ControllerOptions:
    """The table of the node's parameters."""

    controller: str = option("", "basic, cal, carla, or package.module:Class", unset="the one that the episode names")
    multiplier: float = option(
        -1.0, "C of the basic controller; negative: the one that the episode names", low=-1.0, high=100.0
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
        self._car: dict[int, Any] = {}
        self._adversary: dict[int, Any] = {}
        self._scan: dict[int, Any] = {}
        self._scans: Any = None  # subscription, while the controller wants scans
        self._answered: dict[int, AccelStamped] = {}
        self._command = self.create_publisher(AccelStamped, ACCELERATION_COMMAND, STREAM)
        self._follower = EpisodeFollower(self, message_to_car_episode, self._on_begin, self._on_frame)
        self.create_subscription(Odometry, EGO_ODOMETRY, partial(self._on_odometry, self._car, odometry_to_car), STREAM)
        of_adversary = partial(self._on_odometry, self._adversary, odometry_to_adversary)
        self.create_subscription(Odometry, ADVERSARY_ODOMETRY, of_adversary, STREAM)

    def _on_begin(self, episode: CarEpisode) -> None:
        name = self._settings["controller"] or episode.controller
        chosen = self._settings["multiplier"]
        car = CarUnderTest(name, chosen if chosen >= 0.0 else episode.multiplier)
        if car.is_external:
            raise UsageError("controller is external: this node is not the car under test")
        self._controller = make_controller(car.controller, car.multiplier)
        require_sensor(self._controller, name, episode.scenario)
        require_control_period(self._controller, name, episode.scenario)
        self._sight = sight_of(self._controller, episode.scenario)
        self._listen_to_scans(wanted=isinstance(self._controller, SensingController))
        self._controller.reset(episode.scenario, episode.rng)
        self._answered.clear()

    def _listen_to_scans(self, *, wanted: bool) -> None:
        """Subscribe only for a controller that senses: a scan is not made unless a node listens."""
        if wanted and self._scans is None:
            self._scans = self.create_subscription(LaserScan, EGO_SCAN, self._on_scan, STREAM)
        elif not wanted and self._scans is not None:
            self.destroy_subscription(self._scans)
            self._scans = None
            self._scan.clear()

    def _on_odometry(self, kept: dict[int, Any], read: Callable[[Any], Any], message: Any) -> None:
        self._on_state(kept, from_stamp(message.header.stamp), read(message))

    def _on_scan(self, message: Any) -> None:
        self._on_state(self._scan, from_stamp(message.header.stamp), message)

    def _on_state(self, kept: dict[int, Any], stamp: int, state: Any) -> None:
        kept[stamp] = state
        if stamp in self._car and stamp in self._adversary and (self._scans is None or stamp in self._scan):
            states = self._car.pop(stamp), self._adversary.pop(stamp), self._scan.pop(stamp, None)
            self._follower.deliver(stamp, states)
            for side in (self._car, self._adversary, self._scan):
                for old in [other for other in side if other < stamp]:
                    del side[old]

    def _on_frame(self, tick: int, period: int, stamp: int, states: tuple[Any, Any, Any]) -> None:
        # A tick may be repeated while other nodes start; the controller must see it once.
        if stamp not in self._answered:
            assert self._controller is not None
            if isinstance(self._controller, SensingController):
                if states[2] is None:
                    return  # tick 0 of the first episode, before the subscription was there: it will be repeated
                self._controller.sense(message_to_scan(states[2]))
            try:
                command = self._controller.command(states[0], self._sight(*states[:2], tick, period))
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
