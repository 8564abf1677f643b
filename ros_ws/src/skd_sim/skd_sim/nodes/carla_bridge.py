"""Node `carla_bridge`: CARLA, through carla_ros_bridge, in the place of `vehicle_simulator`.

CARLA runs in synchronous mode and paused; `CarlaFrames` steps it frame by frame. carla_ros_bridge is the source of
/clock.
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import rclpy
from geometry_msgs.msg import Pose, Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor

from skd_sim.dynamics.limits import CommandLimits
from skd_sim.episode.aborts import AbortKind
from skd_sim.errors import UsageError
from skd_sim.geometry.placement import Placement
from skd_sim.messages.from_messages import from_stamp
from skd_sim.nodes.simulator_node import SIMULATOR_SETTINGS, SimulatorNode
from skd_sim.nodes.support import STREAM, Setting, run_node
from skd_sim.simulation.carla_conversion import adversary_from_odometry, car_from_odometry, pedals, walker_control
from skd_sim.simulation.framed_simulator import FramedSimulator, States
from skd_sim.simulation.simulator import SimulatorError
from skd_sim.state import AdversaryState, CarState

_SETTINGS = (
    *SIMULATOR_SETTINGS,
    Setting("ego_role", "ego_vehicle", "role name of the car under test in CARLA"),
    Setting("walker_role", "walker", "role name of the adversary in CARLA"),
    Setting("odometry_id", "odometry", "id of the pseudo sensor sensor.pseudo.odom of both"),
    Setting("control_id", "control", "id of the pseudo actor actor.pseudo.control of both, which puts them in place"),
    Setting("crossing_x", 0.0, "origin of the crossing in CARLA's map as ROS sees it, m", -1e5, 1e5),
    Setting("crossing_y", 0.0, "the same, m", -1e5, 1e5),
    Setting("crossing_z", 0.5, "height at which car and walker are put on the road, m", -1e3, 1e4),
    Setting("crossing_yaw", 0.0, "direction in which the adversary crosses, the crossing's x axis, rad", -7.0, 7.0),
    Setting("frame_step", 0.05, "fixed_delta_seconds of CARLA; it has to divide the scenario's time step", 0.001, 0.1),
    Setting("full_throttle", 4.0, "acceleration of the car at full throttle, m/s²", 0.1, 20.0),
    Setting("full_brake", 8.0, "deceleration of the car at full brake, m/s²", 0.1, 20.0),
    Setting("placing_tolerance", 0.5, "distance from its start at which an actor counts as placed, m", 0.01, 5.0),
    Setting("settling_time", 0.02, "wall seconds from controls to the first frame that is to feel them", 0.001, 5.0),
)
_STEP_ONCE = 2  # carla_msgs/CarlaControl.STEP_ONCE
_LONGEST_WAIT = 0.05  # s; a signal is then seen


def carla_messages() -> Any:
    """Return the message module of CARLA.

    Raises:
        UsageError: it is not installed.
    """
    try:
        return importlib.import_module("carla_msgs.msg")
    except ImportError as error:
        raise UsageError(
            "carla_bridge needs the package carla_msgs (github.com/carla-simulator/ros-carla-msgs); "
            "build it in a workspace and source that"
        ) from error


class CarlaFrames:
    """CARLA as a source of frames; it waits for them with a node and an executor of its own.

    Attributes:
        frame_step: time between frames, s.
        limits: what full pedals do.
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        """Take the parameters of `carla_bridge`, and find CARLA's topics."""
        s = self._settings = settings
        self._messages = carla_messages()
        self.frame_step = float(s["frame_step"])
        self.limits = CommandLimits(-s["full_brake"], s["full_throttle"])
        self._placement = Placement(s["crossing_x"], s["crossing_y"], s["crossing_yaw"])
        ego, walker = f"/carla/{s['ego_role']}", f"/carla/{s['walker_role']}"
        node = self._node = rclpy.create_node("carla_link")
        self._car_control = node.create_publisher(
            self._messages.CarlaEgoVehicleControl, f"{ego}/vehicle_control_cmd", STREAM
        )
        self._walker_control = node.create_publisher(
            self._messages.CarlaWalkerControl, f"{walker}/walker_control_cmd", STREAM
        )
        self._simulation = node.create_publisher(self._messages.CarlaControl, "/carla/control", STREAM)
        self._car_pose = node.create_publisher(Pose, f"{ego}/{s['control_id']}/set_transform", STREAM)
        self._car_twist = node.create_publisher(Twist, f"{ego}/{s['control_id']}/set_target_velocity", STREAM)
        self._walker_pose = node.create_publisher(Pose, f"{walker}/{s['control_id']}/set_transform", STREAM)
        self._odometry: dict[str, dict[int, Any]] = {"car": {}, "walker": {}}
        topic = s["odometry_id"]
        node.create_subscription(Odometry, f"{ego}/{topic}", lambda m: self._on_odometry("car", m), STREAM)
        node.create_subscription(Odometry, f"{walker}/{topic}", lambda m: self._on_odometry("walker", m), STREAM)
        self._last_frame = -1
        self._newest: States | None = None
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()

    # --- what FrameSource asks for

    def place(self, car: CarState, adversary: AdversaryState) -> States:
        """Put car and adversary at the start, the car rolling at its start speed, until a frame shows them there."""
        limit = self._settings["startup_timeout"]
        begun, tolerance = time.monotonic(), self._settings["placing_tolerance"]
        starts: tuple[tuple[float, ...], ...] = car, adversary
        while True:
            self._put(car, adversary)
            self.control(0.0, (0.0, 0.0))
            now = self._next_frame(begun, limit, AbortKind.NOT_STARTED, "CARLA to put both actors in place")
            if all(math.dist(there[:2], start[:2]) <= tolerance for there, start in zip(now, starts, strict=True)):
                return now

    def control(self, acceleration: float, velocity: tuple[float, float]) -> None:
        """Send both commands, and wait until they have arrived: topics have no common order, and nobody answers."""
        throttle, brake = pedals(acceleration, self._settings["full_throttle"], self._settings["full_brake"])
        self._car_control.publish(self._messages.CarlaEgoVehicleControl(throttle=throttle, brake=brake))
        walker = walker_control(velocity, self._placement)
        message = self._messages.CarlaWalkerControl(speed=walker.speed)
        message.direction.x, message.direction.y = walker.x, walker.y
        self._walker_control.publish(message)
        time.sleep(self._settings["settling_time"])

    def advance(self) -> States:
        """Step once, and wait for both states."""
        return self._next_frame(time.monotonic(), self._settings["command_timeout"], AbortKind.NO_ANSWER, "a frame")

    # --- CARLA

    def _put(self, car: CarState, adversary: AdversaryState) -> None:
        on_map = self._placement.car_to_map(car)
        self._car_pose.publish(self._pose(on_map.x, on_map.y, on_map.heading))
        twist = Twist()
        twist.linear.x = on_map.speed
        self._car_twist.publish(twist)
        place = self._placement.point_to_map(adversary.x, adversary.y)
        self._walker_pose.publish(self._pose(*place, self._placement.yaw))

    def _pose(self, x: float, y: float, yaw: float) -> Pose:
        pose = Pose()
        pose.position.x, pose.position.y, pose.position.z = x, y, self._settings["crossing_z"]
        pose.orientation.z, pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
        return pose

    def _next_frame(self, begun: float, limit: float, kind: AbortKind, what: str) -> States:
        """Step once and return the frame that comes.

        Raises:
            SimulatorError: none came until `limit` (s) after `begun` (monotonic time, s).
        """
        self._newest = None
        self._simulation.publish(self._messages.CarlaControl(command=_STEP_ONCE))
        while self._newest is None:
            left = begun + limit - time.monotonic()
            if left <= 0.0:
                raise SimulatorError(kind, f"carla_bridge waited {limit:g} s for {what}")
            self._executor.spin_once(timeout_sec=min(_LONGEST_WAIT, left))
        return self._newest

    def _on_odometry(self, actor: str, message: Any) -> None:
        stamp = from_stamp(message.header.stamp)
        self._odometry[actor][stamp] = message
        if stamp <= self._last_frame or not all(stamp in found for found in self._odometry.values()):
            return
        self._last_frame = stamp
        car = car_from_odometry(self._odometry["car"][stamp], self._placement)
        walker = adversary_from_odometry(self._odometry["walker"][stamp], self._placement)
        self._odometry = {"car": {}, "walker": {}}
        self._newest = car, walker


class CarlaBridge(SimulatorNode):
    """CARLA, and its clock."""

    def __init__(self) -> None:
        """Find CARLA; then wait for an episode."""
        super().__init__("carla_bridge", self._make, _SETTINGS, clock=False)

    def _make(self, settings: Mapping[str, Any]) -> FramedSimulator:
        self._carla = CarlaFrames(settings)
        return FramedSimulator(self._carla)

    def destroy_node(self) -> None:
        """Leave the graph, and CARLA with it."""
        if hasattr(self, "_carla"):
            self._carla.close()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_node(CarlaBridge, args)


if __name__ == "__main__":
    raise SystemExit(main())
