"""A car that hardly drives where nobody is near is told apart from one that avoids people."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from skd_evaluator.campaign.judge.alone import MANY_DRIVES, Drive, doubts_of_driving, drives_with_nobody_near
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.measure.doubt import DISBELIEF, DOUBT, HARDLY_DRIVES
from skd_sim.controllers import Controller, make_controller
from skd_sim.encounter.known_scenarios import shipped_scenarios
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.episode.episode import EpisodeLog, Outcome
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


class ByLot(Towards):
    """Draws in `reset` whether it drives as it began or at another speed, and counts how often it does the latter."""

    def __init__(self, speed: float, share: float) -> None:
        super().__init__(CROSSING.car.start_speed)
        self._other, self._share, self.others = speed, share, 0

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        other = rng.random() < self._share
        self._speed = self._other if other else CROSSING.car.start_speed
        self.others += other


class Runner:
    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    def run(self, episodes):
        return (run_episode(episode, self._controller) for episode in episodes)


class Kept:
    """Keeps what another runner has run."""

    def __init__(self, runner: Runner) -> None:
        self._runner, self.logs = runner, []

    def run(self, episodes):
        for log in self._runner.run(episodes):
            self.logs.append(log)
            yield log


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


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("share", [0.05, 0.2, 0.3, 0.6])
def test_a_car_that_stands_now_and_then_is_found(share: float, seed: int) -> None:
    """A quarter of the drives is where doubt becomes disbelief; none of 20 drives is seen 36 % of the time at 0.05."""
    car = ByLot(0.0, share)
    found = doubts_of_driving(replace(PLAN, seed=seed), Runner(car))
    assert len(found) == (car.others > 0)
    for line in found:
        assert f"s in {car.others} of {MANY_DRIVES} drives, and a hit begins" in line
        assert line.startswith(DISBELIEF if car.others > MANY_DRIVES / 4 else DOUBT)


def test_drives_differ_in_noise_and_in_what_a_controller_draws() -> None:
    car = ByLot(0.0, 0.5)
    drives = drives_with_nobody_near(PLAN, Runner(car), 40)
    assert len({drive.first for drive in drives}) == 1
    assert len({drive.last for drive in drives if drive.last > 1.0}) == 40 - car.others
    assert abs(car.others - 20) < 4 * 40**0.5 / 2
    assert [drive.kept for drive in drives] == sorted(drive.kept for drive in drives)


@pytest.mark.parametrize(
    ("speed", "share", "said"),
    [
        (0.3, 0.2, True),  # of its speed: it crawls in a single drive
        (0.5, 0.3, False),  # slower than others drive, by lot; the median drive is not
        (0.5, 0.8, True),
        (0.8, 1.0, False),
    ],
)
def test_a_car_that_crawls_for_nobody_has_a_warning(speed: float, share: float, said: bool) -> None:
    car = ByLot(speed * CROSSING.car.start_speed, share)
    found = doubts_of_driving(PLAN, Runner(car))
    assert car.others > 0
    assert [line.startswith(HARDLY_DRIVES) for line in found] == [True] * said


class Driven:
    """Runs no car: each drive ends at a speed that is given, or is aborted where that is not a number."""

    def __init__(self, *speeds: float) -> None:
        self._speeds = speeds

    def run(self, episodes):
        for episode, last in zip(episodes, self._speeds, strict=True):
            way = episode.safe_trajectory.positions
            speeds = np.linspace(CROSSING.car.start_speed, last, len(way))
            car = np.column_stack([np.zeros(len(way)), np.cumsum(speeds), speeds])
            outcome = Outcome.ABORTED if math.isnan(last) else Outcome.TIMEOUT
            yield EpisodeLog(episode, outcome, way, car, reason="controller ended")


STARTS, LIMIT = CROSSING.car.start_speed, CROSSING.collision.hit_speed


@pytest.mark.parametrize(
    ("speeds", "begins", "often"),
    [
        ([0.71 * STARTS] * 4, None, ""),
        ([0.69 * STARTS] * 4, HARDLY_DRIVES, ""),
        ([0.69 * STARTS, 0.69 * STARTS, STARTS, STARTS, STARTS], None, ""),  # of which the median is
        ([0.69 * STARTS] * 3 + [STARTS] * 2, HARDLY_DRIVES, " in 3 of 5 drives"),
        ([0.36 * STARTS, STARTS, STARTS], None, ""),
        ([0.34 * STARTS, STARTS, STARTS], HARDLY_DRIVES, " in 1 of 3 drives"),
        ([1.51 * LIMIT] * 4, HARDLY_DRIVES, ""),
        ([1.49 * LIMIT] * 4, DISBELIEF, ""),
        ([1.49 * LIMIT, STARTS, STARTS, STARTS], DOUBT, " in 1 of 4 drives"),  # a quarter is not more
        ([1.49 * LIMIT, 0.0, STARTS, STARTS], DISBELIEF, " in 2 of 4 drives"),
        ([STARTS, math.nan], DOUBT, ""),
    ],
)
def test_where_each_word_begins(speeds: list[float], begins: str | None, often: str) -> None:
    lines = doubts_of_driving(PLAN, Driven(*speeds), len(speeds))
    assert len(lines) == (begins is not None)
    for line in lines:
        assert line.startswith(begins)
        assert ("controller ended" in line) == math.isnan(sum(speeds))
        assert re.findall(r" in \d+ of \d+ drives", line) == [often] * bool(often)


def test_how_fast_it_was_is_of_the_drive_in_the_middle_of_those_that_are_meant() -> None:
    (line,) = doubts_of_driving(PLAN, Driven(1.0, 1.2, 1.4, STARTS, STARTS), 5)
    assert f"from {STARTS:.1f} to 1.2 m/s in 6.0 s in 3 of 5 drives" in line


def test_a_car_that_begins_standing_slows_down_for_nobody() -> None:
    assert [Drive(first, last, 6.0).kept for first, last in ((0.0, 0.0), (0.0, 5.0))] == [1.0, 1.0]
    assert [Drive(first, last, 6.0).kept for first, last in ((8.0, 4.0), (0.8, 0.2))] == [0.5, 0.25]


@pytest.mark.parametrize("name", shipped_scenarios())
def test_nobody_is_near_in_any_encounter(name: str) -> None:
    """For six seconds, or as long as an episode lasts."""
    scenario = load_scenario(name)
    runner = Kept(Runner(Towards(scenario.car.start_speed)))
    for drive in drives_with_nobody_near(replace(PLAN, scenario=scenario), runner, 2):
        assert drive.seconds == pytest.approx(min(6.0, scenario.ticks * scenario.time_step), abs=scenario.time_step)
    for log in runner.logs:
        assert log.episode.scenario.others == ()
        assert np.hypot(*(log.adversary - log.car[:, :2]).T).min() > 1000.0


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
