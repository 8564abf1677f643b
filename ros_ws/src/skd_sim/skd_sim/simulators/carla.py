"""CARLA behind its ROS bridge: states in, controls out, and the actors that a scenario needs. Needs neither.

carla_ros_bridge publishes `nav_msgs/Odometry` in its map, right-handed with z up, and the twist in the actor's axes.
Messages are read by their fields only. Angles are counter-clockwise, rad.

`python -m skd_sim.simulators.carla SCENARIO > objects.json`, with a scenario's name or file, writes the file of
carla_spawn_objects: who is there, and by which blueprint.
"""

from __future__ import annotations

import json
import math
import sys
from typing import Any, NamedTuple

from skd_sim.errors import UsageError
from skd_sim.scenario.road_user import called
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.state import AdversaryState, CarState, on_grid


class Placement(NamedTuple):
    """Pose of the crossing's frame in the map: the crossing's x axis points along `yaw`."""

    x: float
    y: float
    yaw: float

    def vector_to_map(self, x: float, y: float) -> tuple[float, float]:
        """Return a direction or a velocity of the crossing's frame in the map's axes."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return cos * x - sin * y, sin * x + cos * y

    def vector_to_crossing(self, x: float, y: float) -> tuple[float, float]:
        """Return a direction or a velocity of the map in the crossing's axes."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return cos * x + sin * y, cos * y - sin * x

    def point_to_map(self, x: float, y: float) -> tuple[float, float]:
        """Return a point (m) of the crossing's frame in the map."""
        dx, dy = self.vector_to_map(x, y)
        return self.x + dx, self.y + dy

    def point_to_crossing(self, x: float, y: float) -> tuple[float, float]:
        """Return a point (m) of the map in the crossing's frame."""
        return self.vector_to_crossing(x - self.x, y - self.y)

    def car_to_crossing(self, car: CarState) -> CarState:
        """Return a car's state in the crossing's frame."""
        return CarState(*self.point_to_crossing(car.x, car.y), _wrapped(car.heading - self.yaw), car.speed)

    def adversary_to_crossing(self, adversary: AdversaryState) -> AdversaryState:
        """Return an adversary's state in the crossing's frame."""
        return AdversaryState(
            *self.point_to_crossing(adversary.x, adversary.y), *self.vector_to_crossing(adversary.vx, adversary.vy)
        )


def _wrapped(angle: float) -> float:
    """Return the same angle in [−π, π]."""
    return math.remainder(angle, math.tau)


def yaw_of(orientation: Any) -> float:
    """Return the rotation about z (rad) of a quaternion, whatever pitch and roll it has."""
    x, y, z, w = (float(getattr(orientation, name)) for name in "xyzw")
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def car_from_odometry(message: Any, placement: Placement) -> CarState:
    """Return the car's state in the crossing's frame; a car that rolls back has speed 0."""
    position = message.pose.pose.position
    speed = max(0.0, float(message.twist.twist.linear.x))
    car = CarState(float(position.x), float(position.y), yaw_of(message.pose.pose.orientation), speed)
    return placement.car_to_crossing(car)


def adversary_from_odometry(message: Any, placement: Placement) -> AdversaryState:
    """Return the adversary's state in the crossing's frame; its twist comes in its own axes, ours is in the frame's."""
    position, linear = message.pose.pose.position, message.twist.twist.linear
    facing = Placement(0.0, 0.0, yaw_of(message.pose.pose.orientation))
    vx, vy = facing.vector_to_map(float(linear.x), float(linear.y))
    return placement.adversary_to_crossing(AdversaryState(float(position.x), float(position.y), vx, vy))


def box_from_odometry(message: Any, placement: Placement, velocity: tuple[float, float]) -> AdversaryState:
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


def pedals(acceleration: float, full_throttle: float, full_brake: float) -> tuple[float, float]:
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


def walker_control(velocity: tuple[float, float], placement: Placement) -> tuple[float, float, float]:
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


def main() -> int:
    """Write the file of the scenario that the command line names to standard output."""
    try:
        if len(sys.argv) != 2:
            raise UsageError("give one scenario: python -m skd_sim.simulators.carla SCENARIO > objects.json")
        print(json.dumps(objects(load_scenario(sys.argv[1])), indent=2))
    except UsageError as error:
        print(f"carla_objects: error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
