"""What is to be seen of an episode that is under way: where both are, and a few figures."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import Episode
from skd_sim.world.state import CarState, RoadUserState

from skd_evaluator.metrics.deviation import deviation
from skd_evaluator.metrics.surrogate_measures import clearance_at


@dataclass(frozen=True)
class Situation:
    """How an episode stands.

    Attributes:
        scenario: where it takes place.
        time: since its start, s.
        car: state of the car under test.
        adversary: state of the adversary.
        walked: places of the adversary at the ticks so far, n × 2, m.
        phi: the safe trajectory φ that is followed, n × 2, m; None where there is none.
        command: what the car commanded last; nan before its first command.
        unit: unit of the command, m/s² or m/s.
        age: wall time from the state that the command answers to its use, s; nan where it is not known.
        clearance: distance between the outlines of car and adversary, m.
        strayed: greatest distance of the adversary so far from where φ is at the same time, m; nan without φ.
        note: what there is to say beside; empty for nothing.
    """

    scenario: Scenario
    time: float
    car: CarState
    adversary: RoadUserState
    walked: FloatArray
    phi: FloatArray | None = None
    command: float = math.nan
    unit: str = "m/s²"
    age: float = math.nan
    clearance: float = math.nan
    strayed: float = math.nan
    note: str = ""

    def figures(self) -> list[tuple[str, str]]:
        """Return name and value of each figure, as people read them."""
        found = [
            ("time", f"{self.time:.1f} s"),
            ("speed", f"{self.car.speed:.1f} m/s"),
            ("command", "none yet" if math.isnan(self.command) else f"{self.command:+.1f} {self.unit}"),
            ("clearance", f"{self.clearance:.1f} m"),
        ]
        if not math.isnan(self.age):
            found.append(("age of the command", f"{self.age:.3f} s"))
        if not math.isnan(self.strayed):
            found.append(("strayed from φ", f"{self.strayed:.2f} m"))
        return found

    def line(self) -> str:
        """Return the figures in one line."""
        return ", ".join(f"{name} {value}" for name, value in self.figures())


class Onlooker:
    """Turns the states of one episode into situations."""

    def __init__(self, episode: Episode, unit: str = "m/s²") -> None:
        """Begin.

        Args:
            episode: the episode that is under way.
            unit: unit of the car's commands.
        """
        self._scenario, self._unit = episode.scenario, unit
        safe = episode.safe_trajectory
        self._phi = None if safe is None else safe.positions
        self._walked: list[tuple[float, float]] = []

    def see(
        self, tick: int, period: int, car: CarState, adversary: RoadUserState, command: float, age: float
    ) -> Situation:
        """Return the situation in a control period.

        Args:
            tick: number of the tick.
            period: number of the control period in the tick, 0 at the tick itself.
            car: state of the car.
            adversary: state of the adversary.
            command: what the car commanded last; nan before its first command.
            age: age of that command when it was used, s; nan where it is not known.
        """
        if period == 0 and tick == len(self._walked):
            self._walked.append((adversary.x, adversary.y))
        walked = np.array(self._walked or [adversary[:2]])
        strayed = math.nan if self._phi is None else deviation(self._phi, walked, len(walked) - 1)
        time = (tick + period / self._scenario.control_periods) * self._scenario.time_step
        apart = clearance_at(self._scenario, car, adversary)
        return Situation(
            self._scenario, time, car, adversary, walked, self._phi, command, self._unit, age, apart, strayed
        )
