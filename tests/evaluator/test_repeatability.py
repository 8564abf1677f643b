"""Whether a car repeats itself and drives: what does not is named, what does is not."""

import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_support import skd
from skd_evaluator import AssessmentError, Plan, run_episode
from skd_evaluator.assessment.episode_figures import standing
from skd_evaluator.assessment.run.episodes import aborted
from skd_evaluator.assessment.stages.checks import driving, repeatability
from skd_evaluator.metrics.aborted import NOT_CREDIBLE, UNDISTURBED
from skd_sim.controllers.controller import Controller
from skd_sim.scenario.road_user import Other, Waypoint
from skd_sim.scenario.scenario import Scenario, load_scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Mode, Outcome
from skd_sim.world.state import AdversaryState, CarState, Trajectory

CROSSING = load_scenario("crossing")
STARTS, LIMIT = CROSSING.car.start_speed, CROSSING.collision.hit_speed
PLAN = Plan(CROSSING, safe_count=2, controller="a.b:C", simulations=20)
PHI = [Trajectory(np.column_stack([np.arange(-3.5, 3.0, 0.75), np.full(9, y)]), CROSSING.time_step) for y in (0.0, 0.5)]
EPISODES = [
    *(PLAN.episode(Mode.KAMIKAZE, number % 2, number // 2, PHI[number % 2]) for number in range(4)),
    *(PLAN.episode(Mode.REPLAY, number % 2, number // 2, PHI[number % 2]) for number in range(20)),
]


class Runner:
    """Runs episodes of one controller in this process."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self.logs: list[EpisodeLog] = []

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        for episode in episodes:
            self.logs.append(run_episode(episode, self._controller))
            yield self.logs[-1]


class Car:
    """Slows down in some of its episodes, counted from 0, and asks a little more of its brake in some others."""

    def __init__(
        self, slows: Callable[[int], bool] = lambda _number: False, more: Callable[[int], float] = lambda _number: 0.0
    ) -> None:
        self._when, self._much, self._number = slows, more, -1

    def reset(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self._number += 1
        self._slows, self._more, self._rng = self._when(self._number), self._much(self._number), rng

    def command(self, car: CarState, adversary: AdversaryState) -> float:
        brake = 6.0 if self._slows and car.speed > 1.0 else 0.0
        return 0.1 * self._rng.random() - brake - self._more


def warnings(make: Callable[[], Controller], episodes: Sequence[EpisodeSpec] = EPISODES) -> tuple[str, ...]:
    """Return what is said of a car of which each process has an object of its own."""

    def fresh() -> AbstractContextManager[Runner]:
        return nullcontext(Runner(make()))

    return repeatability("a.b:C", list(Runner(make()).run(episodes)), fresh)


def test_a_car_that_draws_from_the_generator_of_reset_repeats_itself() -> None:
    assert warnings(Car) == ()


def test_a_car_that_counts_its_episodes_is_not_credible() -> None:
    (line,) = warnings(lambda: Car(lambda number: number % 2 == 0))
    assert line.startswith(f"{NOT_CREDIBLE}")
    assert "ended differently in another order" in line


def test_a_difference_that_changes_no_hit_is_a_warning() -> None:
    (line,) = warnings(lambda: Car(more=lambda number: 1e-4 * number), EPISODES[4:])
    assert re.match(r"20 of 20 episodes ended differently in another order, 0 of them in a hit", line)


def test_a_car_that_fails_when_it_is_run_again_is_not_credible() -> None:
    class Failing:
        def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
            raise AssessmentError("controller a.b:C: command failed")
            yield

    class Lost(Runner):
        def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
            yield from (aborted(one, "the process ended") for one in episodes)

    logs = list(Runner(Car()).run(EPISODES[4:]))
    (line,) = repeatability("a.b:C", logs, lambda: nullcontext(Failing()))
    assert line == f"{NOT_CREDIBLE}a.b:C failed when 20 episodes were run again: controller a.b:C: command failed"
    (line,) = repeatability("a.b:C", logs, lambda: nullcontext(Lost(Car())))
    assert line == f"{NOT_CREDIBLE}20 of 20 episodes were aborted when they were run again: the process ended"


class Driven:
    """Runs no car: each drive ends at a speed that is given, or is aborted where that is not a number."""

    def __init__(self, *speeds: float) -> None:
        self._speeds = speeds

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        for episode, last in zip(episodes, self._speeds, strict=True):
            way = episode.safe_trajectory.positions
            speeds = np.linspace(STARTS, last, len(way))
            car = np.column_stack([np.zeros(len(way)), np.cumsum(speeds), np.zeros(len(way)), speeds])
            outcome = Outcome.ABORTED if math.isnan(last) else Outcome.TIMEOUT
            yield EpisodeLog(episode, outcome, way, car, reason="controller ended")


@pytest.mark.parametrize(
    ("speeds", "begins", "often"),
    [
        ([0.51 * STARTS] * 5, None, ""),
        ([0.49 * STARTS] + [STARTS] * 4, UNDISTURBED, " in 1 of 5 drives"),
        ([0.0] * 3 + [STARTS] * 2, NOT_CREDIBLE + UNDISTURBED, " in 3 of 5 drives"),
        ([0.99 * LIMIT] * 5, NOT_CREDIBLE + UNDISTURBED, " in 5 of 5 drives"),
        ([STARTS] * 4 + [math.nan], NOT_CREDIBLE + UNDISTURBED, "failed: controller ended"),
    ],
)
def test_when_a_car_hardly_drives(speeds: list[float], begins: str | None, often: str) -> None:
    lines = driving(PLAN, Driven(*speeds))
    assert len(lines) == (begins is not None)
    for line in lines:
        assert line.startswith(f"{begins}a.b:C ")
        assert often in line


def run(speeds: list[float], away: float, scenario: Scenario = CROSSING, outcome: Outcome = Outcome.MISSED):
    """A run in which the front of the car is so far from the adversary, aside and ahead, all the time."""
    car = np.column_stack(
        [np.full(len(speeds), 1.5), np.linspace(-40.0, -30.0, len(speeds)), np.full(len(speeds), np.pi / 2), speeds]
    )
    adversary = car[:, :2] + (away + scenario.car.front + scenario.adversary.reach) * np.array([0.6, 0.8])
    episode = EpisodeSpec(scenario, Mode.REPLAY, 1, 1, safe_trajectory=Trajectory(adversary, scenario.time_step))
    return EpisodeLog(episode, outcome, adversary, car, 1.0, 4.0, reason="failed: x")


FAR = STARTS * (0.5 * STARTS / 2.0) + 5.0
"""m: it stops at 2 m/s² in v/2 s at half of its speed in the mean, 5 m before the adversary."""


@pytest.mark.parametrize(
    ("log", "found"),
    [
        (run([STARTS, 4.0, 0.0], FAR + 0.1), True),
        (run([STARTS, 4.0, 0.0], FAR - 0.1), False),  # the adversary may have made it stop
        (run([STARTS, LIMIT, LIMIT], FAR + 0.1), False),  # a hit begins at this speed
        (run([STARTS, 0.0, 4.0], FAR + 0.1), False),  # it went on
        (run([STARTS, 4.0, 0.0], FAR + 0.1, outcome=Outcome.COLLISION), False),  # it hit somebody
    ],
)
def test_when_a_car_stands_far_off(log: EpisodeLog, found: bool) -> None:
    assert len(standing("a.b:C", [log])) == found


def test_a_car_may_have_to_stand_for_others() -> None:
    lorry = Other(kind="lorry", length=6.0, width=2.0, way=(Waypoint(0.0, 1.5, -20.0), Waypoint(9.0, 1.5, -20.0)))
    assert standing("a.b:C", [run([STARTS, 4.0, 0.0], 100.0, replace(CROSSING, others=(lorry,)))]) == ()


CARS = """
class Honest:
    "Brakes for who is ahead and near the lane; keeps something from call to call, which its reset leaves as it is."
    asked = 0
    def reset(self, scenario, rng):
        self.front = scenario.car.front
    def command(self, car, adversary):
        self.asked += 1
        gap = adversary.y - car.y - self.front
        near = 0.0 <= gap <= car.speed**2 / 12.0 + 1.0 and abs(adversary.x - car.x) < 2.5
        return -6.0 if near else 0.001 * self.asked

class Counting(Honest):
    "Stands in every other episode, whichever that is, and brakes for nobody in the others."
    episodes = 0
    def reset(self, scenario, rng):
        super().reset(scenario, rng)
        Counting.episodes += 1
    def command(self, car, adversary):
        return -6.0 if Counting.episodes % 2 else 0.0

class SteersInDegrees(Honest):
    def command(self, car, adversary):
        return 0.0, 20.0
"""


@pytest.fixture
def cars(tmp_path: Path) -> Path:
    (tmp_path / "some_cars.py").write_text(CARS)
    return tmp_path


SMALL = (
    "--safe-count", "3", "--kamikaze-count", "4", "--collision-runs", "12", "--simulations", "200", "--quiet",
    "--behaviour", "none", "--adversary-model", "generic", "--margin-limit", "0",
)  # fmt: skip


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Honest", []),
        ("Counting", ["episodes ended differently in another order"]),
        ("SteersInDegrees", ["undisturbed, some_cars:SteersInDegrees leaves the road in 5 of 5 drives"]),
    ],
)
def test_an_assessment_fails_by_a_car_that_is_not_credible(cars: Path, name: str, said: list[str]) -> None:
    words = ("--controller", f"some_cars:{name}", *SMALL, "--fail-below", "deviation=0", "--out", "out")
    done = skd("assess", *words, cwd=cars)
    lines = json.loads((cars / "out" / "assessment.json").read_text())["warnings"]
    found = [line for line in lines if line.startswith(NOT_CREDIBLE)]
    assert (done.returncode == 0) == (not said), done.stderr
    assert bool(found) == bool(said)
    for part in said:
        (line,) = [one for one in found if part in one]
        assert line in done.stderr
        assert "gate: deviation ≥ 0: error, not judged" in done.stderr
