"""A car that hardly drives where nobody is near is told apart from one that avoids people."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from skd_evaluator.campaign.judge.alone import doubts_of_driving
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.measure.doubt import DISBELIEF
from skd_sim.controllers import Controller, make_controller
from skd_sim.encounter.known_scenarios import shipped_scenarios
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.errors import AssessmentError
from skd_sim.state import AdversaryState, CarState

CROSSING = load_scenario("crossing")
PLAN = Plan(CROSSING, controller="a.b:C")


class Towards:
    """Drives at one speed, whoever is there; at most 2 m/s² of change."""

    def __init__(self, speed: float) -> None:
        self._speed = speed

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        pass

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        return float(np.clip((self._speed - car.speed) / 0.3, -2.0, 2.0))


class Runner:
    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    def run(self, episodes):
        return (run_episode(episode, self._controller) for episode in episodes)


@pytest.mark.parametrize(
    ("speed", "said"),
    [(0.0, "does not drive hits nobody"), (0.6, "does not drive hits nobody"), (3.0, "is due to that, too"), (7.0, "")],
)
def test_a_car_that_slows_down_for_nobody_is_said_to(speed: float, said: str) -> None:
    found = doubts_of_driving(PLAN, Runner(Towards(speed)))
    assert len(found) == bool(said)
    for line in found:
        (first, last), noise = (
            map(float, re.findall(r"from (\S+) to (\S+) m/s in 6.0 s", line)[0]),
            CROSSING.car.speed_noise,
        )
        assert first == pytest.approx(CROSSING.car.start_speed, abs=0.05)
        assert last == pytest.approx(speed, rel=noise, abs=0.05)  # at 2 m/s² it is at its speed within 6 s
        assert said in line
        assert line.startswith(DISBELIEF) == (speed < 1.5 * CROSSING.collision.hit_speed)


@pytest.mark.parametrize("name", shipped_scenarios())
@pytest.mark.parametrize("car", ["basic", "carla"])
def test_cars_that_avoid_people_drive_in_every_encounter(car: str, name: str) -> None:
    plan = replace(PLAN, scenario=load_scenario(name), multiplier=2.0)
    assert doubts_of_driving(plan, Runner(make_controller(car, 2.0))) == ()


def test_a_car_that_fails_with_nobody_near_is_named() -> None:
    class Failing:
        def run(self, episodes):
            raise AssessmentError("controller a.b:C: command failed with ZeroDivisionError (b.py, line 1)")

    (line,) = doubts_of_driving(PLAN, Failing())
    assert "with nobody within a kilometre, this came of it: controller a.b:C: command failed" in line


def test_a_car_that_stands_is_told_from_one_that_stops_for_others() -> None:
    plan = replace(PLAN, scenario=load_scenario("bystanders"))
    assert plan.scenario.others
    assert len(doubts_of_driving(plan, Runner(Towards(0.0)))) == 1
    assert doubts_of_driving(plan, Runner(Towards(8.0))) == ()
