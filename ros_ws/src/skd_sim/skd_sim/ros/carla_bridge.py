"""Node `carla_bridge`: CARLA, through carla_ros_bridge, in the place of `vehicle_simulator`.

CARLA runs in synchronous mode and paused; `CarlaFrames` steps it frame by frame. carla_ros_bridge is the source of
/clock. It publishes `nav_msgs/Odometry` in its map, right-handed with z up, and the twist in the actor's axes. Angles
are counter-clockwise, rad.

`python -m skd_sim.ros.carla_bridge SCENARIO > objects.json`, with a scenario's name or file, writes the file of
carla_spawn_objects: who is there, and by which blueprint.
"""

from __future__ import annotations

import importlib
import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import rclpy
from geometry_msgs.msg import Pose, Twist
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from skd_sim.errors import UsageError
from skd_sim.options.options import option
from skd_sim.ros.from_messages import from_stamp
from skd_sim.ros.simulator_node import TABLES as SIMULATOR_TABLES
from skd_sim.ros.simulator_node import GraphSimulator
from skd_sim.ros.support import STREAM, declare, run_node
from skd_sim.ros.to_messages import to_orientation
from skd_sim.scenario.road_user import called
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.simulators.simulator import FramedSimulator, SimulatorError, States
from skd_sim.world.dynamics.basic import CommandLimits
from skd_sim.world.episode import AbortKind
from skd_sim.world.state import AdversaryState, CarState, Pair, RoadUserState, Triple, on_grid

# --- states in, controls out, and the actors that a scenario needs


class Placement(NamedTuple):
    """Pose of the crossing's frame in the map: the crossing's x axis points along `yaw`."""

    x: float
    y: float
    yaw: float

    def vector_to_map(self, x: float, y: float) -> Pair:
        """Return a direction or a velocity of the crossing's frame in the map's axes."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return cos * x - sin * y, sin * x + cos * y

    def vector_to_crossing(self, x: float, y: float) -> Pair:
        """Return a direction or a velocity of the map in the crossing's axes."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return cos * x + sin * y, cos * y - sin * x

    def point_to_map(self, x: float, y: float) -> Pair:
        """Return a point (m) of the crossing's frame in the map."""
        dx, dy = self.vector_to_map(x, y)
        return self.x + dx, self.y + dy

    def point_to_crossing(self, x: float, y: float) -> Pair:
        """Return a point (m) of the map in the crossing's frame."""
        return self.vector_to_crossing(x - self.x, y - self.y)


def yaw_of(orientation: Any) -> float:
    """Return the rotation about z (rad) of a quaternion, whatever pitch and roll it has."""
    x, y, z, w = (float(getattr(orientation, name)) for name in "xyzw")
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def car_from_odometry(message: Any, placement: Placement) -> CarState:
    """Return the car's state in the crossing's frame; a car that rolls back has speed 0."""
    position = message.pose.pose.position
    heading = math.remainder(yaw_of(message.pose.pose.orientation) - placement.yaw, math.tau)
    place = placement.point_to_crossing(float(position.x), float(position.y))
    return CarState(*place, heading, max(0.0, float(message.twist.twist.linear.x)))


def adversary_from_odometry(message: Any, placement: Placement) -> AdversaryState:
    """Return the adversary's state in the crossing's frame; its twist comes in its own axes, ours is in the frame's."""
    position, linear = message.pose.pose.position, message.twist.twist.linear
    facing = Placement(0.0, 0.0, yaw_of(message.pose.pose.orientation))
    velocity = placement.vector_to_crossing(*facing.vector_to_map(float(linear.x), float(linear.y)))
    return AdversaryState(*placement.point_to_crossing(float(position.x), float(position.y)), *velocity)


def box_from_odometry(message: Any, placement: Placement, velocity: Pair) -> AdversaryState:
    """Return the state of an adversary that is put where it is to be, in the crossing's frame.

    Args:
        message: its odometry; what is put there has a place and a heading, and no velocity of its own.
        placement: where the crossing lies.
        velocity: velocity with which it is put on, (East, North) in the crossing's frame, m/s.
    """
    position = message.pose.pose.position
    place = placement.point_to_crossing(float(position.x), float(position.y))
    heading = math.remainder(yaw_of(message.pose.pose.orientation) - placement.yaw, math.tau)
    return AdversaryState(*place, *velocity, float(on_grid(heading)))


def pedals(acceleration: float, full_throttle: float, full_brake: float) -> Pair:
    """Return throttle and brake, in [0, 1], for an acceleration command (m/s²), linear up to what a full pedal gives.

    Args:
        acceleration: commanded acceleration of the car, m/s².
        full_throttle: acceleration at full throttle, m/s², > 0.
        full_brake: deceleration at full brake, m/s², > 0.
    """
    return min(1.0, max(0.0, acceleration / full_throttle)), min(1.0, max(0.0, -acceleration / full_brake))


def steer(angle: float, full_lock: float) -> float:
    """Return CARLA's steering, in [−1, 1] to the right, for an angle of the front wheels (rad, to the left).

    Args:
        angle: commanded steering angle, rad.
        full_lock: angle at full lock, rad, > 0.
    """
    return min(1.0, max(-1.0, -angle / full_lock))


def walker_control(velocity: Pair, placement: Placement) -> Triple:
    """Return where an adversary on foot goes for a velocity in the crossing's frame: direction (x, y), speed, m/s."""
    direction = math.atan2(velocity[1], velocity[0])
    return (*placement.vector_to_map(math.cos(direction), math.sin(direction)), math.hypot(*velocity))


CARLA = "carla"
"""What the kinds of road user know this simulator by."""
EGO, ADVERSARY, OTHER, OBSTACLE = "ego_vehicle", "adversary", "other_{}", "obstacle_{}"
"""Role names of actors; of the others and of the obstacles of a scenario with their place in it."""
ODOMETRY, CONTROL = "odometry", "control"
"""Ids of an actor's pseudo sensor and of its pseudo actor."""
_CAR = "vehicle.tesla.model3"


def walks(blueprint: str) -> bool:
    """Return whether an actor takes a walker's control; any other is put where it is to be, frame by frame."""
    return blueprint.startswith("walker.")


def blueprints(scenario: Scenario) -> dict[str, str]:
    """Return the blueprint of each actor of a scenario by its role name; cars under test have their own."""
    found = {EGO: _CAR, ADVERSARY: called(scenario.adversary, CARLA)}
    found |= {OTHER.format(index): called(other, CARLA) for index, other in enumerate(scenario.others)}
    return found | {OBSTACLE.format(index): _CAR for index in range(len(scenario.obstacles))}


def objects(scenario: Scenario) -> dict[str, Any]:
    """Return the content of a file for carla_spawn_objects; where actors appear is left to it."""
    control = {"type": "actor.pseudo.control", "id": CONTROL}
    odometry = {"type": "sensor.pseudo.odom", "id": ODOMETRY}
    found = [
        {"type": blueprint, "id": role, "sensors": [odometry, control] if role in (EGO, ADVERSARY) else [control]}
        for role, blueprint in blueprints(scenario).items()
    ]
    return {"objects": found}


# --- the node


@dataclass(frozen=True)
class _CarlaOptions:
    """The table of the node's parameters, beside those of every simulator."""

    ego_role: str = option(EGO, "role name of the car under test in CARLA")
    adversary_role: str = option(ADVERSARY, "role name of the adversary in CARLA")
    odometry_id: str = option(ODOMETRY, "id of the pseudo sensor sensor.pseudo.odom of both")
    control_id: str = option(CONTROL, "id of the pseudo actor actor.pseudo.control of all, which puts them in place")
    obstacles_on_map: bool = option(False, "whether the map has the scenario's obstacles; if not, actors are put there")
    crossing_x: float = option(0.0, "origin of the crossing in CARLA's map as ROS sees it, m", within=(-1e5, 1e5))
    crossing_y: float = option(0.0, "the same, m", within=(-1e5, 1e5))
    crossing_z: float = option(0.5, "height at which actors are put on the road, m", within=(-1e3, 1e4))
    crossing_yaw: float = option(
        0.0, "direction in which the adversary crosses, the crossing's x axis, rad", within=(-7.0, 7.0)
    )
    frame_step: float = option(
        0.05, "fixed_delta_seconds of CARLA; it has to divide the scenario's time step", within=(0.001, 0.1)
    )
    full_throttle: float = option(4.0, "acceleration of the car at full throttle, m/s²", within=(0.1, 20.0))
    full_brake: float = option(8.0, "deceleration of the car at full brake, m/s²", within=(0.1, 20.0))
    full_steering: float = option(1.22, "angle of its front wheels at full lock, rad", within=(0.1, 1.5))
    placing_tolerance: float = option(
        0.5, "distance from its start at which an actor counts as placed, m", within=(0.01, 5.0)
    )
    settling_time: float = option(
        0.02, "wall seconds from controls to the first frame that is to feel them", within=(0.001, 5.0)
    )


TABLES = (*SIMULATOR_TABLES, _CarlaOptions)
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

    An adversary whose blueprint is a walker's goes by CARLA's walker control. Any other, and everybody else of the
    scenario, is put where it is to be before each frame: CARLA has no command that makes a vehicle keep a velocity.

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
        ego, adversary = f"/carla/{s['ego_role']}", f"/carla/{s['adversary_role']}"
        node = self._node = rclpy.create_node("carla_link")
        self._car_control = node.create_publisher(
            self._messages.CarlaEgoVehicleControl, f"{ego}/vehicle_control_cmd", STREAM
        )
        self._walker_control = node.create_publisher(
            self._messages.CarlaWalkerControl, f"{adversary}/walker_control_cmd", STREAM
        )
        self._simulation = node.create_publisher(self._messages.CarlaControl, "/carla/control", STREAM)
        self._poses: dict[str, Any] = {}
        self._car_twist = node.create_publisher(Twist, f"{ego}/{s['control_id']}/set_target_velocity", STREAM)
        self._odometry: dict[str, dict[int, Any]] = {"car": {}, "adversary": {}}
        topic = s["odometry_id"]
        node.create_subscription(Odometry, f"{ego}/{topic}", lambda m: self._on_odometry("car", m), STREAM)
        node.create_subscription(Odometry, f"{adversary}/{topic}", lambda m: self._on_odometry("adversary", m), STREAM)
        self._last_frame = -1
        self._newest: States | None = None
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()

    # --- what a FrameSource has

    def prepare(self, scenario: Scenario) -> None:
        """Take the scenario, and where its obstacles are."""
        self._scenario = scenario
        self._walks = walks(blueprints(scenario)[ADVERSARY])
        self._staged: dict[str, Triple] = {}
        if not self._settings["obstacles_on_map"]:
            for index, one in enumerate(scenario.obstacles):
                self._staged[OBSTACLE.format(index)] = one.x, one.y, one.heading

    def show(self, others: Sequence[RoadUserState]) -> None:
        """Put the others where they are at the next frame's end."""
        for index, state in enumerate(others):
            self._staged[OTHER.format(index)] = state.x, state.y, state.heading
        self._put_staged()

    def place(self, car: CarState, adversary: AdversaryState) -> States:
        """Put car and adversary at the start, the car rolling at its start speed, until a frame shows them there."""
        limit = self._settings["startup_timeout"]
        begun, tolerance = time.monotonic(), self._settings["placing_tolerance"]
        self._await_actors(begun, limit)
        starts: tuple[tuple[float, ...], ...] = car, adversary
        self._at, self._height = adversary, self._settings["crossing_z"]
        while True:
            self._put_staged()
            self._put(self._settings["ego_role"], car.x, car.y, car.heading, self._settings["crossing_z"])
            twist = Twist()
            twist.linear.x = car.speed
            self._car_twist.publish(twist)
            self._put(self._settings["adversary_role"], adversary.x, adversary.y, adversary.heading, self._height)
            self.control(0.0, 0.0, (0.0, 0.0))
            now = self._next_frame(begun, limit, AbortKind.NOT_STARTED, "CARLA to put both actors in place")
            if all(math.dist(there[:2], start[:2]) <= tolerance for there, start in zip(now, starts, strict=True)):
                if not self._walks:  # it comes as fast as the scenario says, and CARLA reports no speed of it
                    now = now[0], now[1]._replace(vx=adversary.vx, vy=adversary.vy)
                self._at = now[1]
                return now

    def control(self, acceleration: float, steering: float, velocity: Pair) -> None:
        """Send both commands, and wait until they have arrived: topics have no common order, and no answer comes."""
        throttle, brake = pedals(acceleration, self._settings["full_throttle"], self._settings["full_brake"])
        side = steer(steering, self._settings["full_steering"])
        self._car_control.publish(self._messages.CarlaEgoVehicleControl(throttle=throttle, brake=brake, steer=side))
        self._velocity = velocity
        if self._walks:
            x, y, speed = walker_control(velocity, self._placement)
            message = self._messages.CarlaWalkerControl(speed=speed)
            message.direction.x, message.direction.y = x, y
            self._walker_control.publish(message)
        time.sleep(self._settings["settling_time"])

    def advance(self) -> States:
        """Step once, and wait for both states."""
        if not self._walks:
            self._push()
        if self._scenario.others or not self._walks:  # poses have to arrive before the step
            time.sleep(self._settings["settling_time"])
        return self._next_frame(time.monotonic(), self._settings["command_timeout"], AbortKind.NO_ANSWER, "a frame")

    # --- CARLA

    def _await_actors(self, begun: float, limit: float) -> None:
        """Wait until all road users of the scenario can be put somewhere.

        Raises:
            SimulatorError: one of them could not until `limit` (s) after `begun` (monotonic time, s).
        """
        for role in self._staged:
            while self._publisher(role).get_subscription_count() == 0:
                if time.monotonic() > begun + limit:
                    control = self._settings["control_id"]
                    raise SimulatorError(
                        AbortKind.NOT_STARTED,
                        f"carla_bridge waited {limit:g} s for an actor {role} with an actor.pseudo.control {control}",
                    )
                self._executor.spin_once(timeout_sec=_LONGEST_WAIT)

    def _put_staged(self) -> None:
        for role, pose in self._staged.items():
            self._put(role, *pose, self._settings["crossing_z"])

    def _push(self) -> None:
        """Put an adversary that does not walk where its velocity takes it in a frame, pointing that way."""
        vx, vy = self._velocity
        heading = float(on_grid(self._scenario.adversary.heading(self._at.heading, vx, vy)))
        place = self._at.x + self.frame_step * vx, self._at.y + self.frame_step * vy
        self._at = AdversaryState(*place, vx, vy, heading)
        self._put(self._settings["adversary_role"], *place, heading, self._height)

    def _publisher(self, role: str) -> Any:
        """Return the publisher of an actor's pose, by its role name."""
        if role not in self._poses:
            topic = f"/carla/{role}/{self._settings['control_id']}/set_transform"
            self._poses[role] = self._node.create_publisher(Pose, topic, STREAM)
        return self._poses[role]

    def _put(self, role: str, x: float, y: float, heading: float, height: float) -> None:
        """Ask for an actor to be at a place of the crossing's frame (m), at a height on the map (m)."""
        pose = Pose()
        pose.position.x, pose.position.y = self._placement.point_to_map(x, y)
        pose.position.z = height
        pose.orientation = to_orientation(heading + self._placement.yaw)
        self._publisher(role).publish(pose)

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
        message = self._odometry["adversary"][stamp]
        if self._walks:
            adversary = adversary_from_odometry(message, self._placement)
        else:
            adversary = box_from_odometry(message, self._placement, self._velocity)
            self._height = message.pose.pose.position.z  # where the road bears it: else each frame lets it fall
        self._odometry = {"car": {}, "adversary": {}}
        self._newest = car, adversary


class CarlaBridge(Node):
    """CARLA, and its clock."""

    def __init__(self) -> None:
        """Find CARLA; then wait for an episode."""
        super().__init__("carla_bridge")
        settings = declare(self, *TABLES)
        self._carla = CarlaFrames(settings)
        self.simulator = GraphSimulator(self, FramedSimulator(self._carla), settings, clock=False)

    def destroy_node(self) -> None:
        """Leave the graph, and CARLA with it."""
        self._carla.close()
        super().destroy_node()


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run_node(CarlaBridge, args)


def write_objects() -> int:
    """Write the file of the scenario that the command line names to standard output."""
    try:
        if len(sys.argv) != 2:
            raise UsageError("give one scenario: python -m skd_sim.ros.carla_bridge SCENARIO > objects.json")
        print(json.dumps(objects(load_scenario(sys.argv[1])), indent=2))
    except UsageError as error:
        print(f"carla_objects: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(write_objects())
