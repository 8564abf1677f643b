"""The floor found for any car: against the exact one, against kamikazes that were run, and for cars hard to ask."""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import numpy as np
import pytest
from clairvoyant_support import CROSSING, any_touch, bent, kamikaze_episode
from skd_evaluator.campaign.plan import Plan
from skd_evaluator.campaign.runner import run_episode
from skd_evaluator.floor.anytime import actions_of, anytime_floor
from skd_evaluator.margin.exact import exact_margin
from skd_evaluator.measure.deformation import deformation
from skd_sim.branching import Branch
from skd_sim.controllers import BasicController
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode import Episode, Mode, Outcome
from skd_sim.objective import Objective
from skd_sim.state import CarState, PedestrianState

POINTS = [(-3.5 + 0.75 * k, 0.3 * math.sin(k)) for k in range(8)]


def episodes(multiplier: float, count: int = 6) -> list[Episode]:
    return [kamikaze_episode(POINTS, 40, multiplier, number=number, simulations=50) for number in range(count)]


def same(one, other) -> bool:
    equal = np.array_equal(one.actions, other.actions) and np.array_equal(
        one.trajectory.positions, other.trajectory.positions
    )
    return equal and one.distance == other.distance and one.duration == other.duration


@pytest.mark.parametrize("multiplier", [0.5, 1.0, 1.15])
def test_never_below_the_exact_floor_and_near_it_with_the_default_budget(multiplier):
    found, exact = [], []
    for episode in episodes(multiplier):
        best, known = anytime_floor(episode), exact_margin(any_touch(episode), half_speed=False)
        assert best is not None
        assert known is not None
        assert best.distance >= known.distance - 1e-9
        found.append(best.distance)
        exact.append(known.distance)
    assert np.mean(found) <= 1.05 * np.mean(exact) + 1e-9


def test_where_every_step_of_phi_is_another():
    for seed in range(4):
        episode = kamikaze_episode(bent(np.random.default_rng(seed), 9), 30, 1.0, seed)
        best, known = anytime_floor(episode), exact_margin(any_touch(episode), half_speed=False)
        assert known is not None
        assert best is not None
        assert best.distance >= known.distance - known.gap - 1e-9


def test_a_longer_budget_finds_no_less_and_the_same_one_the_same():
    for episode in episodes(1.15, 3):
        distances = []
        for budget in (1, 5, 20, 60, 150, 400):
            best = anytime_floor(episode, budget)
            if best is None:
                assert not distances  # once something is found, it stays
                continue
            assert best.simulated_steps <= budget
            distances.append(best.distance)
        assert distances == sorted(distances, reverse=True)
        again, once = anytime_floor(episode, 150), anytime_floor(episode, 150)
        assert again is not None
        assert once is not None
        assert same(again, once)


def test_never_above_the_kamikaze_it_starts_from():
    for objective in (Objective.PAPER, Objective.DEFORMATION):
        for episode in episodes(1.0, 3):
            log = run_episode(replace(episode, objective=objective))
            assert log.outcome == Outcome.COLLISION
            own = deformation(POINTS, log.trajectory.positions, log.impact_time / CROSSING.time_step)
            actions = actions_of(log)
            best = anytime_floor(episode, len(POINTS) + len(actions) + 1, actions)
            assert best is not None
            assert best.distance <= own + 1e-9


@pytest.mark.parametrize(
    ("controller", "scenario"), [("carla", "crossing"), ("cal", "crossing"), ("basic", "crossing_multi_body")]
)
def test_other_cars_are_hit_as_the_search_says(controller, scenario):
    setting = Plan(load_scenario(scenario), controller=controller).scenario
    episode = replace(kamikaze_episode(POINTS), scenario=setting, controller=controller)
    best = anytime_floor(episode, 60)
    assert best is not None
    assert best.distance == pytest.approx(deformation(POINTS, best.trajectory.positions, best.duration), abs=1e-12)
    along = run_episode(replace(episode, mode=Mode.REPLAY))
    assert (along.outcome == Outcome.COLLISION) <= (best.distance <= 1e-9)


class Uncopyable(BasicController):
    """The basic controller with something in it of which no copy can be made."""

    def __init__(self) -> None:
        super().__init__(1.0)
        self.lock = threading.Lock()


_memory: list[float] = []


class Forgetful(BasicController):
    """Counts its decisions outside of itself, so that a copy of it is not the same car: it never brakes twice."""

    def __init__(self) -> None:
        super().__init__(1.15)

    def reset(self, scenario, rng) -> None:
        super().reset(scenario, rng)
        _memory.clear()

    def command(self, car: CarState, pedestrian: PedestrianState) -> float:
        wanted = super().command(car, pedestrian)
        _memory.append(wanted)
        return wanted if sum(one < 0.0 for one in _memory) <= 1 else 0.0


def test_a_controller_that_cannot_be_copied_is_run_again_from_the_start():
    episode = episodes(1.0, 1)[0]
    assert not Branch(episode, Uncopyable).can_be_copied()
    assert Branch(episode).can_be_copied()
    again, copied = anytime_floor(episode, 80, controller=Uncopyable), anytime_floor(episode, 80)
    assert again is not None
    assert copied is not None
    assert same(again, copied)


def test_what_a_controller_keeps_outside_of_itself_does_not_mislead():
    best = anytime_floor(episodes(1.15, 1)[0], 80, controller=Forgetful)
    assert best is not None  # its collision was seen in a run from the start


def test_no_floor_where_nobody_can_collide():
    assert anytime_floor(kamikaze_episode([(-3.5, 0.0), (2.0, 0.0)], 8, impact=30.0), 200) is None


def test_bad_questions_are_refused():
    episode = episodes(1.0, 1)[0]
    with pytest.raises(ValueError, match="REPLAY"):
        anytime_floor(replace(episode, mode=Mode.REPLAY))
    with pytest.raises(ValueError, match="at least 1"):
        anytime_floor(episode, 0)
