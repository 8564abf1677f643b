"""A regulator's static tests: the car without noise, and a target that follows the protocol whatever the car does."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from skd_sim.options.car_under_test import CarUnderTest, is_own_world
from skd_sim.scenario.protocol import regulatory_trajectories
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario
from skd_sim.scenario.scenario_file import REGULATORY
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, stage
from skd_evaluator.assessment.episode_figures import ADVERSARY, collision_partner, speed_ahead
from skd_evaluator.errors import AssessmentError, OutOfReachError


def without_noise(scenario: Scenario) -> Scenario:
    """Return a scenario in which the car starts in the middle of its start range, and moves as it is commanded to."""
    car = scenario.car
    middle = car.start_gap + 0.5 * car.start_gap_range
    still = dataclasses.replace(car, start_gap=middle, start_gap_range=0.0, speed_noise=0.0, acceleration_noise=0.0)
    return dataclasses.replace(scenario, car=still)


def static_episodes(scenario: Scenario, car: CarUnderTest) -> list[EpisodeSpec]:
    """Return the static test of each impact place of a scenario's protocol, to be run.

    Args:
        scenario: with a section `protocol`, and the control period that the controller declares.
        car: the car under test.

    Raises:
        UsageError: the scenario has no protocol.
    """
    still = without_noise(scenario)
    return [
        EpisodeSpec(
            still,
            Mode.REPLAY,
            0,
            number,
            safe_trajectory=track,
            public=scenario,
            controller=car.controller,
            multiplier=car.multiplier,
        )
        for number, track in enumerate(regulatory_trajectories(still))
    ]


@dataclass(frozen=True, kw_only=True)
class StaticTest:
    """One static test: no noise, and a target that goes the protocol's way whatever the car does.

    Attributes:
        place: where on its front the unbraked car meets the target, % of its width.
        touched: whether the car touched anybody.
        target: whether that was the target.
        impact_speed: speed of the car when it did, m/s; 0 where it did not.
        speed_ahead: speed of the target the way that the car pointed then, m/s; 0 where it was not touched.
        fastest: greatest speed of the car, m/s.
        braking_ttc: time to collision when the car began to brake, along the lane with both speeds kept, s; None where
            it did not brake before the target.
        aborted: why the test was aborted; empty: it was not.

    Raises:
        ValueError: one entry contradicts another.
    """

    place: float
    touched: bool = False
    target: bool = False
    impact_speed: float = 0.0
    speed_ahead: float = 0.0
    fastest: float = 0.0
    braking_ttc: float | None = None
    aborted: str = ""

    def __post_init__(self) -> None:
        """Refuse what no test can have found."""
        strange = self.impact_speed < 0.0 or self.impact_speed > self.fastest or (self.touched and bool(self.aborted))
        if strange or (not self.touched and (self.target or self.impact_speed or self.speed_ahead)):
            raise ValueError(f"the static test at {self.place:g} % contradicts itself")

    @classmethod
    def of(cls, place: float, log: EpisodeLog) -> StaticTest:
        """Return what an episode of `static_episodes` says."""
        if log.outcome == Outcome.ABORTED:
            return cls(place=place, aborted=log.reason)
        touched = log.outcome == Outcome.COLLISION
        impact = log.impact_speed if touched else 0.0
        return cls(
            place=place,
            touched=touched,
            target=touched and collision_partner(log) == ADVERSARY,
            impact_speed=impact,
            speed_ahead=speed_ahead(log) if touched else 0.0,
            fastest=max(impact, float(log.car[:, 3].max())),
            braking_ttc=braking_ttc(log),
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the entry in assessment.json."""
        return dataclasses.asdict(self)


_BRAKES = 0.5  # m/s² by which a car slows at least that brakes


def braking_ttc(log: EpisodeLog) -> float | None:
    """Return the time to collision along the lane (s) at the tick from which the car brakes; None where it does not."""
    scenario = log.episode.scenario
    slows = np.flatnonzero(np.diff(log.car[:, 3]) < -_BRAKES * scenario.time_step)
    if not slows.size:
        return None
    tick = int(slows[0])
    line = scenario.road.line
    (_, front), (_, there), (_, then) = right_and_along(
        line, np.array([log.car[tick, :2], log.adversary[tick], log.adversary[tick + 1]])
    ).tolist()
    gap = there - front - scenario.car.front
    closing = float(log.car[tick, 3]) - (then - there) / scenario.time_step
    return gap / closing if gap > 0.0 and closing > 0.0 else None


def place_of(name: str) -> float | None:
    """Return the impact place (%) of a safe trajectory by its name; None where it stands for none."""
    kind, _, place = name.partition("/")
    try:
        return float(place) if kind == REGULATORY else None
    except ValueError:
        return None


@stage(90)
def run(context: Context, assessment: Assessment) -> Assessment:
    """Return the assessment with the static test of each impact place that one of its φ stands for.

    There are some with the φ of a protocol, in SKD's own world, of a car that is no node of its own.
    """
    plan, protocol = assessment.plan, assessment.plan.scenario.protocol
    if plan.safe != REGULATORY or protocol is None or not is_own_world(plan.simulator) or plan.car.is_external:
        return assessment
    places = {place_of(one.name) for one in assessment.safe}
    every = zip(protocol.impact_places, static_episodes(plan.scenario, plan.car), strict=True)
    chosen = [(place, episode) for place, episode in every if place in places]
    try:
        logs = list(context.workers.run([episode for _, episode in chosen]))
    except OutOfReachError:
        raise
    except AssessmentError as error:  # a car that fails here alone has its figures all the same
        tests = [StaticTest(place=place, aborted=str(error)) for place, _ in chosen]
    else:
        tests = [StaticTest.of(place, log) for (place, _), log in zip(chosen, logs, strict=True)]
    return dataclasses.replace(assessment, static_tests=tuple(one.as_dict() for one in tests))
