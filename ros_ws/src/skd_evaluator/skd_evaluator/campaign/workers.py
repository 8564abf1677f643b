"""Running many episodes in process, on several cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from types import TracebackType
from typing import NoReturn, TypeVar

from skd_sim.car_under_test import CarUnderTest
from skd_sim.controllers import (
    BasicController,
    control_period_of,
    make_controller,
    require_sensor,
    with_control_period,
)
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode import Episode, EpisodeLog
from skd_sim.errors import UsageError

from skd_evaluator.campaign.assembly import aborted
from skd_evaluator.campaign.guarded_controller import guard
from skd_evaluator.campaign.runner import run_episode
from skd_evaluator.campaign.worker_pool import ANSWER_LIMIT, WorkerPool
from skd_evaluator.errors import AssessmentError

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def available_workers() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _run(episode: Episode) -> EpisodeLog:
    if episode.car.is_own:
        return run_episode(episode)
    controller = make_controller(episode.controller, episode.multiplier)
    return run_episode(episode, guard(controller, episode.controller))


def _lost_episode(episode: Episode, reason: str) -> EpisodeLog:
    return aborted(episode, f"{reason} (controller {episode.controller})")


def _lost(_item: object, reason: str) -> NoReturn:
    raise AssessmentError(reason)


def _check(question: tuple[CarUnderTest, Scenario]) -> Scenario:
    car, scenario = question
    controller = make_controller(car.controller, car.multiplier)
    require_sensor(controller, car.controller, scenario)
    return with_control_period(scenario, control_period_of(controller, car.controller), car.controller)


def _lost_controller(question: tuple[CarUnderTest, Scenario], reason: str) -> NoReturn:
    raise UsageError(f"controller {question[0].controller!r} cannot be loaded: {reason}")


def check_controller(car: CarUnderTest, scenario: Scenario) -> Scenario:
    """Return the scenario with the control period that a controller declares, if it does.

    Refused is a controller that cannot be made, or a scenario that cannot give it what it needs. A user's is made in a
    process of its own: its code may end the one that it runs in.

    Raises:
        UsageError: it is so.
    """
    question = (car, scenario)
    if car.is_own or not car.exists:  # which will be said
        return _check(question)
    pool = WorkerPool(1)
    try:
        (clocked,) = pool.map(_check, [question], _lost_controller)
        return clocked
    finally:
        pool.close(wait=False)


class InProcessRunner:
    """Runs episodes in this process, or in worker processes forked from it; the results are the same.

    A controller of a user's own always runs in workers, for its code may end the process that it runs in.
    """

    def __init__(self, workers: int = 1, *, isolated: bool = False, answer_limit: float = ANSWER_LIMIT) -> None:
        """Prepare to run.

        Args:
            workers: processes; with one, episodes of our own controllers run in the caller's.
            isolated: whether a controller of a user's own is to come: `start` then starts a worker even for one.
            answer_limit: s that a call of a user's controller may take.
        """
        if workers < 1:
            raise ValueError(f"at least one worker is needed, got {workers}")
        self._workers = workers
        self._isolated = isolated or workers > 1
        self._answer_limit = answer_limit
        self._pool: WorkerPool | None = None

    def __enter__(self) -> InProcessRunner:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(wait=kind is None)

    def start(self, warm_up: Sequence[Episode] = ()) -> None:
        """Start the workers, after running `warm_up` here: forked workers then inherit the compiled kernels.

        Call it before other threads start: a process with threads is not safe to fork.
        """
        for episode in warm_up:
            run_episode(episode, BasicController())  # compiles all the same, and leaves a user's controller alone
        if self._isolated and self._pool is None:
            self._pool = WorkerPool(self._workers, answer_limit=self._answer_limit)

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        """Run all of `episodes` and yield their logs in the same order.

        An episode whose worker ends or falls silent is aborted, with the reason.

        Raises:
            AssessmentError: the controller under test raised or gave no finite number, or workers end one after the
                other.
        """
        self._isolated |= not all(episode.car.is_own for episode in episodes)
        yield from self._map(_run, episodes, _lost_episode)

    def map(self, work: Callable[[_Item], _Result], items: Sequence[_Item]) -> Iterator[_Result]:
        """Do `work`, a function of a module, on every item and yield what it returns in the same order.

        Raises:
            AssessmentError: a worker died.
        """
        yield from self._map(work, items, _lost)

    def _map(
        self, work: Callable[[_Item], _Result], items: Sequence[_Item], lost: Callable[[_Item, str], _Result]
    ) -> Iterator[_Result]:
        if not self._isolated:
            yield from map(work, items)
            return
        self.start()
        assert self._pool is not None
        yield from self._pool.map(work, items, lost)

    def close(self, *, wait: bool = True) -> None:
        """End the workers; what has not begun is dropped, and what has begun too unless `wait`."""
        if self._pool is not None:
            self._pool.close(wait=wait)
            self._pool = None
