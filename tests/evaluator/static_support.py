"""Static tests of a controller, run one by one."""

import math
from dataclasses import dataclass

from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.assessment.stages.static_tests import static_episodes
from skd_sim import Controller, EpisodeLog, Outcome, Scenario
from skd_sim.options.car_and_adversary import CarUnderTest
from skd_sim.scenario.protocol import impact_offset


@dataclass(frozen=True)
class StaticRun:
    """What came of one cell of a regulator's grid."""

    place: float  # where on its front the unbraked car meets the target, % of its width
    log: EpisodeLog

    @property
    def touched(self) -> bool:
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


def static_tests(scenario: Scenario, car: CarUnderTest, controller: Controller | None = None) -> list[StaticRun]:
    """Run the static test of each impact place of a scenario's protocol."""
    episodes = static_episodes(scenario, car)
    places = scenario.protocol.impact_places
    return [StaticRun(place, run_episode(one, controller)) for place, one in zip(places, episodes, strict=True)]
