"""The dynamics that a scenario can name in `car.dynamics`, and what is known of each; imports none of them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DynamicsKind:
    """What is known of a car's dynamics before they are made.

    Attributes:
        target: `package.module:function` that makes them for a scenario.
        tyres: whether the car has tyres of its own, on which the road's friction acts and which limit every brake.
        known: whether their answer to a command follows from what is recorded and the episode's draws.
        steers: whether the car can follow a road with curves.
        scenario: a shipped scenario that has them.
    """

    target: str
    tyres: bool
    known: bool
    steers: bool
    scenario: str


BASIC = "basic"
DYNAMICS = {
    BASIC: DynamicsKind(
        "skd_sim.world.dynamics.basic:BasicCar", tyres=False, known=True, steers=True, scenario="crossing"
    ),
    "multi_body": DynamicsKind(
        "skd_sim.world.dynamics.multi_body_car:MultiBodyCar",
        tyres=True,
        known=False,
        steers=False,
        scenario="crossing_multi_body",
    ),
}
