"""A regulator's static test: the car, without noise, against a target that follows the protocol whatever the car does."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from skd_sim.choices.car_under_test import BASIC
from skd_sim.controllers import Controller
from skd_sim.encounter.protocol.target import impact_offset, regulatory_trajectories, target_heading
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.errors import UsageError

from skd_evaluator.campaign.run.runner import run_episode


@dataclass(frozen=True)
class StaticTest:
    """What came of one cell of a regulator's grid.

    Attributes:
        scenario: of the test, without noise.
        place: where on its front the unbraked car would meet the target, % of its width.
        log: what happened.
    """

    scenario: Scenario
    place: float
    log: EpisodeLog

    @property
    def impact_speed(self) -> float:
        """Speed of the car when it touched the target, m/s; 0 where it did not."""
        return self.log.impact_speed if self.log.outcome == Outcome.COLLISION else 0.0

    @property
    def relative_speed(self) -> float:
        """Component of the speed at which the two approached each other along the car's way, m/s; 0 without a contact."""
        if self.log.outcome != Outcome.COLLISION:
            return 0.0
        before, after = self.log.adversary[-2:, 1].tolist()
        return self.log.impact_speed - (after - before) / self.scenario.time_step

    @property
    def impact_place(self) -> float:
        """Where on the car's front the target's centre was at the contact, % of the car's width; nan without one."""
        if self.log.outcome != Outcome.COLLISION:
            return math.nan
        across, _ = self.scenario.end.place(*self.log.trajectory.positions[-1].tolist())
        return 50.0 + 100.0 * (across / (2.0 * impact_offset(self.scenario, 100.0)))


def without_noise(scenario: Scenario) -> Scenario:
    """Return a scenario in which the car starts in the middle of its start range, and moves as it is commanded to."""
    car = scenario.car
    still = dataclasses.replace(
        car,
        start_gap=car.start_gap + 0.5 * car.start_gap_range,
        start_gap_range=0.0,
        speed_noise=0.0,
        acceleration_noise=0.0,
    )
    return dataclasses.replace(scenario, car=still)


def static_tests(
    scenario: Scenario, *, controller: str = BASIC, multiplier: float = 1.0, car: Controller | None = None
) -> list[StaticTest]:
    """Run the static test of each impact place of a scenario's protocol.

    Args:
        scenario: with a section `protocol`, and the control period that the controller declares.
        controller: the car under test, by its name.
        multiplier: C of the basic car.
        car: the car under test itself, in place of one that is made by its name.

    Raises:
        UsageError: the scenario has no protocol.
    """
    still = without_noise(scenario)
    found = []
    assert still.protocol is not None or regulatory_trajectories(still)
    for number, way in enumerate(regulatory_trajectories(still)):
        episode = Episode(
            still, Mode.REPLAY, 0, number, safe_trajectory=way, controller=controller, multiplier=multiplier
        )
        found.append(StaticTest(still, _places(still)[number], run_episode(episode, car)))
    return found


def _places(scenario: Scenario) -> tuple[float, ...]:
    if scenario.protocol is None:
        raise UsageError(f"scenario {scenario.name} has no section protocol")
    return scenario.protocol.impact_places
