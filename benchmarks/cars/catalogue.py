"""The cars by which figures are judged: 28 of 13 families, one list for all benchmarks.

Each is a class of this folder, a controller that SKD ships, or the vendor's example, in a shipped scenario; all meet
the same adversaries. Any of them is assessed by `PYTHONPATH=benchmarks scripts/skd assess --controller NAME`, NAME
being its `controller`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from skd_sim.controllers.controller import control_period_of, make_controller, with_control_period
from skd_sim.errors import UsageError
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.scenario.scenario import Scenario, load_scenario

MULTIPLIERS = (0.5, 0.75, 1.0, 1.15, 1.5)
SNOW = 0.3
"""Friction; above about 0.35 the road holds all that the basic controller asks of it."""


@dataclass(frozen=True)
class Car:
    """A car under test.

    Attributes:
        label: in tables, and of its part of a stored file.
        family: cars of one family decide by one law.
        controller: as in `EpisodeSpec` and in `--controller`.
        multiplier: C of the basic controller.
        scenario_name: as in `--scenario`; says the car's dynamics.
        friction: of the road, relative to a dry one.
    """

    label: str
    family: str
    controller: str
    multiplier: float = 1.0
    scenario_name: str = "crossing"
    friction: float = 1.0

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario, with the control period that the controller declares.

        Raises:
            UsageError: the controller cannot be made.
        """
        loaded = load_scenario(self.scenario_name)
        changed = replace(loaded, road=replace(loaded.road, friction=self.friction))
        made = make_controller(self.controller, self.multiplier)
        return with_control_period(changed, control_period_of(made, self.controller), self.controller)

    @property
    def has_multiplier(self) -> bool:
        """Whether its controller has a multiplier C."""
        return CarUnderTest(self.controller).has_multiplier

    @property
    def is_basic(self) -> bool:
        """Whether it is the paper's: then all is known of it."""
        return self.controller == "basic" and self.scenario_name == "crossing"


def _multi_body(label: str, controller: str = "basic", friction: float = 1.0) -> Car:
    return Car(label, "multi-body", controller, 1.0, "crossing_multi_body", friction)


CARS: tuple[Car, ...] = (
    *(Car(f"basic, C = {one:g}", "basic", "basic", one) for one in MULTIPLIERS),
    Car("time to collision, early", "time to collision", "cars.collision_time:EarlyBrake"),
    Car("time to collision", "time to collision", "cars.collision_time:CollisionTimeBrake"),
    Car("time to collision, late", "time to collision", "cars.collision_time:LateBrake"),
    Car("latched and delayed, gentle", "latched and delayed", "cars.collision_time:GentleLatchedBrake"),
    Car("latched and delayed", "latched and delayed", "cars.collision_time:LatchedBrake"),
    Car("slows near pedestrians", "slows near pedestrians", "cars.slows:SlowsNearAnybody"),
    Car("slows near pedestrians, late", "slows near pedestrians", "cars.slows:SlowsLate"),
    Car("Intelligent Driver Model", "Intelligent Driver Model", "cars.idm:IntelligentDriver"),
    Car("Intelligent Driver Model, watchful", "Intelligent Driver Model", "cars.idm:WatchfulDriver"),
    Car("CAL", "CAL", "cal"),
    Car("CARLA 0.8", "CARLA 0.8", "carla"),
    Car("required deceleration", "required deceleration", "cars.required_brake:RequiredDecelerationBrake"),
    Car("required deceleration, late", "required deceleration", "cars.required_brake:LateRequiredBrake"),
    Car("encroachment, polite", "encroachment", "cars.encroachment:PoliteEncroachmentBrake"),
    Car("encroachment", "encroachment", "cars.encroachment:EncroachmentBrake"),
    _multi_body("multi-body, basic, dry"),
    _multi_body("multi-body, basic, snow", friction=SNOW),
    _multi_body("multi-body, time to collision, snow", "cars.collision_time:CollisionTimeBrake", SNOW),
    Car("planner", "planner", "cars.planner:SamplingPlanner"),
    Car("planner, smooth", "planner", "cars.planner:SmoothPlanner"),
    Car("stop and go", "stop and go", "cars.stop_and_go:StopAndGo"),
    Car("stop and go, hasty", "stop and go", "cars.stop_and_go:HastyStopAndGo"),
    Car("vendor's example", "vendor's example", "cars.vendor:VendorCar"),
)


def available(cars: Sequence[Car] = CARS) -> tuple[list[Car], list[str]]:
    """Return the cars that can be made here, and a line for each of the others that says why not."""
    found, missing = [], []
    for car in cars:
        try:
            assert car.scenario
            found.append(car)
        except UsageError as error:
            missing.append(f"{car.label}: {error}")
    return found, missing
