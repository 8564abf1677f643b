"""Episodes of a stack that are run again through a graph: whether it keeps something, or never goes the same twice."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from skd_evaluator.assessing import again_graph, pipeline
from skd_evaluator.assessing.again import DoubtsOfLearning
from skd_evaluator.assessing.again_graph import TimedRunner, doubts_of_the_stack
from skd_evaluator.assessing.graph_options import GraphOptions
from skd_evaluator.assessing.otherwise import flattered, went_otherwise
from skd_evaluator.assessing.pipeline import keep_or_forget
from skd_evaluator.campaign.plan.plan import Plan, Stage, episode_id, safe_trajectories
from skd_evaluator.campaign.run.assembly import aborted
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.workers import InProcessRunner
from skd_evaluator.learning.kept_models import forget_model
from skd_evaluator.measure.doubt import DISBELIEF, DOUBT
from skd_evaluator.ros.rated import RunAgain
from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.graph_options import LOCKSTEP, REAL_TIME
from skd_sim.choices.simulators import WORLD
from skd_sim.controllers import Controller
from skd_sim.encounter.scenario import Scenario, load_scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.errors import UsageError
from skd_sim.state import AdversaryState, CarState

CROSSING = load_scenario("crossing")
PLAN = Plan(CROSSING, safe_count=2, controller="external", simulations=10)
pytestmark = pytest.mark.usefixtures("lots")
PHI = safe_trajectories(Plan(CROSSING, safe_count=2), InProcessRunner(1))
RUNS = [PLAN.episode(Mode.REPLAY, number % 2, number // 2, PHI[number % 2]) for number in range(24)]


class Car:
    """Slows down in some of its episodes, counted from 0, with some noise."""

    def __init__(self, when: Callable[[int], bool] = lambda _number: False, noise: float = 0.0) -> None:
        self._when, self._noise, self.number = when, noise, -1
        self._rng = np.random.default_rng(7)

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self.number += 1
        self._slows = self._when(self.number)

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        return self._noise * self._rng.normal() - (4.0 if self._slows and car.speed > 3.0 else 0.0)


class Graph:
    """Runs episodes of a car, which is another object in each graph unless it was started by hand.

    Attributes:
        graphs: how many have been begun after the first.
        ran: all episodes that were given, each time.
    """

    def __init__(self, make: Callable[[], Controller], *, anew: bool = True) -> None:
        self._make, self._anew, self.car = make, anew, make()
        self.graphs = 0
        self.ran: list[Sequence[Episode]] = []

    def __call__(self) -> AbstractContextManager[Graph]:
        self.graphs += 1
        if self._anew:
            self.car = self._make()
        return nullcontext(self)

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        self.ran.append(episodes)
        for one in episodes:
            yield run_episode(one, self.car)


def doubts(graph: Graph, episodes: Sequence[Episode] = RUNS, **options: bool) -> tuple[str, ...]:
    logs = list(graph.run(episodes))
    return doubts_of_the_stack("external", [logs], graph, lambda *_told: None, limit=60.0, **{"anew": True, **options})


def test_a_stack_that_goes_as_before_is_run_again_once() -> None:
    graph = Graph(Car)
    assert doubts(graph) == ()
    assert graph.graphs == 1


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_little_noise_does_not_hide_that_a_stack_keeps_something(noise: float) -> None:
    (line,) = doubts(Graph(lambda: Car(lambda number: number % 2 == 1, noise)))
    assert line.startswith(DOUBT)
    assert "keeps from one episode to the next" in line


def test_a_stack_that_never_goes_the_same_way_twice_is_told_from_one_that_keeps_something() -> None:
    lots = np.random.default_rng(3)
    graph = Graph(lambda: Car(lambda _number: bool(lots.random() < 0.5)))
    (line,) = doubts(graph)
    assert not line.startswith((DISBELIEF, DOUBT))
    assert "does not go the same way twice" in line
    assert doubts(graph, repeats=False) == ()  # as every stack in real time


def test_a_stack_that_was_started_by_hand_is_in_doubt_if_it_is_another_one_by_and_by() -> None:
    graph = Graph(lambda: Car(lambda number: number >= 8), anew=False)
    (line,) = doubts(graph, anew=False)
    assert line.startswith(DOUBT)


def test_in_real_time_a_few_differences_are_no_doubt() -> None:
    graph = Graph(lambda: Car(lambda number: number == 0))
    assert doubts(graph, repeats=False) == ()
    (line,) = doubts(Graph(lambda: Car(lambda number: number % 2 == 1)), repeats=False)
    assert line.startswith(DOUBT)


def test_a_kamikaze_from_which_the_adversary_learned_is_run_again_as_it_was() -> None:
    number = episode_id(Stage.LEARNING, 0, 1)
    learning = replace(PLAN.episode(Mode.KAMIKAZE, 0, 1, PHI[0]), episode_id=number)
    rated = PLAN.episode(Mode.KAMIKAZE, 0, 1, PHI[0])
    logs = [run_episode(one, Car()) for one in (learning, rated)]
    assert [again_graph._led(log).mode for log in logs] == [Mode.KAMIKAZE, Mode.REPLAY]
    (line,) = doubts(Graph(lambda: Car(lambda _number: True, 0.0)), [learning]) or ("",)
    assert not line


def test_a_stack_that_is_silent_when_it_is_run_again_does_not_keep_anybody_waiting(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Silent(Graph):
        def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
            for one in episodes:
                if self.graphs:
                    time.sleep(0.02)
                yield aborted(one, "silent") if self.graphs else run_episode(one, self.car)

    monkeypatch.setattr(again_graph, "_LOST", 0.05)
    (line,) = doubts(Silent(Car))
    assert line.startswith(DOUBT)
    assert line.endswith("this came of it: silent")


def test_a_stack_that_is_slow_when_it_is_run_again_does_not_keep_anybody_waiting() -> None:
    class Slow(Graph):
        def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
            for one in episodes:
                time.sleep(0.03 * self.graphs)
                yield run_episode(one, self.car)

    graph = Slow(Car)
    logs = list(graph.run(RUNS))
    (line,) = doubts_of_the_stack("external", [logs], graph, lambda *_told: None, anew=True, limit=0.1)
    assert line.startswith(DOUBT)
    assert "were over" in line


class Aborting(Graph):
    """Ends one of so many episodes that are run again, by a fault of its own."""

    def __init__(self, one_in: int, make: Callable[[], Controller] = Car) -> None:
        super().__init__(make)
        self._one_in = one_in

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        for number, log in enumerate(super().run(episodes)):
            yield aborted(log.episode, "twice") if self.graphs and number % self._one_in == 0 else log


def test_a_stack_that_ends_many_of_the_episodes_that_are_run_again_is_in_doubt() -> None:
    """It could end just those in which it had been another car: of these nobody sees how they go."""
    (line,) = doubts(Aborting(3))
    assert line.startswith(DOUBT)
    assert line.endswith("8 of 24 kamikazes and runs along φ were aborted, the first one so: twice")
    assert doubts(Aborting(6)) == ()  # as where a machine has too much to do
    lines = doubts(Aborting(3, lambda: Car(lambda number: number % 2 == 1)))
    assert [line.startswith(DOUBT) for line in lines] == [True, True]
    assert "keeps from one episode to the next" in lines[1]


def test_episodes_of_one_figure_may_not_all_be_ended_among_many_others() -> None:
    crossings = [replace(one, episode_id=episode_id(Stage.RISK, 0, number)) for number, one in enumerate(RUNS[:6])]

    class OfRisk(Graph):
        def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
            for log in super().run(episodes):
                yield aborted(log.episode, "twice") if self.graphs and log.episode in crossings else log

    (line,) = doubts(OfRisk(Car), [*RUNS, *crossings])
    assert line.startswith(DOUBT)
    assert "crossings of the risk were aborted, the first one so: twice" in line


@pytest.mark.parametrize("error", [UsageError("no such command"), FileNotFoundError(2, "no such file", "logs")])
def test_a_graph_that_cannot_be_started_again_costs_no_result(error: Exception) -> None:
    """As where a stack has removed its own command, or the folder of logs."""

    class Gone(Graph):
        def __call__(self) -> AbstractContextManager[Graph]:
            raise error

    (line,) = doubts(Gone(Car))
    assert line.startswith(DOUBT)
    assert line.endswith(str(error))


def test_a_stack_that_is_another_car_in_one_graph_than_in_two_others_does_not_go_by_chance() -> None:
    graph = Graph(lambda: Car(lambda _number: graph.graphs == 1))
    (line,) = doubts(graph)
    assert line.startswith(DOUBT)
    assert "keeps from one episode to the next" in line


def test_who_took_long_at_first_may_take_as_long_again() -> None:
    timed = TimedRunner(Graph(Car))
    assert len(list(timed.run(RUNS[:3]))) == timed.count == 3
    assert timed.seconds > 0.0
    assert timed.limit(3) == again_graph._SHORT
    assert timed.limit(4) == again_graph._LONG  # one has been run before
    timed.seconds = 1000.0
    assert timed.limit(3) == 2000.0


@pytest.mark.parametrize(
    ("controller", "command", "pacing", "here", "anew"),
    [
        ("external", None, LOCKSTEP, True, False),
        ("external", "run it", LOCKSTEP, False, True),
        ("external", "run it", REAL_TIME, False, True),
        ("a.b:C", None, LOCKSTEP, False, False),  # which a process repeats
        ("a.b:C", None, REAL_TIME, False, True),
        ("basic", None, REAL_TIME, False, False),
    ],
)
def test_who_is_run_again_through_a_graph(
    controller: str, command: str | None, pacing: str, here: bool, anew: bool, tmp_path: Path
) -> None:
    options = replace(GraphOptions(), controller_command=command, pacing=pacing)
    found = RunAgain(CarUnderTest(controller), WORLD, options, tmp_path)
    assert (found.here, found.anew) == (here, anew)


def test_a_model_of_a_car_in_doubt_is_forgotten_as_a_whole(tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "car_model.yaml").write_text("a: 1\n")
    forget_model(kept)
    assert list(tmp_path.iterdir()) == []
    forget_model(kept)  # which somebody else has removed
    assert list(tmp_path.iterdir()) == []


def test_more_collisions_along_phi_do_not_make_up_for_fewer_crossings_that_hit() -> None:
    (along,) = [log for log in [run_episode(RUNS[0], Car())] if log.outcome == Outcome.COLLISION]
    crossing = replace(along, episode=replace(along.episode, episode_id=episode_id(Stage.RISK, 0, 1)))
    pairs = [(along, replace(along, outcome=Outcome.MISSED))] * 8
    risk = [(replace(crossing, outcome=Outcome.MISSED), crossing)] * 7
    assert list(flattered([*pairs, *risk])) == risk
    assert not flattered([*pairs, *risk[:3]])  # which may be chance
    line = went_otherwise("external", [*pairs, *risk], 60, "graph")
    assert line.startswith(DISBELIEF)
    assert "7 of them collided then alone, 8 before alone, and of crossings of the risk 7 and 0" in line


def test_one_of_two_runs_that_collides_more_often_may_be_chance() -> None:
    """As by a stack that never goes the same way twice."""

    class Drawn(Graph):
        def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
            for number, log in enumerate(super().run(episodes)):
                car = log.car + 0.1 * np.sin(number * (1 + self.graphs))[..., None]
                outcome = Outcome.MISSED if number < 8 and self.graphs != self.collides else Outcome.COLLISION
                yield replace(log, car=car, outcome=outcome)

        collides = 1

    (line,) = doubts(Drawn(Car))
    assert not line.startswith((DISBELIEF, DOUBT))

    class Flattered(Drawn):
        @property
        def collides(self) -> int:  # type: ignore[override]
            return max(1, self.graphs)  # in each of the graphs but the first

    (line,) = doubts(Flattered(Car))
    assert line.startswith(DISBELIEF)


def test_no_model_of_a_stack_is_kept_before_it_was_run_again() -> None:
    """Or one that is ended meanwhile would leave a model of a car at which nobody has looked."""
    kept, said = list[bool](), list[str]()

    def keep() -> bool:
        kept.append(True)
        return True

    learning = DoubtsOfLearning(CarUnderTest("external"), None, later=True)
    assert not learning.believed([], keep)
    keep_or_forget(PLAN, [f"{DOUBT}it counts"], said.append, GraphOptions(), learning.keep_now)
    assert not kept
    keep_or_forget(PLAN, ["harmless"], said.append, GraphOptions(), learning.keep_now)
    assert kept
    assert said == ["the model of the car is kept, for the car always went as before"]
    at_once = DoubtsOfLearning(CarUnderTest("external"), None)
    assert at_once.believed([], keep)
    assert not at_once.keep_now()


def test_no_model_is_kept_of_a_car_whose_figures_are_in_doubt(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept, said = tmp_path / "kept", list[str]()
    kept.mkdir()
    monkeypatch.setattr(pipeline, "folder_of", lambda *_how: kept)
    keep_or_forget(PLAN, ["harmless"], said.append, GraphOptions())
    assert kept.is_dir()
    keep_or_forget(PLAN, [f"{DOUBT}it counts"], said.append, GraphOptions())
    assert not kept.exists()
    assert said == ["no model of the car is kept, for its figures are in doubt"]
    keep_or_forget(PLAN, [f"{DOUBT}it counts"], said.append)  # of which there was none
    assert len(said) == 1
