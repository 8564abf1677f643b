"""The car under test as MetaDrive drives it: its default vehicle, with the scenario's footprint, mass and tyres.

Imports MetaDrive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from metadrive.component.vehicle.vehicle_type import VaryingDynamicsVehicle, vehicle_class_to_type, vehicle_type

from skd_sim.errors import UsageError
from skd_sim.scenario.scenario import Scenario

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
        """The vehicle as MetaDrive is told of it."""
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
