"""What of the simulated world can be calibrated: keys of a scenario, their units, and where one looks for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from skd_sim.options.car_under_test import DYNAMICS
from skd_sim.scenario.scenario import Scenario, scenario_from_dict

TYRES = "multi_body"
"""Dynamics that take the place of those without a brake and tyres."""


@dataclass(frozen=True)
class Parameter:
    """A parameter of the simulator.

    Attributes:
        name: in files and messages.
        place: its key in a scenario.
        text: what it is, as people read it.
        unit: of it; empty for a ratio.
        range: least and greatest value that is looked at.
        tried: values from which the search begins.
        step: by which its effect is looked at.
        is_limit: whether it is felt only where a car comes to it: beyond, all values are alike.
        sensing: whether it concerns cars with a laser alone.
    """

    name: str
    place: tuple[str, str]
    text: str
    unit: str
    range: tuple[float, float]
    tried: tuple[float, ...]
    step: float
    is_limit: bool = False
    sensing: bool = False

    def of(self, scenario: Scenario) -> float:
        """Return its value in a scenario."""
        section, key = self.place
        return float(getattr(getattr(scenario, section), key))

    def shown(self, value: float) -> str:
        """Return a value with its unit."""
        return f"{value:.3g} {self.unit}".rstrip()


PARAMETERS = {
    one.name: one
    for one in (
        Parameter("delay", ("car", "brake_delay"), "brake's delay", "s", (0.0, 1.0), (0.0, 0.1, 0.2, 0.35, 0.55), 0.03),
        Parameter(
            "deceleration",
            ("car", "brake_limit"),
            "brake's greatest deceleration",
            "m/s²",
            (0.5, 15.0),
            (2.0, 3.0, 4.0, 5.0, 6.5, 8.5),
            0.15,
            is_limit=True,
        ),
        Parameter(
            "friction",
            ("road", "friction"),
            "friction, relative to a dry road",
            "",
            (0.05, 1.3),
            (0.15, 0.25, 0.35, 0.5, 0.7, 0.9),
            0.02,
            is_limit=True,
        ),
        Parameter(
            "sensor_range",
            ("sensor", "maximum_range"),
            "sensor's range",
            "m",
            (2.0, 100.0),
            (6.0, 9.0, 12.0, 15.0, 20.0, 30.0, 50.0),
            1.0,
            is_limit=True,
            sensing=True,
        ),
    )
}


def calibrated(scenario: Scenario, values: Mapping[str, float]) -> Scenario:
    """Return a scenario with values of parameters, by name; its car gets a brake and tyres if it has none."""
    data = dict(scenario.as_dict())
    if not DYNAMICS[scenario.car.dynamics].tyres:
        data["car"] = {**data["car"], "dynamics": TYRES}
    for name, value in values.items():
        section, key = PARAMETERS[name].place
        data[section] = {**data[section], key: float(value)}
    return scenario_from_dict(data, f"scenario {scenario.name}, calibrated")
