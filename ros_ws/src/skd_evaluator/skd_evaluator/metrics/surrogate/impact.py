"""What a contact does: closing speed, change of the car's speed and of the other's, and a pedestrian's risk to die.

* Closing speed: how fast the two come together at the contact, the amount of their relative velocity.
* Delta-v: how much each one's velocity changes where both go on together, as in a plastic impact without rotation:
  the closing speed by the other's share of the mass (S. M. Shelby, "Delta-V as a measure of traffic conflict severity",
  3rd International Conference on Road Safety and Simulation, 2011). Masses are those of `MASSES`: nobody weighs them.
* Risk that a pedestrian dies: Q. Hussain, H. Feng, R. Grzebieta, T. Brijs and J. Olivier, "The relationship between
  impact speed and the probability of pedestrian fatality during a vehicle-pedestrian crash: a systematic review and
  meta-analysis", Accident Analysis and Prevention 129, 2019: odds that grow by 11 % a km/h (95 % interval 10 to 12 %)
  and a risk of one half at 59 km/h. The interval here is that of the growth alone, for the summary states none of the
  level; and people differ: the old die at lower speeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from skd_sim.arrays import FloatArray

from skd_evaluator.metrics.statistics.statistics import Interval
from skd_evaluator.metrics.surrogate.scene import Scene

KMH = 3.6
HALF_AT = 59.0
"""km/h at which half of the pedestrians die."""
ODDS, ODDS_INTERVAL = 1.11, (1.10, 1.12)
"""By which the odds grow for each km/h."""
_FASTEST = 100.0  # m/s
CAR_MASS = 1500.0
"""kg, of the car under test: about the mean of new cars in Europe."""
MASSES = {
    "pedestrian": 78.0, "runner": 78.0, "child": 23.0, "cyclist": 95.0, "e_scooter": 95.0, "motorcycle": 280.0,
    "car": CAR_MASS, "van": 2500.0,
}  # fmt: skip
"""kg, by kind: those on foot are the dummies Hybrid III of a man and of a child of six, and a man rides the others."""


@dataclass(frozen=True)
class Risk:
    """A probability, with its interval."""

    value: float
    interval: Interval


def closing_speeds(scene: Scene) -> FloatArray:
    """Return the amount of the relative velocity at each moment, n, m/s; at a contact it is the closing speed."""
    heading, speed = scene.car[:, 2], scene.car[:, 3]
    own = np.column_stack([speed * np.cos(heading), speed * np.sin(heading)])
    return np.asarray(np.hypot(*(own - scene.velocity).T))


def delta_v(closing: float, mass: float, other_mass: float) -> float:
    """Return how much the velocity of one with a mass (kg) changes in a plastic impact with another, m/s.

    Raises:
        ValueError: a mass that is not above 0, or a closing speed that cannot be.
    """
    if not (_positive(mass) and _positive(other_mass)):
        raise ValueError(f"masses must be above 0 kg, got {mass} and {other_mass}")
    return _checked(closing) * other_mass / (mass + other_mass)


def greater_delta_v(closing: float, kind: str) -> float:
    """Return how much the velocity changes of whom it changes more, the car or one of a kind, m/s; nan: no such kind.

    Raises:
        ValueError: a closing speed that cannot be.
    """
    mass = MASSES.get(kind, math.nan)
    return delta_v(closing, min(mass, CAR_MASS), max(mass, CAR_MASS)) if kind in MASSES else math.nan


def fatality_risk(closing: float) -> Risk:
    """Return the risk that a pedestrian who is hit at a closing speed (m/s) dies.

    Raises:
        ValueError: a speed below 0, above 100 m/s or none.
    """
    beyond = KMH * _checked(closing) - HALF_AT

    def risk(odds: float) -> float:
        return 1.0 / (1.0 + math.exp(-math.log(odds) * beyond))

    low, high = sorted(risk(odds) for odds in ODDS_INTERVAL)
    return Risk(risk(ODDS), (low, high))


def _positive(value: float) -> bool:
    return math.isfinite(value) and value > 0.0


def _checked(speed: float) -> float:
    if not 0.0 <= speed <= _FASTEST:
        raise ValueError(f"a closing speed must be from 0 to {_FASTEST:g} m/s, got {speed}")
    return speed
