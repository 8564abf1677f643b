"""Which episodes are run again, when two runs are the same, and when the first ones flatter a car."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest
from skd_evaluator.assessing.otherwise import (
    first_run_flatters,
    flattered,
    further_of,
    hid_hits,
    is_same,
    lost_of,
    named,
    one_run_stands_apart,
    some_of,
    surely_more,
    way_apart,
    went_otherwise,
)
from skd_evaluator.campaign.plan.plan import Plan, Stage, episode_id, safe_trajectories
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.measure.doubt import DISBELIEF, DOUBT
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.aborts import AbortKind, abort_reason
from skd_sim.episode.episode import EpisodeLog, Mode, Outcome

PLAN = Plan(load_scenario("crossing"), safe_count=1, simulations=5)
PHI = safe_trajectories(PLAN, InProcessRunner(1))[0]
ENDS = (Outcome.MISSED, Outcome.COLLISION)


def log_of(mode: Mode = Mode.REPLAY, stage: Stage | None = None, outcome: Outcome = Outcome.ARRIVED) -> EpisodeLog:
    """A run along φ, with another number than it would have where a stage is given."""
    episode = PLAN.episode(mode, 0, 7, PHI)
    if stage is not None:
        episode = replace(episode, episode_id=episode_id(stage, 0, 7))
    return EpisodeLog(episode, outcome, np.zeros((5, 2)), np.ones((5, 3)), 0.5, 1.0)


def test_the_sign_test_is_that_of_scipy() -> None:
    for many in range(25):
        for few in range(25):
            sure = many > few and binomtest(many, many + few, alternative="greater").pvalue < 0.05
            assert surely_more(many, few) == sure


def test_how_many_are_run_again() -> None:
    logs = [log_of() for _ in range(2000)]
    for count, some, further in ((5, 5, 0), (20, 12, 8), (100, 12, 12), (400, 12, 20), (2000, 12, 48)):
        first = some_of(logs[:count])
        second = further_of(logs[:count], first)
        assert (len(first), len(second)) == (some, further)
        assert len({*map(id, first), *map(id, second)}) == some + further
    aborted = [replace(logs[0], outcome=Outcome.ABORTED) for _ in range(30)]
    assert some_of(aborted) == further_of(aborted, []) == []


def test_only_aborted_episodes_whose_process_ended_are_run_again() -> None:
    ended = abort_reason(AbortKind.ENDED, "it died")
    aborted = replace(log_of(), outcome=Outcome.ABORTED, reason=ended)
    silent = replace(aborted, reason=abort_reason(AbortKind.NO_ANSWER, "for 60 s"))
    assert lost_of([log_of(), aborted, silent]) == [aborted]
    assert len(lost_of([aborted] * 30)) == 8


def test_aborted_episodes_hid_hits_where_they_collide_more_often_than_others() -> None:
    """A crash by chance hits as many of those that collide as of others; one that aborts again tells nothing."""

    def hid(again: str, others: str, mode: Mode = Mode.REPLAY) -> tuple[str, ...]:
        ends = {"h": Outcome.COLLISION, ".": Outcome.ARRIVED, "a": Outcome.ABORTED}
        lost = replace(log_of(mode), outcome=Outcome.ABORTED)
        pairs = [(lost, replace(lost, outcome=ends[letter])) for letter in again]
        crossings = [log_of(stage=Stage.RISK, outcome=Outcome.COLLISION)] * 50
        logs = [lost, *(log_of(mode, outcome=ends[letter]) for letter in others), *crossings]
        return hid_hits("my:Car", pairs, logs)

    assert hid("aaaa", "." * 90) == hid("....", "." * 90) == hid("", "h." * 50) == ()
    (line,) = hid("aha.", "." * 90)  # 2 of 92 by Laplace's rule: (1 − 91/92 ** 2) = 0.02
    assert line.startswith(f"{DISBELIEF}1 of 2 aborted episodes (runs along φ) collided when they were run again in a")
    assert "and of others 0 of 90 had: my:Car" in line
    assert hid("h.", "h" * 10 + "." * 80) == ()  # binomtest(1, 2, 11/92, alternative="greater").pvalue is 0.22
    assert hid("hhh", "h" * 10 + "." * 80)  # and of 3 of 3 it is 0.002
    assert hid("hhhh", "h" * 90 + "." * 20, Mode.KAMIKAZE) == ()  # as most kamikazes do


def test_of_three_runs_by_chance_none_stands_apart_more_often_than_the_others() -> None:
    run, crossing = log_of(), log_of(stage=Stage.RISK)

    def runs(*patterns: str, log: EpisodeLog = run) -> list[tuple[EpisodeLog, ...]]:
        return [tuple(replace(log, car=log.car + 9.0 * (letter == "C")) for letter in one) for one in patterns]

    def stands_apart(rows: Sequence[tuple[EpisodeLog, ...]]) -> bool:
        return one_run_stands_apart(list(zip(*rows, strict=True)))

    even = runs(*["Ccc", "cCc", "ccC"] * 8)
    assert not stands_apart(even)
    assert not stands_apart(runs("ccc", "ccc"))
    assert not stands_apart(runs(*["Ccc"] * 4))  # too few
    for pattern in ("Ccc", "cCc", "ccC"):
        assert stands_apart(runs(*[pattern] * 8))
        assert stands_apart([*even, *runs(*[pattern] * 6, log=crossing)])
    # Along φ the second one stands apart and in crossings the third one: of all neither.
    assert stands_apart([*runs(*["cCc"] * 8), *runs(*["CCc"] * 8, log=crossing)])
    gone = [(one, two, replace(three, outcome=Outcome.ABORTED)) for one, two, three in runs(*["Ccc"] * 8)]
    assert not stands_apart(gone)


def test_first_runs_flatter_by_two_runs_again() -> None:
    run, crossing = log_of(), log_of(stage=Stage.RISK)

    def runs(*patterns: str, log: EpisodeLog = run) -> list[tuple[EpisodeLog, ...]]:
        ends = {"H": Outcome.COLLISION, ".": Outcome.MISSED}
        return [tuple(replace(log, outcome=ends[letter]) for letter in one) for one in patterns]

    def flatters(rows: Sequence[tuple[EpisodeLog, ...]]) -> str:
        return first_run_flatters(list(zip(*rows, strict=True)))

    even = runs(*["H..", ".H.", "..H", ".HH", "H.H", "HH."] * 5)
    assert not flatters(even)
    assert not flatters(runs("...", "HHH"))
    assert not flatters(runs(*[".H."] * 9))  # 0.026: one of two may be chance
    assert not flatters(runs(*["H.."] * 20))
    assert flatters(runs(*[".HH"] * 4)).startswith("4 episodes of 4 collided when they were run again")  # 0.012
    # Neither run again alone has surely more collisions, by a sign test of each figure: 5 of 5, twice.
    crossings = [*even, *runs(*[".H.", "..H"] * 5, *[".HH"] * 2, log=crossing)]
    assert flatters(crossings).startswith("12 crossings of the risk of 12 collided")
    line = went_otherwise("external", [(run, run)], 60, "graph", flatters(crossings))
    assert line.startswith(DISBELIEF)
    assert (
        "crossings of the risk of 12 collided when they were run again, once or twice, and not before; 0 before" in line
    )


@pytest.mark.parametrize("share", [0.1, 0.5, 0.7])
def test_who_goes_by_chance_is_seldom_taken_for_another(share: float) -> None:
    rng, found = np.random.default_rng(3), [0, 0]
    log, crossing = log_of(), log_of(stage=Stage.RISK)
    for _ in range(400):
        slow = rng.random((2, 24, 3)) < share
        rows = [
            tuple(
                replace(one, car=one.car + 9.0 * c, outcome=Outcome.MISSED if c else Outcome.COLLISION) for c in three
            )
            for one, kind in zip((log, crossing), slow, strict=True)
            for three in kind
        ]
        runs = list(zip(*rows, strict=True))
        found[0] += bool(first_run_flatters(runs))
        found[1] += one_run_stands_apart(runs)
    assert max(found) <= 0.06 * 400


@pytest.mark.parametrize("outcomes", [(Outcome.ARRIVED, Outcome.COLLISION), (Outcome.COLLISION, Outcome.ARRIVED)])
def test_another_end_or_way_is_no_same_run(outcomes: tuple[Outcome, Outcome]) -> None:
    first, second = (log_of(outcome=one) for one in outcomes)
    assert not is_same(first, second)
    assert is_same(first, replace(first, car=first.car + 1e-7))
    assert not is_same(first, replace(first, car=first.car + 1e-5))
    assert not is_same(first, replace(first, adversary=first.adversary + 1e-5))
    assert not is_same(first, replace(first, adversary=first.adversary[:-1], car=first.car[:-1]))


def test_a_crossing_of_the_risk_may_differ_by_what_commands_may_answer_otherwise() -> None:
    crossing = log_of(stage=Stage.RISK)
    assert is_same(crossing, replace(crossing, car=crossing.car[:-1] + 0.02))
    assert not is_same(crossing, replace(crossing, car=crossing.car + 0.1))


def test_an_episode_is_called_what_it_is() -> None:
    assert named(log_of()).startswith("a run along φ, episode 5629")
    assert named(log_of(Mode.KAMIKAZE)).startswith("a kamikaze, episode 2814")
    for stage, name in (
        (Stage.KAMIKAZE, "a way of the margin's search"),
        (Stage.RISK, "a crossing of the risk"),
        (Stage.SAFE, "a static test"),
        (Stage.PROBE, "a probe"),
        (Stage.LEARNING, "a kamikaze from which the adversary learned"),
    ):
        assert named(log_of(stage=stage)).startswith(f"{name}, episode ")


def collided(first: bool, second: bool, stage: Stage | None = None) -> tuple[EpisodeLog, EpisodeLog]:
    """Two runs, and whether they collided."""
    ends = [Outcome.COLLISION if one else Outcome.ARRIVED for one in (first, second)]
    return log_of(stage=stage, outcome=ends[0]), log_of(stage=stage, outcome=ends[1])


def test_collisions_that_come_for_sure_are_more_than_a_doubt() -> None:
    """Five of five come by chance once in 32 times, four of four once in 16."""
    for count, begin in ((4, DOUBT), (5, DISBELIEF)):
        line = went_otherwise("a.b:C", [collided(False, True)] * count, 12)
        assert line.startswith(f"{begin}{count} of 12 episodes went otherwise")
        assert f"; {count} of them collided then alone, 0 before alone): a.b:C answers" in line
        assert went_otherwise("a.b:C", [collided(True, False)] * count, 12).startswith(DOUBT)


def test_it_is_asked_of_the_episodes_of_each_figure_too() -> None:
    """With two kinds each may be so by chance half as often."""
    away = [collided(True, False)] * 6
    for count, sure in ((5, False), (6, True)):
        ways = [collided(False, True, Stage.RISK)] * count
        assert list(flattered([*away, *ways])) == (ways if sure else [])
    line = went_otherwise("a.b:C", [*away, *ways], 30)
    assert "; 6 of them collided then alone, 6 before alone, and of crossings of the risk 6 and 0): " in line
    assert line.startswith(DISBELIEF)


def test_how_far_two_ways_are_apart() -> None:
    first = log_of()
    assert way_apart(first, replace(first, car=first.car[:3] - 0.25)) == 0.25
    assert way_apart(first, replace(first, car=np.zeros((0, 3)))) == 0.0


def test_only_in_process_figures_depend_on_the_workers() -> None:
    pair = (log_of(), replace(log_of(), car=np.zeros((5, 3))))
    assert went_otherwise("a.b:C", [pair], 12).endswith("the order of the episodes and on --workers")
    assert went_otherwise("external", [pair], 12, "graph").endswith("its figures depend on the order of the episodes")
