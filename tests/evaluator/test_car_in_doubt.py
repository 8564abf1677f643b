"""Figures that may be those of another car: wherever they stand, that is said, and no gate passes with them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from skd_evaluator.assessing import again
from skd_evaluator.assessing.again import doubts_of_episodes
from skd_evaluator.campaign.judge.alone import doubts_of_standing_off
from skd_evaluator.campaign.plan.lot import Kept, spread_by_lot
from skd_evaluator.campaign.plan.plan import Plan, safe_trajectories
from skd_evaluator.campaign.run.alone import Alone
from skd_evaluator.campaign.run.led import LedAdversary, LedAgain, LedWay
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.measure.doubt import DISBELIEF, DOUBT
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.controllers import Controller, make_controller
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.episode.episode import EpisodeLog, Mode, Outcome
from skd_sim.state import AdversaryState, CarState

CROSSING = load_scenario("crossing")
CAR = CarUnderTest("a.b:C")
PLAN = Plan(CROSSING, safe_count=2, controller="a.b:C")
PHI = safe_trajectories(Plan(CROSSING, safe_count=2), InProcessRunner(1))


class Careful:
    """Brakes for whoever is near; `when` says in which episodes, counted from 0, it brakes for anybody at all."""

    def __init__(self, when: Sequence[bool] = ()) -> None:
        self._when, self._number = when, -1

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self._number += 1
        self._front = scenario.car.front

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        if self._number < len(self._when) and self._when[self._number]:
            return -8.0
        gap = adversary.y - car.y - self._front
        return -6.0 if 0.0 <= gap <= car.speed**2 / 12.0 + 1.0 and abs(adversary.x - car.x) < 2.5 else 0.0


class Stander:
    """Stands as soon as anybody is within so many metres, and slows down to a speed."""

    def __init__(self, within: float, speed: float) -> None:
        self._within, self._speed = within, speed

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        pass

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        near = np.hypot(adversary.x - car.x, adversary.y - car.y) < self._within
        return float(np.clip((self._speed - car.speed) / CROSSING.time_step, -8.0, 0.0)) if near else 0.0


def runs(controller: Controller, count: int = 10) -> list[EpisodeLog]:
    episodes = [PLAN.episode(Mode.REPLAY, number % 2, number // 2, PHI[number % 2]) for number in range(count)]
    return [run_episode(one, controller) for one in episodes]


# --- what is looked at again


def test_what_is_looked_at_again_is_known_to_nobody() -> None:
    """A car that knew which crossings are kept could be honest in these alone."""

    def kept(*counts: int) -> tuple[int, ...]:
        some, first = Kept(), 0
        for count in counts:
            some.add(first + one for one in some.wants(count))  # type: ignore[misc]  # they are numbers here
            first += count
        return tuple(some.logs)  # type: ignore[arg-type]

    assert kept(7, 200, 1) == tuple(range(208))  # all of a few
    drawn = [kept(7, 250, 1, 842) for _ in range(20)]
    assert len(set(drawn)) > 10
    for one in drawn:
        assert 120 <= len(one) <= 240
        assert [part // 100 for part in range(0, 1100, 100)] == sorted({number // 100 for number in one})
    assert {number % 16 for one in drawn for number in one} == set(range(16))  # none is always passed over
    chosen = {tuple(spread_by_lot(range(100), 10)) for _ in range(20)}
    assert len(chosen) > 10
    assert all([one // 10 for one in some] == list(range(10)) for some in chosen)
    assert spread_by_lot(range(3), 10) == [0, 1, 2]


def test_somebody_who_is_led_on_the_way_of_a_plan_has_the_same_episode() -> None:
    plan = Plan(CROSSING, safe_count=2, simulations=100)
    for number in range(2):
        first = run_episode(plan.episode(Mode.KAMIKAZE, number, 0, PHI[number]))
        led = LedAdversary.along(first.adversary, CROSSING.time_step)
        second = run_episode(first.episode, adversary=led)
        assert first.outcome == second.outcome
        np.testing.assert_allclose(first.car, second.car, rtol=0.0, atol=1e-9)


class Here:
    """A runner in this process, whose car is another one."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller

    def start(self) -> None:
        pass

    def map(self, work: Any, items: Sequence[Any]) -> list[Any]:
        return [work(one) for one in items]


def doubts(
    monkeypatch: pytest.MonkeyPatch,
    first: Controller | Sequence[EpisodeLog],
    second: Controller,
    led: Sequence[LedWay] = (),
    count: int = 40,
    alone: list[list[float]] | None = None,
) -> tuple[str, ...]:
    """Return what is said of a car that was one controller at first, and is another one when it is asked again.

    Asked alone it gives the answers `alone` to the first episodes; it ends where there are none.
    """

    def fresh() -> AbstractContextManager[Any]:
        return nullcontext(Here(second))

    monkeypatch.setattr(again, "apart", lambda _car: second)
    monkeypatch.setattr(again, "led_again", lambda way: LedAgain(True, bool(way.velocities.any())))
    monkeypatch.setattr(Alone, "__init__", lambda *_: None)
    monkeypatch.setattr(Alone, "__exit__", lambda *_: None)
    monkeypatch.setattr(Alone, "answers", lambda *_: "it ended" if alone is None else alone)
    return doubts_of_episodes(CAR, first if isinstance(first, list) else runs(first, count), led, fresh)


def test_a_car_that_was_surely_more_careful_at_first_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    (line,) = doubts(monkeypatch, Stander(1000.0, 0.0), make_controller("basic", 0.0))
    assert line.startswith(DISBELIEF)
    assert "collided then alone, 0 before alone" in line
    (line,) = doubts(monkeypatch, make_controller("basic", 0.0), Stander(1000.0, 0.0))
    assert line.startswith(DOUBT)


@pytest.mark.usefixtures("lots")
def test_a_few_careful_episodes_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """One in ten: twelve would miss it every third time, 24 do once in twelve; which are looked at is drawn by lot."""
    found = [
        doubts(monkeypatch, Careful([number % 10 == 5 for number in range(200)]), Careful(), count=200)
        for _ in range(3)
    ]
    assert sum(any("went otherwise" in line for line in lines) for lines in found) >= 2


def test_who_answers_otherwise_alone_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It goes as before when episodes are run again; so it knows, by whatever, that it is in one."""
    stander = Stander(1000.0, 0.0)
    logs = runs(stander, 2)
    answers = [[0.0] * (len(log.car) - 1) for log in logs]
    (line,) = doubts(monkeypatch, logs, stander, alone=answers)
    assert line.startswith(f"{DISBELIEF}in 2 of 2 episodes a.b:C answered otherwise when it was asked the same alone")
    assert "(the first is a run along φ, episode " in line


def test_one_fault_does_not_hide_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """A car that keeps something had nothing said of its copies."""
    way = LedWay(PLAN.episode(Mode.KAMIKAZE, 0, 0, PHI[0]), np.zeros((1, 2)), np.zeros((1, 4)))
    kept, copies = doubts(monkeypatch, Careful([True] * 3), Careful(), [way] * 5, 12)
    assert "episodes went otherwise" in kept
    assert "on 5 of 5 ways" in copies
    assert all(line.startswith((DOUBT, DISBELIEF)) for line in (kept, copies))
    assert copies.startswith(DOUBT)
    hit = way._replace(velocities=np.ones((1, 2)))
    _, copies = doubts(monkeypatch, Careful([True] * 3), Careful(), [hit] * 5, 12)
    assert copies.startswith(DISBELIEF)
    assert "hit on 5 of them where it had not" in copies
    same = doubts(monkeypatch, Careful(), Careful(), [way], 12)
    assert [line.startswith(DOUBT) for line in same] == [True, False]  # could not be asked alone; copies
    assert same[1].startswith(DISBELIEF)


# --- who does not drive


def test_a_car_that_stands_far_off_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    """It drives where nobody is, and had an excellent margin without a word."""
    further = replace(CROSSING, car=replace(CROSSING.car, start_gap=50.0, meet_safe_trajectory=False))
    monkeypatch.setattr(sys.modules[__name__], "PLAN", replace(PLAN, scenario=further))
    (line,) = doubts_of_standing_off("a.b:C", runs(Stander(100.0, 0.0)))
    assert line.startswith(DISBELIEF)
    assert "in 10 of 10 runs along φ" in line
    assert "does not drive hits nobody" in line
    assert doubts_of_standing_off("a.b:C", runs(Stander(20.0, 0.0))) == ()


def test_recordings_of_a_car_that_stood_are_not_believed() -> None:
    """Its place says nothing: it never drove."""
    logs = [
        EpisodeLog(one.episode, Outcome.ARRIVED, one.adversary, np.array([[0.0, -1.0, 0.0]] * len(one.car)))
        for one in runs(Careful())
    ]
    (line,) = doubts_of_standing_off("recorded", logs)
    assert line.startswith(DISBELIEF)
    assert "does not drive hits nobody" in line
    assert doubts_of_standing_off("a.b:C", runs(Careful())) == ()
    starting = [
        EpisodeLog(one.episode, one.outcome, one.adversary, one.car * np.array([1, 1, 0 if number % 10 else 1]))
        for number, one in enumerate(runs(Careful()))
    ]
    for one in starting:
        one.car[3:, 2] = 8.0  # who stands at first, and starts
    assert doubts_of_standing_off("a.b:C", starting) == ()
