"""Stacks whose episodes are run again: honest ones, some that keep something, go by chance, or fail."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace
from typing import TypeAlias

import numpy as np
import pytest
from skd_evaluator.assessing import again_graph
from skd_evaluator.assessing.again_graph import TimedRunner, doubts_of_the_stack
from skd_evaluator.campaign.plan.plan import EpisodeRunner, Plan, safe_trajectories
from skd_evaluator.campaign.run.assembly import aborted
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.episode_tree import walked
from skd_evaluator.measure.doubt import DISBELIEF, DOUBT
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.state import AdversaryState, CarState
from test_stack_in_doubt import Graph

Answer: TypeAlias = "Callable[[Stack, CarState, AdversaryState], float]"
_SEEDS = itertools.count()  # no two stacks draw the same
pytestmark = pytest.mark.usefixtures("lots")
CROSSING = load_scenario("crossing")
PLAN = Plan(CROSSING, safe_count=2, controller="external", simulations=5, seed=3)
PHI = safe_trajectories(Plan(CROSSING, safe_count=2, seed=3), InProcessRunner(1))


class Stack:
    """Drives by what it has kept since it was started: it counts episodes, and draws from a generator of its own."""

    def __init__(self, answer: Answer) -> None:
        self._answer = answer
        self.episodes, self.rng = 0, np.random.default_rng(next(_SEEDS))

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self.episodes += 1

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        return self._answer(self, car, adversary)


def careful(car: CarState, adversary: AdversaryState) -> float:
    """Brake for whoever is ahead."""
    return -8.0 if 0.0 <= adversary.y - car.y <= 20.0 else 0.0


def episodes_of() -> list[list[Episode]]:
    """Kamikazes and runs along φ, and ways that a search for the margin tried."""
    rated = [
        PLAN.episode(mode, one, number, phi)
        for mode in (Mode.KAMIKAZE, Mode.REPLAY)
        for number in range(8)
        for one, phi in enumerate(PHI)
    ]
    ways = [
        walked(PLAN.episode(Mode.KAMIKAZE, 0, number, PHI[0]), [(1.0, 0.02 * number)] * 20) for number in range(100)
    ]
    return [rated, ways]


def graph_of(answer: Answer, *, anew: bool = True) -> Graph:
    """Return graphs with a stack that answers so."""
    return Graph(lambda: Stack(answer), anew=anew)


def doubts(graph: Graph, *, anew: bool = True) -> tuple[str, ...]:
    """Run everything in a first graph, and say what is found when some of it is run again."""
    groups = [list(graph.run(group)) for group in episodes_of()]
    return doubts_of_the_stack("external", groups, graph, lambda *_told: None, anew=anew, limit=60.0)


def test_an_honest_stack_goes_as_before() -> None:
    graph = graph_of(lambda _stack, car, adversary: careful(car, adversary))
    assert doubts(graph) == ()
    assert graph.graphs == 1
    first, ways, again = graph.ran
    assert 40 <= len(again) < len(first) + len(ways)
    numbers = [(one.episode_id, one.safe_trajectory) for one in again]
    assert len({(number, id(way)) for number, way in numbers}) == len(numbers)
    assert sum(one.mode == Mode.KAMIKAZE for one in again) <= 12  # in others somebody is led where they had gone


@pytest.mark.parametrize("anew", [True, False])
def test_one_that_is_careful_later_is_not_believed(anew: bool) -> None:
    """Hardly anybody is hit on the ways of its search."""

    def later(stack: Stack, car: CarState, adversary: AdversaryState) -> float:
        return careful(car, adversary) if 60 < stack.episodes <= 132 else 0.0

    (line,) = doubts(graph_of(later, anew=anew), anew=anew)
    assert line.startswith(DISBELIEF)
    assert "as by what it keeps from one episode to the next" in line
    assert ("in a new graph and in another order" in line) == anew


def test_one_that_keeps_something_without_effect_on_hits_is_in_doubt() -> None:
    def odd(stack: Stack, car: CarState, adversary: AdversaryState) -> float:
        return -0.1 if stack.episodes % 2 else 0.0

    graph = graph_of(odd)
    (line,) = doubts(graph)
    assert line.startswith(DOUBT)
    assert graph.graphs == 2
    assert [one.episode_id for one in graph.ran[2]] == [one.episode_id for one in graph.ran[3]]  # the same again


def test_one_that_never_goes_the_same_way_twice_is_told_and_no_more() -> None:
    (line,) = doubts(graph_of(lambda stack, car, _adversary: float(stack.rng.normal(0.0, 0.1))))
    assert not line.startswith((DISBELIEF, DOUBT))
    assert "does not go the same way twice" in line


def test_one_that_fails_when_it_is_run_again_is_in_doubt() -> None:
    class Dying(Graph):
        def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
            alive = super().run(episodes)
            return (aborted(one, "no answer: it is gone") for one in episodes) if self.graphs else alive

    (line,) = doubts(Dying(lambda: Stack(lambda _stack, car, adversary: careful(car, adversary))))
    assert line.startswith(DOUBT)
    assert line.endswith("were aborted, the first one so: no answer: it is gone")


def test_a_graph_that_cannot_go_on_is_told() -> None:
    graph = graph_of(lambda *_seen: 0.0)
    groups = [list(graph.run(group)) for group in episodes_of()]

    @contextmanager
    def broken() -> Iterator[EpisodeRunner]:
        raise AssessmentError("3 starts in a row failed")
        yield graph

    (line,) = doubts_of_the_stack("external", groups, broken, lambda *_told: None, anew=True, limit=60.0)
    assert line.startswith(DOUBT)
    assert "3 starts in a row failed" in line


def test_what_was_aborted_is_not_run_again() -> None:
    logs = [aborted(episode, "no answer") for episode in episodes_of()[0]]
    assert all(log.outcome == Outcome.ABORTED for log in logs)

    @contextmanager
    def unwanted() -> Iterator[EpisodeRunner]:
        raise AssertionError("there is nothing to run")
        yield

    assert doubts_of_the_stack("external", [logs], unwanted, lambda *_told: None, anew=True, limit=60.0) == ()


# --- how long it takes


class Clock:
    """Stands in for the clock; whoever runs takes so long for each episode."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
        self.now, self._seconds = 100.0, seconds
        monkeypatch.setattr(again_graph, "time", SimpleNamespace(perf_counter=lambda: self.now))

    def run(self, logs: Sequence[EpisodeLog]) -> Iterator[EpisodeLog]:
        for log in logs:
            self.now += self._seconds
            yield log

    @contextmanager
    def graph(self, logs: Sequence[EpisodeLog]) -> Iterator[EpisodeRunner]:
        yield SimpleNamespace(run=lambda _episodes: self.run(logs))


@pytest.mark.parametrize(
    ("seconds", "asked", "limit"),
    [(2.0, 3, 60.0), (2.0, 2, 60.0), (2.0, 4, 600.0), (40.0, 3, 240.0), (200.0, 4, 1200.0)],
)
def test_how_long_it_may_take_goes_by_how_long_it_took(monkeypatch, seconds: float, asked: int, limit: float):
    """Twice as long as all of them, a minute at the least; of some that nobody has seen running, ten minutes."""
    clock = Clock(monkeypatch, seconds)
    timed = TimedRunner(SimpleNamespace(run=clock.run))
    for _ in timed.run(["one", "two", "three"]):
        clock.now += 1000.0  # of whoever asked for them
    assert (timed.count, timed.seconds) == (3, 3 * seconds)
    assert timed.limit(asked) == limit


@pytest.mark.parametrize(
    ("seconds", "outcome", "limit", "said"),
    [
        (25.0, Outcome.ABORTED, 1000.0, "silent: nobody answers"),  # more than a minute of them
        (25.0, Outcome.MISSED, 60.0, "after 75 s only 3 were over"),
        (20.0, Outcome.MISSED, 60.0, "after 80 s only 4 were over"),
        (1.0, Outcome.MISSED, 60.0, ""),
    ],
)
def test_who_takes_too_long_is_in_doubt(monkeypatch, seconds: float, outcome: Outcome, limit: float, said: str):
    logs = list(graph_of(lambda *_seen: 0.0).run([PLAN.episode(Mode.REPLAY, 0, 0, PHI[0])])) * 12
    clock = Clock(monkeypatch, seconds)
    again = [replace(log, outcome=outcome, reason="silent: nobody answers") for log in logs]
    first = [replace(log, outcome=Outcome.MISSED) for log in logs]
    lines = doubts_of_the_stack("x", [first], lambda: clock.graph(again), lambda *_: None, anew=True, limit=limit)
    assert len(lines) == bool(said)
    for line in lines:
        assert line.startswith(f"{DOUBT}when 12 episodes were run again")
        assert said in line
    if outcome == Outcome.ABORTED:
        assert clock.now == 175.0
