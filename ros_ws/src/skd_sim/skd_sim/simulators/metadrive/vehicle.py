"""The car under test as MetaDrive drives it, and the bodies of all other road users. Imports MetaDrive.

The car is MetaDrive's default vehicle, with the scenario's footprint, mass and tyres.

The others are upright cylinders and boxes that are put in their places. Nothing pushes them and they push nothing: they
have no contact response, so that a touch does not change where the car goes before the episode ends with it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from metadrive.component.traffic_participants.base_traffic_participant import BaseTrafficParticipant
from metadrive.component.vehicle.vehicle_type import VaryingDynamicsVehicle, vehicle_class_to_type, vehicle_type
from metadrive.engine.physics_node import BaseRigidBodyNode
from metadrive.type import MetaDriveType
from panda3d.bullet import BulletBoxShape, BulletCylinderShape
from panda3d.core import Vec3

from skd_sim.errors import UsageError
from skd_sim.scenario.road_user import Body, called, height_of
from skd_sim.scenario.scenario import Scenario
from skd_sim.simulators.metadrive.pedals import METADRIVE

MODEL: Final = "skd"
"""Name under which MetaDrive finds `ScenarioVehicle`."""
MASS: Final = 1100.0
"""Mass of MetaDrive's default vehicle, kg."""
HEAVIEST: Final = 2000.0
"""Greatest mass, kg: Bullet's springs press with 6 kN a wheel at most: 2446 kg at rest, and less where it brakes."""
_DRY: Final = 0.9  # wheel friction of MetaDrive's default vehicle: what `road.friction` of 1 means
_ENGINE_FORCE: Final = 800.0  # N a wheel at full throttle, the middle of what MetaDrive draws for its default vehicle
_BRAKE_FORCE: Final = 130.0  # N s a wheel and physics step at full brake, the middle of what it draws
_STEERING: Final = 40.0  # degrees at full lock
FULL_LOCK: Final = math.radians(_STEERING)
"""rad at the front wheels."""
_TOP_SPEED: Final = 80.0  # km/h, above which its engine gives no more force; its observations are scaled by it
_SPARE: Final = 36.0  # km/h above the start speed that a car of a faster scenario can still gain


class ScenarioVehicle(VaryingDynamicsVehicle):
    """MetaDrive's default vehicle whose wheels stand where they stand there in proportion to length and width."""

    @property
    def FRONT_WHEELBASE(self) -> float:  # noqa: N802 - MetaDrive's name
        """Distance from the centre to the front axle, m."""
        return float(VaryingDynamicsVehicle.FRONT_WHEELBASE * self.LENGTH / self.DEFAULT_LENGTH)

    @property
    def REAR_WHEELBASE(self) -> float:  # noqa: N802
        """Distance from the centre to the rear axle, m."""
        return float(VaryingDynamicsVehicle.REAR_WHEELBASE * self.LENGTH / self.DEFAULT_LENGTH)

    @property
    def LATERAL_TIRE_TO_CENTER(self) -> float:  # noqa: N802
        """Distance from the axis to a wheel, m."""
        return float(VaryingDynamicsVehicle.LATERAL_TIRE_TO_CENTER * self.WIDTH / self.DEFAULT_WIDTH)


vehicle_type[MODEL] = ScenarioVehicle
vehicle_class_to_type[ScenarioVehicle] = MODEL


@dataclass(frozen=True)
class VehicleSpec:
    """All of a scenario on which the motion of MetaDrive's car depends.

    Attributes:
        length: length of its body, m.
        width: width of its body, m.
        mass: mass, kg.
        friction: friction of its wheels, in MetaDrive's scale.
        top_speed: speed above which its engine gives no more force, km/h.
    """

    length: float
    width: float
    mass: float
    friction: float
    top_speed: float

    @classmethod
    def of(cls, scenario: Scenario) -> VehicleSpec:
        """Return that of a scenario.

        Raises:
            UsageError: the car is too heavy for MetaDrive's springs.
        """
        car = scenario.car
        mass = MASS if car.mass is None else car.mass
        if mass > HEAVIEST:
            raise UsageError(
                f"scenario {scenario.name}: car.mass {mass:g} kg is more than the springs of MetaDrive's car bear; it "
                f"may be at most {HEAVIEST:g} kg there"
            )
        return cls(
            length=car.front + car.rear,
            width=car.width,
            mass=mass,
            friction=_DRY * scenario.road.friction,
            top_speed=max(_TOP_SPEED, math.ceil(3.6 * car.start_speed + _SPARE)),
        )

    @property
    def config(self) -> dict[str, Any]:
        """The vehicle as MetaDrive has it."""
        return {
            "vehicle_model": MODEL,
            "length": self.length,
            "width": self.width,
            "mass": self.mass,
            "wheel_friction": self.friction,
            "max_engine_force": _ENGINE_FORCE,
            "max_brake_force": _BRAKE_FORCE,
            "max_steering": _STEERING,
            "max_speed_km_h": self.top_speed,
        }


Shape = tuple[float, float, float]

LOW: Final = 0.6
"""How high an obstacle is that hides nothing, m: below MetaDrive's lidar, which looks at 1.2 m."""
HIGH: Final = 1.6
"""How high any other obstacle is, m."""


class Placed(BaseTrafficParticipant):
    """A disc or a box of a scenario.

    Attributes:
        MASS: kg; nothing depends on it, but MetaDrive asks for one.
    """

    MASS = 70.0

    def __init__(
        self,
        shape: Shape,
        height: float,
        type_name: str,
        position: tuple[float, float] = (0.0, 0.0),
        heading_theta: float = 0.0,
        random_seed: int | None = None,
        name: str | None = None,
    ) -> None:
        """Make it.

        Args:
            shape: radius, half length, half width (m), as `skd_sim.scenario.road_user.Body.shape`.
            height: how high it is, m.
            type_name: what MetaDrive calls it.
            position: place of its centre in MetaDrive's frame, m.
            heading_theta: heading in MetaDrive's frame, rad.
            random_seed: of MetaDrive's; nothing is drawn.
            name: of MetaDrive's.
        """
        self._shape, self._tall, self._called = shape, height, type_name
        super().__init__(position, heading_theta, random_seed, name)
        self.set_metadrive_type(type_name)
        self.add_body(BaseRigidBodyNode(self.name, type_name))
        radius, half_length, half_width = shape
        solid = (
            BulletCylinderShape(radius, height)
            if radius
            else BulletBoxShape(Vec3(half_length, half_width, 0.5 * height))
        )
        self.body.addShape(solid)
        self.set_static(True)
        self.body.setCollisionResponse(False)
        self.put(*position, heading_theta)

    def put(self, x: float, y: float, heading: float) -> None:
        """Put it at a place (m), pointing along a heading (rad), both in MetaDrive's frame."""
        self.set_position((x, y), 0.5 * self._tall)
        self.set_heading_theta(heading)

    @property
    def TYPE_NAME(self) -> str:  # noqa: N802 - MetaDrive's name
        """What MetaDrive calls it."""
        return self._called

    @property
    def HEIGHT(self) -> float:  # noqa: N802
        """How high it is, m."""
        return self._tall

    @property
    def LENGTH(self) -> float:  # noqa: N802
        """Length of a box, m; of a disc its radius, as MetaDrive's own pedestrian has it for its lidar's sake."""
        return self._shape[0] or 2.0 * self._shape[1]

    @property
    def WIDTH(self) -> float:  # noqa: N802
        """Width of a box, m; of a disc its radius."""
        return self._shape[0] or 2.0 * self._shape[2]


class Cast:
    """Bodies of all but the car of a scenario, in an engine's world.

    Attributes:
        adversary: the adversary's.
        others: those of the scenario's others, in its order.
        standing: those of its obstacles, in its order.
    """

    def __init__(self, engine: Any, scenario: Scenario) -> None:
        """Make them."""
        self._engine, self._of = engine, _bodies_of(scenario)
        self.adversary = self._put(scenario.adversary.shape, height_of(scenario.adversary.kind), scenario.adversary)
        self.others = [self._put(one.shape, height_of(one.kind), one) for one in scenario.others]
        self.standing = [
            self._put((0.0, 0.5 * one.length, 0.5 * one.width), LOW if one.hides is False else HIGH)
            for one in scenario.obstacles
        ]

    def _put(self, shape: Shape, height: float, who: Body | None = None) -> Placed:
        """Return a body that stands in the engine's world: a road user's, or an obstacle's."""
        type_name = MetaDriveType.TRAFFIC_OBJECT if who is None else called(who, METADRIVE)
        body: Placed = self._engine.spawn_object(
            Placed, force_spawn=True, shape=shape, height=height, type_name=type_name
        )
        return body

    def fits(self, scenario: Scenario) -> bool:
        """Return whether these are the bodies of a scenario, wherever they are."""
        return self._of == _bodies_of(scenario)

    @property
    def everybody(self) -> tuple[Placed, ...]:
        """All bodies."""
        return (self.adversary, *self.others, *self.standing)

    def close(self) -> None:
        """Take them out of the world."""
        self._engine.clear_objects([body.id for body in self.everybody], force_destroy=True)


def _bodies_of(scenario: Scenario) -> tuple[Any, ...]:
    """Return all of a scenario on which bodies depend."""
    people = [(one.kind, one.shape) for one in (scenario.adversary, *scenario.others)]
    return (*people, *((one.length, one.width, one.hides) for one in scenario.obstacles))
