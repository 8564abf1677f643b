"""Running many episodes in process, on several cores."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any

from skd_sim.choices.car_under_test import CarUnderTest
from skd_sim.choices.simulators import is_own_world
from skd_sim.controllers import (
    BasicController,
    control_period_of,
    make_controller,
    require_sensor,
    with_control_period,
)
from skd_sim.controllers.isolated import CALL_LIMIT, IsolatedProcess, LostProcessError
from skd_sim.encounter.scenario import Scenario
from skd_sim.episode.episode import Episode
from skd_sim.errors import UsageError

from skd_evaluator.campaign.run.executor_runner import ExecutorRunner, answers
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.worker_pool import WorkerPool
from skd_evaluator.errors import AssessmentError


def available_workers() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def warm_up_with(episodes: Sequence[Episode]) -> None:
    """Have this process compile what episodes like these need."""
    for episode in episodes:
        run_episode(episode, BasicController())  # compiles all the same, and leaves a user's controller alone


def _control_period(question: tuple[CarUnderTest, Scenario]) -> float | None:
    car, scenario = question
    controller = make_controller(car.controller, car.multiplier)
    require_sensor(controller, car.controller, scenario)
    return control_period_of(controller, car.controller)


def check_controller(car: CarUnderTest, scenario: Scenario) -> Scenario:
    """Return the scenario with the control period that a controller declares, if it does.

    Refused is a controller that cannot be made, or a scenario that cannot give it what it needs. A user's is made in a
    process of its own: its code may end the one that it runs in.

    Raises:
        UsageError: it is so.
    """
    if car.is_own or not car.exists:  # which will be said
        return with_control_period(scenario, _control_period((car, scenario)), car.controller)
    child = IsolatedProcess()
    try:
        period = child.run(_control_period, (car, scenario))
    except LostProcessError as error:
        raise UsageError(f"controller {car.controller!r} cannot be loaded: {error.reason}") from None
    finally:
        child.close()
    return with_control_period(scenario, period, car.controller)


class InProcessRunner(ExecutorRunner):
    """Runs episodes in this process, or in worker processes forked from it; the results are the same.

    A controller or a simulator of a user's own always runs in workers, for its code may end the process it runs in.
    """

    def __init__(self, workers: int = 1, *, isolated: bool = False, answer_limit: float = CALL_LIMIT) -> None:
        """Prepare to run.

        Args:
            workers: number of processes; with one, episodes of SKD's own controllers in SKD's own world run in the
                caller's process.
            isolated: whether a controller or a simulator of a user's own is to come; then `start` starts a worker even
                if one is asked for.
            answer_limit: time that a call of a user's controller may take, s.
        """
        super().__init__()
        if workers < 1:
            raise ValueError(f"at least one worker is needed, got {workers}")
        self._count = workers
        self._isolated = isolated or workers > 1
        self._answer_limit = answer_limit
        self._pool: WorkerPool | None = None
        self._lock = threading.Lock()  # of whether there is a pool

    def start(self, warm_up: Sequence[Episode] = (), *, inherited: Callable[[], None] = lambda: None) -> None:
        """Start the workers, after `warm_up` and `inherited` have run here: forked workers have what these compiled.

        Call it before other threads start: a process with threads is not safe to fork.
        """
        warm_up_with(warm_up)
        inherited()
        with self._lock:
            if self._isolated and self._pool is None:
                self._pool = WorkerPool(self._count, answer_limit=self._answer_limit)

    def close(self, *, wait: bool = True) -> None:
        """End the workers; what has not begun is dropped, and what has begun too unless `wait`."""
        with self._lock:
            pool, self._pool = self._pool, None
        if pool is not None:
            pool.shutdown(wait=wait, cancel_futures=True)

    def _expect(self, episodes: Sequence[Episode]) -> None:
        self._isolated |= not all(episode.car.is_own and is_own_world(episode.simulator) for episode in episodes)

    @property
    def _apart(self) -> bool:
        return self._isolated

    def _workers(self) -> int:
        return self._count

    def _submit(self, work: Callable[[Any], Any], items: Sequence[Any]) -> Future[Any]:
        pool = self._pool
        if pool is None:
            raise AssessmentError("the workers have ended")
        return pool.submit(answers, work, items)
