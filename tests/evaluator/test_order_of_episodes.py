"""Episodes of a user's car run in an order that tells nothing of them, and come to the figures as in any other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from skd_evaluator.campaign.plan.plan import Plan, ShuffledRunner, collision_runs, first_episodes, kamikaze_sets
from skd_sim.choices.objective import Objective
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, Mode, Outcome
from test_campaign import StubRunner, attempt, straight

PLAN = Plan(load_scenario("crossing"), controller="cars:Mine", safe_count=2, kamikaze_count=6, collision_runs=30)
PLANS = [replace(PLAN, objective=objective) for objective in (Objective.DEFORMATION, Objective.PAPER)]
SAFE = [straight(), straight(1.0)]


def outcome(episode: Episode) -> Outcome:
    """Some attempts miss, so that more are asked for than the first."""
    if episode.mode == Mode.REPLAY:
        return Outcome.ARRIVED
    return Outcome.MISSED if attempt(episode) % 5 == 0 else Outcome.COLLISION


def results(runner) -> list[list[tuple[Outcome, int, str]]]:
    groups = [group.in_order for plan in PLANS for group in kamikaze_sets(plan, SAFE, runner)]
    groups.append(collision_runs(PLANS[0], SAFE, runner))
    return [[(log.outcome, log.episode.episode_id, str(log.episode.objective)) for log in group] for group in groups]


def test_the_order_tells_nothing_and_changes_nothing() -> None:
    plain, lots = StubRunner(outcome), StubRunner(outcome)
    expected = results(plain)
    assert results(ShuffledRunner(lots, first_episodes(PLANS, SAFE), PLAN.seed)) == expected
    assert sum(map(len, lots.batches)) == sum(map(len, plain.batches))
    assert [len(batch) for batch in lots.batches] == [54, 4, 4]
    kamikazes = np.array([one.mode == Mode.KAMIKAZE for one in lots.batches[0]])
    assert kamikazes.sum() == 24
    # Runs of one kind are those of lots: of 24 among 30, 27.7 are expected with a standard deviation of 3.6.
    assert 17 <= 1 + np.count_nonzero(np.diff(kamikazes.astype(int))) <= 39


def test_each_campaign_has_its_own_order_and_keeps_it() -> None:
    orders = []
    for seed in (0, 0, 1):
        runner = StubRunner(outcome)
        list(ShuffledRunner(runner, first_episodes(PLANS, SAFE), seed).run([]))
        orders.append([(one.objective, one.episode_id) for one in runner.batches[0]])
    assert orders[0] == orders[1] != orders[2]
