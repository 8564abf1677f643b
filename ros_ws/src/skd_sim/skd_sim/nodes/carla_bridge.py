"""Node `carla_bridge`: CARLA, through carla_ros_bridge, in the place of `vehicle_simulator`.

CARLA runs in synchronous mode and paused; this node steps it frame by frame. For each tick it publishes both states,
waits for both commands of that tick, applies them, and steps on. carla_ros_bridge is the source of /clock.
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Sequence
from enum import Enum
from typing import Any

from geometry_msgs.msg import AccelStamped, Pose, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from skd_msgs.msg import Episode as EpisodeMsg
from skd_msgs.msg import EpisodeResult

from skd_sim.carla_conversion import car_from_odometry, pedals, pedestrian_from_odometry, walker_control
from skd_sim.episode import Outcome
from skd_sim.errors import UsageError
from skd_sim.framed_episode import FramedEpisode
from skd_sim.from_messages import from_stamp, message_to_episode
from skd_sim.nodes.support import (
    ACCELERATION_COMMAND,
    EGO_ODOMETRY,
    EPISODE,
    EPISODE_RESULT,
    LATCHED,
    PEDESTRIAN_ODOMETRY,
    STREAM,
    VELOCITY_COMMAND,
    Setting,
    declare,
    run_node,
)
from skd_sim.nodes.to_messages import MAP_FRAME, car_to_odometry, pedestrian_to_odometry, to_stamp
from skd_sim.placement import Placement
from skd_sim.stamps import tick_stamp

_SETTINGS = (
    Setting("ego_role", "ego_vehicle", "role name of the car under test in CARLA"),
    Setting("walker_role", "walker", "role name of the pedestrian in CARLA"),
    Setting("odometry_id", "odometry", "id of the pseudo sensor sensor.pseudo.odom of both"),
    Setting("control_id", "control", "id of the pseudo actor actor.pseudo.control of both, which puts them in place"),
    Setting("crossing_x", 0.0, "origin of the crossing in CARLA's map as ROS sees it, m", -1e5, 1e5),
    Setting("crossing_y", 0.0, "the same, m", -1e5, 1e5),
    Setting("crossing_z", 0.5, "height at which car and walker are put on the road, m", -1e3, 1e4),
    Setting("crossing_yaw", 0.0, "direction in which the pedestrian crosses, the crossing's x axis, rad", -7.0, 7.0),
    Setting("frame_step", 0.05, "fixed_delta_seconds of CARLA; it has to divide the scenario's time step", 0.001, 0.1),
    Setting("full_throttle", 4.0, "acceleration of the car at full throttle, m/s²", 0.1, 20.0),
    Setting("full_brake", 8.0, "deceleration of the car at full brake, m/s²", 0.1, 20.0),
    Setting("placing_tolerance", 0.5, "distance from its start at which an actor counts as placed, m", 0.01, 5.0),
    Setting("settling_time", 0.02, "wall seconds from controls to the first frame that is to feel them", 0.001, 5.0),
    Setting("command_timeout", 5.0, "wall seconds without a command or a frame after which the episode is aborted",
            0.05, 3600.0),
    Setting("startup_timeout", 60.0, "the same until an episode's first tick is over", 0.05, 3600.0),
)  # fmt: skip
_STEP_ONCE = 2  # carla_msgs/CarlaControl.STEP_ONCE
_WATCH_PERIOD = 0.05  # s of wall time
_REPEAT_PERIOD = 0.2  # s of wall time between repetitions of tick 0, which a node that joins late has missed


class _Phase(Enum):
    """What an episode waits for."""

    IDLE = "an episode"
    PLACING = "CARLA to put both actors in place"
    DECIDING = "commands"
    DRIVING = "frames"


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


class CarlaBridge(Node):
    """One episode at a time, in CARLA."""

    def __init__(self) -> None:
        """Declare parameters and topics; then wait for an episode."""
        super().__init__("carla_bridge")
        s = self._settings = declare(self, _SETTINGS)
        self._messages = carla_messages()
        self._placement = Placement(s["crossing_x"], s["crossing_y"], s["crossing_yaw"])
        ego, walker = f"/carla/{s['ego_role']}", f"/carla/{s['walker_role']}"
        self._car_control = self.create_publisher(
            self._messages.CarlaEgoVehicleControl, f"{ego}/vehicle_control_cmd", STREAM
        )
        self._walker_control = self.create_publisher(
            self._messages.CarlaWalkerControl, f"{walker}/walker_control_cmd", STREAM
        )
        self._simulation = self.create_publisher(self._messages.CarlaControl, "/carla/control", STREAM)
        self._car_pose = self.create_publisher(Pose, f"{ego}/{s['control_id']}/set_transform", STREAM)
        self._car_twist = self.create_publisher(Twist, f"{ego}/{s['control_id']}/set_target_velocity", STREAM)
        self._walker_pose = self.create_publisher(Pose, f"{walker}/{s['control_id']}/set_transform", STREAM)
        self._car_state = self.create_publisher(Odometry, EGO_ODOMETRY, STREAM)
        self._walker_state = self.create_publisher(Odometry, PEDESTRIAN_ODOMETRY, STREAM)
        self._result = self.create_publisher(EpisodeResult, EPISODE_RESULT, STREAM)
        self._frames: dict[str, dict[int, Any]] = {"car": {}, "walker": {}}
        odometry = s["odometry_id"]
        self.create_subscription(Odometry, f"{ego}/{odometry}", lambda m: self._on_odometry("car", m), STREAM)
        self.create_subscription(Odometry, f"{walker}/{odometry}", lambda m: self._on_odometry("walker", m), STREAM)
        self.create_subscription(AccelStamped, ACCELERATION_COMMAND, self._on_acceleration, STREAM)
        self.create_subscription(TwistStamped, VELOCITY_COMMAND, self._on_velocity, STREAM)
        self.create_subscription(EpisodeMsg, EPISODE, self._on_episode, LATCHED)
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._pending: Any = None
        self.create_timer(_WATCH_PERIOD, self._on_watch, clock=self._steady)
        self._phase = _Phase.IDLE
        self._message: Any = None
        self._last_frame = -1
        self._run: FramedEpisode | None = None

    # --- episodes

    def _on_episode(self, message: Any) -> None:
        if self._message is not None and _identity(self._message) == _identity(message):
            return
        self._message, self._start = message, from_stamp(message.header.stamp)
        self._progress = self._published = time.monotonic()
        self._forget_commands()
        try:
            self._run = FramedEpisode(message_to_episode(message), self._settings["frame_step"])
        except ValueError as error:
            self._run = None
            self._phase = _Phase.IDLE
            self._publish_result(Outcome.ABORTED, f"carla_bridge: {error}")
            return
        self._phase = _Phase.PLACING
        self._place()
        self._step_soon()

    def _forget_commands(self) -> None:
        self._acceleration: float | None = None
        self._velocity: tuple[float, float] | None = None

    def _place(self) -> None:
        """Put both actors at the start; the car rolls at its start speed."""
        assert self._run is not None
        car = self._placement.car_to_map(self._run.start_car)
        walker = self._run.start_pedestrian
        self._car_pose.publish(self._pose(car.x, car.y, car.heading))
        twist = Twist()
        twist.linear.x = car.speed
        self._car_twist.publish(twist)
        self._walker_pose.publish(self._pose(*self._placement.point_to_map(walker.x, walker.y), self._placement.yaw))
        self._send_controls(0.0, (0.0, 0.0))

    def _pose(self, x: float, y: float, yaw: float) -> Pose:
        pose = Pose()
        pose.position.x, pose.position.y, pose.position.z = x, y, self._settings["crossing_z"]
        pose.orientation.z, pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
        return pose

    # --- CARLA

    def _step_soon(self) -> None:
        """Step once what was just published has arrived: topics have no common order, and none of these is answered."""
        self._cancel_step()
        self._pending = self.create_timer(self._settings["settling_time"], self._on_settled, clock=self._steady)

    def _cancel_step(self) -> None:
        if self._pending is not None:
            self.destroy_timer(self._pending)
            self._pending = None

    def _on_settled(self) -> None:
        self._cancel_step()
        self._step()

    def _step(self) -> None:
        self._simulation.publish(self._messages.CarlaControl(command=_STEP_ONCE))

    def _send_controls(self, acceleration: float, velocity: tuple[float, float]) -> None:
        throttle, brake = pedals(acceleration, self._settings["full_throttle"], self._settings["full_brake"])
        self._car_control.publish(self._messages.CarlaEgoVehicleControl(throttle=throttle, brake=brake))
        walker = walker_control(velocity, self._placement)
        message = self._messages.CarlaWalkerControl(speed=walker.speed)
        message.direction.x, message.direction.y = walker.x, walker.y
        self._walker_control.publish(message)

    def _on_odometry(self, actor: str, message: Any) -> None:
        stamp = from_stamp(message.header.stamp)
        self._frames[actor][stamp] = message
        if stamp <= self._last_frame or not all(stamp in frames for frames in self._frames.values()):
            return
        self._last_frame = stamp
        car = car_from_odometry(self._frames["car"][stamp], self._placement)
        walker = pedestrian_from_odometry(self._frames["walker"][stamp], self._placement)
        self._frames = {"car": {}, "walker": {}}
        self._on_frame(car, walker)

    def _on_frame(self, car: Any, walker: Any) -> None:
        run = self._run
        if run is None:
            return
        if self._phase == _Phase.PLACING:
            tolerance = self._settings["placing_tolerance"]
            starts = ((car, run.start_car), (walker, run.start_pedestrian))
            if all(math.hypot(now.x - then.x, now.y - then.y) <= tolerance for now, then in starts):
                run.begin(car, walker)
                self._decide()
            else:
                self._place()
                self._step_soon()
        elif self._phase == _Phase.DRIVING:
            assert self._velocity is not None
            self._progress = time.monotonic()
            if run.frame(car, walker, self._velocity):
                self._end_tick()
            else:
                self._step()

    # --- ticks

    def _stamp(self) -> int:
        assert self._run is not None
        return tick_stamp(self._start, self._run.tick, self._run.episode.scenario.time_step)

    def _decide(self) -> None:
        """Publish the state of the tick and wait for its commands."""
        self._phase = _Phase.DECIDING
        self._progress = time.monotonic()
        self._publish_state()

    def _end_tick(self) -> None:
        assert self._run is not None
        self._forget_commands()
        self._decide()
        if self._run.outcome != Outcome.RUNNING:
            self._end(self._run.outcome, "")

    def _publish_state(self) -> None:
        assert self._run is not None
        self._published = time.monotonic()
        self._car_state.publish(car_to_odometry(self._run.car, self._stamp()))
        self._walker_state.publish(pedestrian_to_odometry(self._run.pedestrian, self._stamp()))

    def _current(self, message: Any) -> bool:
        return self._phase == _Phase.DECIDING and from_stamp(message.header.stamp) == self._stamp()

    def _on_acceleration(self, message: Any) -> None:
        if self._current(message):
            self._acceleration = float(message.accel.linear.x)
            self._drive_if_ready()

    def _on_velocity(self, message: Any) -> None:
        if self._current(message):
            self._velocity = float(message.twist.linear.x), float(message.twist.linear.y)
            self._drive_if_ready()

    def _drive_if_ready(self) -> None:
        if self._acceleration is None or self._velocity is None:
            return
        if not all(map(math.isfinite, (self._acceleration, *self._velocity))):
            self._end(Outcome.ABORTED, f"commanded {self._acceleration}, {self._velocity}: not finite")
            return
        self._phase = _Phase.DRIVING
        self._send_controls(self._acceleration, self._velocity)
        self._step_soon()

    def _on_watch(self) -> None:
        if self._run is None:
            return
        now = time.monotonic()
        limit = self._settings["command_timeout" if self._run.tick else "startup_timeout"]
        if now - self._progress > limit:
            waited = f"waited {limit:g} s for {self._phase.value} at tick {self._run.tick}"
            self._end(Outcome.ABORTED, f"carla_bridge {waited}")
        elif self._phase == _Phase.DECIDING and self._run.tick == 0 and now - self._published > _REPEAT_PERIOD:
            self._publish_state()

    # --- results

    def _end(self, outcome: Outcome, reason: str) -> None:
        self._publish_result(outcome, reason)
        self._cancel_step()
        self._run = None
        self._phase = _Phase.IDLE

    def _publish_result(self, outcome: Outcome, reason: str) -> None:
        run = self._run
        result = EpisodeResult()
        result.header.stamp = to_stamp(self._start if run is None else self._stamp())
        result.header.frame_id = MAP_FRAME
        result.campaign = self._message.campaign
        result.episode_id = int(self._message.episode_id)
        result.start = to_stamp(self._start)
        result.outcome = int(outcome)
        result.ticks = 0 if run is None else run.tick
        result.impact_time = result.impact_speed = math.nan
        result.reason = reason
        if run is not None and run.contact is not None:
            result.impact_time = (run.tick - 1 + run.contact.fraction) * run.episode.scenario.time_step
            result.impact_speed = float(run.contact.speed)
        self._result.publish(result)


def _identity(message: Any) -> tuple[str, int, int]:
    return str(message.campaign), int(message.episode_id), from_stamp(message.header.stamp)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_node(CarlaBridge, args)


if __name__ == "__main__":
    raise SystemExit(main())
