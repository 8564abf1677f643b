"""A policy that answers many episodes at once: the same bits as one by one, and both forms have to be one car."""

import sys
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from skd_evaluator import AssessmentError, Plan, run_episode
from skd_evaluator.assessment.run.episodes import Replay
from skd_evaluator.assessment.run.workers import InProcessRunner
from skd_evaluator.assessment.stages.risk import crude_crossings
from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
from skd_evaluator.margin.search import rounds as searching
from skd_evaluator.margin.search.search import Effort, search_margins
from skd_evaluator.margin.search.trial import prescribed
from skd_evaluator.metrics.behaviour.model import load_behaviour
from skd_evaluator.risk.crossings import AnyCar, CrossingPlan, batched_car
from skd_sim import Mode, Outcome, Trajectory, load_scenario
from skd_sim.options.car_and_adversary import AdversaryModel

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "batches"
SCENARIO = load_scenario("crossing")
OWN = """
import os
import numpy as np
from batch_policies import Anticipating

class Often(Anticipating):
    control_period = 0.1

class Liar(Anticipating):
    def commands(self, cars, adversaries):
        return 1.01 * super().commands(cars, adversaries)
    def command(self, car, adversary):
        return float(Anticipating.commands(self, car, adversary))

class Memory(Anticipating):
    asked = 0
    def command(self, car, adversary):
        self.asked += 1
        return super().command(car, adversary) if self.asked < 6 else -6.0

class Seldom(Anticipating):
    "Does not brake; in batches it does for whom it would hit next, from a second before."
    def command(self, car, adversary):
        return 0.0
    def commands(self, cars, adversaries):
        seconds = (adversaries.y - cars.y - self._front) / np.maximum(cars.speed, 0.5)
        beside = np.abs(adversaries.x + seconds * adversaries.vx - cars.x)
        return -8.0 * ((seconds > 0.3) & (seconds < 1.0) & (beside < 0.2))

class Dies(Anticipating):
    def commands(self, cars, adversaries):
        if np.ndim(cars.x):
            os._exit(3)
        return super().commands(cars, adversaries)
"""


@pytest.fixture(scope="module", autouse=True)
def policies(tmp_path_factory):
    folder = tmp_path_factory.mktemp("policies")
    (folder / "own_policies.py").write_text(OWN)
    sys.path[:0] = [str(EXAMPLES), str(folder)]
    yield
    del sys.path[:2]


@pytest.fixture(scope="module")
def safe():
    return tuple(safe_trajectories(Plan(SCENARIO, safe_count=2, seed=5, simulations=20), InProcessRunner(1)))


def crossing_plan(policy, safe, scenario=SCENARIO):
    plan = Plan(scenario, safe_count=2, seed=5, controller=policy, adversary_model=AdversaryModel.GENERIC)
    return CrossingPlan(plan, safe, load_behaviour("walkers").values)


def crossed(policy, safe, count, workers=1, scenario=SCENARIO):
    here = crossing_plan(policy, safe, scenario)
    crossings = crude_crossings(here, count)
    with InProcessRunner(workers, isolated=True) as runner:
        together = batched_car(here, runner)
        return together.run(crossings, 2.0), AnyCar(here, runner).run(crossings, 2.0)


@pytest.mark.parametrize(("policy", "period"), [("batch_policies:Anticipating", None), ("own_policies:Often", 0.1)])
def test_crossings_side_by_side_are_episodes_to_the_bit(policy, period, safe):
    together, one_by_one = crossed(policy, safe, 120, scenario=replace(SCENARIO, control_period=period))
    np.testing.assert_array_equal(together.touch, one_by_one.touch)
    np.testing.assert_array_equal(together.missed, one_by_one.missed)
    np.testing.assert_array_equal(together.ticks, one_by_one.ticks)
    assert len(set(together.touch.tolist())) > 1


class Remembers:
    """Brakes more at every decision in which somebody is ahead, and keeps what it saw."""

    def reset(self, scenario, rng):
        self.seen, self.rng = [], rng

    def command(self, car, adversary):
        self.seen.append((car, adversary))
        ahead = 0.0 < adversary.y - car.y < 15.0 and adversary.x < 0.5
        return -0.02 * len(self.seen) * self.rng.random() if ahead else 0.5


@pytest.mark.parametrize("period", [None, 0.05])
def test_a_replay_is_the_whole_episode_to_the_bit(period, safe):
    plan = Plan(replace(SCENARIO, control_period=period), safe_count=2, seed=5)
    trial = prescribed(plan.episode(Mode.KAMIKAZE, 0, 3, safe[0]), safe[0].positions)
    replay, controller, outcomes = Replay(trial), Remembers(), set()
    rng = np.random.default_rng(2)
    for steps in np.random.default_rng(1).normal(0.15, 0.1, (30, 60, 2)):
        path = np.cumsum(np.vstack([safe[0].positions[:1], steps[: rng.integers(10, 60)] * [1.5, 0.2]]), axis=0)
        episode = replace(trial, safe_trajectory=Trajectory(path, SCENARIO.time_step))
        fast, seen = replay.run(episode, controller), controller.seen
        whole = run_episode(episode, controller)
        assert seen == controller.seen
        np.testing.assert_array_equal(fast.adversary, whole.adversary)
        np.testing.assert_array_equal(fast.car, whole.car)
        assert repr((fast.outcome, fast.impact_time, fast.impact_speed)) == repr(
            (whole.outcome, whole.impact_time, whole.impact_speed)
        )
        outcomes.add(fast.outcome)
    assert outcomes == {Outcome.COLLISION, Outcome.ARRIVED, Outcome.TIMEOUT}
    controller.command = Mock(side_effect=[0.0, 0.0, AssessmentError("it failed")])
    with pytest.raises(AssessmentError, match=f"; in a margin run: φ 0, trial 3, t = {2 * (period or 0.3):.2f} s"):
        replay.run(trial, controller)


@pytest.mark.parametrize(("policy", "count"), [("Liar", 20), ("Memory", 20), ("Seldom", 120)])
def test_two_forms_that_differ_are_said(policy, count, safe):
    """Of what decides, too: who saw which of 20 crossings command was asked in braked in the other 19."""
    with pytest.raises(AssessmentError, match=r"commands answers .* where command answers .*; in a risk run: φ"):
        crossed(f"own_policies:{policy}", safe, count)


def test_a_policy_whose_process_dies_of_commands_has_no_figure(safe):
    """Its crossings are run one by one, as those of any car; that it has died is no crossing without a hit."""
    together, one_by_one = crossed("own_policies:Dies", safe, 12)
    np.testing.assert_array_equal(together.touch, one_by_one.touch)


def margins(policy, safe, *, together):
    plan = crossing_plan(policy, safe).plan
    episodes = [plan.episode(Mode.KAMIKAZE, k % 2, k // 2, safe[k % 2]) for k in range(5)]
    with InProcessRunner(1, isolated=True) as runner, pytest.MonkeyPatch.context() as patch:
        if not together:
            patch.setattr(searching, "takes_batches", lambda _controller: False)
        rounds = searching.in_processes(runner, lambda *_: None)
        return search_margins(episodes, {}, rounds, Effort(16, 32)).hits


def test_margins_side_by_side_are_those_one_by_one_to_the_bit(safe):
    both = [margins("batch_policies:Anticipating", safe, together=one) for one in (False, True)]
    for single, side_by_side in zip(*both, strict=True):
        assert (single is None) == (side_by_side is None)
        if single is not None and side_by_side is not None:
            np.testing.assert_array_equal(single.trajectory.positions, side_by_side.trajectory.positions)
    assert any(one is not None for one in both[1])
