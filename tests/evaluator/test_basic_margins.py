"""What the equivalent multiplier is read off: which basic cars are asked for, in which trials, and what is kept."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.margin import basic_margins as basic
from skd_evaluator.metrics.margins import MarginDifference
from skd_sim import Trajectory, load_scenario

CROSSING = load_scenario("crossing")
PLAN = Plan(CROSSING, seed=3, safe_count=3, kamikaze_count=4)
SAFE = [
    Trajectory(np.array([(-3.5 + 0.75 * tick * pace, drift * tick) for tick in range(11)]), 0.3)
    for pace, drift in ((1.0, 0.0), (0.8, 0.05), (1.0, 0.2))
]


def silent(*_told: object) -> None:
    pass


class Refuses(InProcessRunner):
    """A runner for those who have nothing to do."""

    def map(self, *_work, **_options):  # type: ignore[override]
        raise AssertionError("there was work to do")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("margins")


@pytest.mark.parametrize("multiplier", [0.6, 1.08])
def test_a_basic_car_reads_itself_back(multiplier, folder):
    runner = InProcessRunner(1)
    car = basic.BasicMargins(PLAN, SAFE, 4, runner, silent, folder).at(round(100 * multiplier))
    found, note = basic.equivalent_of(PLAN, SAFE, car, runner, silent, folder)
    assert found.value == pytest.approx(multiplier, abs=0.05)  # in 12 trials some C have the same margins
    assert found.ci95[0] <= multiplier <= found.ci95[1]
    assert "basic cars" in note


def test_nothing_depends_on_workers_or_on_what_was_kept(folder, tmp_path):
    car = [np.array([0.3, 0.5, 0.2, math.nan]), np.array([0.4, 0.3, 0.6, 0.5]), np.array([0.1, 0.3])]
    found = basic.equivalent_of(PLAN, SAFE, car, InProcessRunner(1), silent, folder)
    assert basic.equivalent_of(PLAN, SAFE, car, Refuses(1), silent, folder) == found
    with InProcessRunner(2) as runner:
        runner.start()
        assert basic.equivalent_of(PLAN, SAFE, car, runner, silent, tmp_path) == found


def test_a_car_that_cannot_be_hit_and_one_that_always_is(folder):
    above, _ = basic.equivalent_of(PLAN, SAFE, [np.full(4, math.inf)] * 3, InProcessRunner(1), silent, folder)
    below, _ = basic.equivalent_of(PLAN, SAFE, [np.zeros(4)] * 3, InProcessRunner(1), silent, folder)
    assert (above.text, below.text) == ("above 2", "below 0.25")
    assert above.value == math.inf == -below.value


def test_what_the_margins_depend_on_is_in_their_name():
    key = basic.margins_key(CROSSING, SAFE, 3, 4, 0.8)
    moved = Trajectory(SAFE[0].positions + np.array([0.0, 1e-9]), 0.3)
    narrow = replace(CROSSING, eta_max=4.0)
    slow = replace(CROSSING, collision=replace(CROSSING.collision, hit_speed=0.1))
    others = [
        basic.margins_key(narrow, SAFE, 3, 4, 0.8), basic.margins_key(slow, SAFE, 3, 4, 0.8),
        basic.margins_key(CROSSING, SAFE, 4, 4, 0.8),
        basic.margins_key(CROSSING, SAFE, 3, 5, 0.8), basic.margins_key(CROSSING, SAFE, 3, 4, 0.81),
        basic.margins_key(CROSSING, SAFE[::-1], 3, 4, 0.8), basic.margins_key(CROSSING, [moved, *SAFE[1:]], 3, 4, 0.8),
    ]  # fmt: skip
    assert len({key, *others}) == 8
    assert basic.margins_key(replace(CROSSING, name="mine", description="renamed"), SAFE, 3, 4, 0.8) == key


def test_the_yardstick_is_one_for_all_cars():
    fast = replace(CROSSING, control_period=0.05, car=replace(CROSSING.car, dynamics="multi_body"))
    other = Plan(fast, controller="carla", seed=3, safe_count=3, kamikaze_count=4)
    ours, theirs = basic.yardstick(PLAN, 0.8), basic.yardstick(other, 0.8)
    assert theirs.scenario == ours.scenario == CROSSING
    assert (theirs.controller, theirs.multiplier, theirs.car_model) == ("basic", 0.8, "")


def test_where_no_basic_car_is_known_it_is_said():
    curve = load_scenario("right_turn")
    assert not basic.unknown_for(PLAN)
    found, note = basic.equivalent_of(Plan(curve), SAFE, [[1.0]] * 3, Refuses(1), silent)
    assert found is None
    assert "curves" in note
    cyclist = Plan(load_scenario("cyclist"))
    found, note = basic.equivalent_of(cyclist, SAFE, [[1.0]] * 3, Refuses(1), silent)
    assert found is None
    assert "cyclist" in note
    found, note = basic.equivalent_of(PLAN, SAFE, [[math.nan], [], [math.nan]], Refuses(1), silent)
    assert (found, note) == (None, "no trial has a margin")


def test_trials_are_the_first_and_no_more_than_can_be_searched():
    straight = Trajectory(np.array([(-3.5 + 0.75 * tick, 0.0) for tick in range(9)]), 0.3)
    assert basic.trials_of(CROSSING, [straight] * 20, 25) == 25
    assert basic.trials_of(CROSSING, [straight] * 20, 100) == 50
    assert basic.trials_of(CROSSING, [straight] * 3000, 25) == 1
    assert basic.trials_of(CROSSING, [straight, *SAFE], 100) == 50  # of a pace that is none of the adversary's
    assert basic.trials_of(CROSSING, [straight, *SAFE], 4) == 4


GUESSES = st.none() | st.integers(basic.LOWEST, basic.HIGHEST)


@given(st.floats(0.2, 2.1), st.floats(0.0, 0.3), st.floats(0.0, 0.1), GUESSES)
def test_all_that_is_read_off_stands_between_neighbours(truth, reach, narrower, guess):
    """Where the difference falls steadily with C, with an interval of ± `reach` in C."""
    asked: set[int] = set()

    def compared(hundredths: int) -> MarginDifference:
        assert basic.LOWEST <= hundredths <= basic.HIGHEST
        asked.add(hundredths)
        mean = truth - hundredths / 100
        inner = max(0.0, reach - narrower)
        return MarginDifference(mean, (mean - reach, mean + reach), (mean - inner, mean + inner), 10)

    basic.search(compared, guess)
    assert len(asked) <= 40
    for where in (truth, truth - reach, truth + reach):
        if basic.LOWEST / 100 < where < basic.HIGHEST / 100:
            below = max(one for one in asked if one / 100 <= where)
            above = min(one for one in asked if one / 100 >= where)
            assert above - below <= 1, where
