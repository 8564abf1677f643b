"""A regulator's static test: the car, without noise, and a target that follows the protocol whatever the car does."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from skd_sim.controllers import Controller
from skd_sim.options.car_under_test import CarUnderTest
from skd_sim.scenario.protocol import impact_offset, regulatory_trajectories
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import Episode, EpisodeLog, Mode, Outcome

from skd_evaluator.assessment.run.runner import run_episode


@dataclass(frozen=True)
class StaticTest:
    """What came of one cell of a regulator's grid.

    Attributes:
        place: where on its front the unbraked car meets the target, % of its width.
        log: what happened.
    """

    place: float
    log: EpisodeLog

    @property
    def touched(self) -> bool:
        """Whether the car touched the target."""
        return self.log.outcome == Outcome.COLLISION

    @property
    def impact_speed(self) -> float:
        """Speed of the car when it touched the target, m/s; 0 where it did not."""
        return self.log.impact_speed if self.touched else 0.0

    @property
    def impact_place(self) -> float:
        """Where on the car's front the target's centre was at the contact, % of the car's width; nan without one."""
        if not self.touched:
            return math.nan
        scenario = self.log.episode.scenario
        x, y = self.log.trajectory.positions[-1].tolist()
        return 50.0 + 50.0 * scenario.end.place(x, y)[0] / impact_offset(scenario, 100.0)


def without_noise(scenario: Scenario) -> Scenario:
    """Return a scenario in which the car starts in the middle of its start range, and moves as it is commanded to."""
    car = scenario.car
    middle = car.start_gap + 0.5 * car.start_gap_range
    still = dataclasses.replace(car, start_gap=middle, start_gap_range=0.0, speed_noise=0.0, acceleration_noise=0.0)
    return dataclasses.replace(scenario, car=still)


def static_episodes(scenario: Scenario, car: CarUnderTest) -> list[Episode]:
    """Return the static test of each impact place of a scenario's protocol, to be run.

    Args:
        scenario: with a section `protocol`, and the control period that the controller declares.
        car: the car under test.

    Raises:
        UsageError: the scenario has no protocol.
    """
    still = without_noise(scenario)
    return [
        Episode(
            still,
            Mode.REPLAY,
            0,
            number,
            safe_trajectory=way,
            public=scenario,
            controller=car.controller,
            multiplier=car.multiplier,
        )
        for number, way in enumerate(regulatory_trajectories(still))
    ]


def static_tests(scenario: Scenario, car: CarUnderTest, controller: Controller | None = None) -> list[StaticTest]:
    """Run the static test of each impact place of a scenario's protocol.

    Args:
        scenario: as of `static_episodes`.
        car: the car under test.
        controller: the same, if it is there already; made by its name by default.

    Raises:
        UsageError: the scenario has no protocol.
    """
    episodes = static_episodes(scenario, car)
    assert scenario.protocol is not None
    places = scenario.protocol.impact_places
    return [StaticTest(place, run_episode(one, controller)) for place, one in zip(places, episodes, strict=True)]
