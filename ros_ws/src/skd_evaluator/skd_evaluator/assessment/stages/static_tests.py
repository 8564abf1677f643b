"""A regulator's static tests: the car without noise, and a target that follows the protocol whatever the car does."""

from __future__ import annotations

import dataclasses

from skd_sim.errors import AssessmentError
from skd_sim.options.car_and_adversary import CarUnderTest, is_own_world
from skd_sim.scenario.protocol import regulatory_trajectories
from skd_sim.scenario.scenario import Scenario
from skd_sim.scenario.scenario_file import REGULATORY
from skd_sim.world.episode import EpisodeSpec, Mode

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.context import Context, stage
from skd_evaluator.assessment.episode_figures import StaticTest


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
    except AssessmentError as error:  # a car that fails here alone has its figures all the same
        tests = [StaticTest(place=place, aborted=str(error)) for place, _ in chosen]
    else:
        tests = [StaticTest.of(place, log) for (place, _), log in zip(chosen, logs, strict=True)]
    return dataclasses.replace(assessment, static_tests=tuple(one.as_dict() for one in tests))
