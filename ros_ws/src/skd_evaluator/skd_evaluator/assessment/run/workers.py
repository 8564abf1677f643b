"""Episodes, or any other items, run on several cores: in processes forked from this one, or on a Dask cluster.

A runner gives what a plain loop gives, in the same order, however many workers there are. Items go out in chunks that
take long beside what sending them costs. Code of users runs in a child of the worker (`skd_sim.controllers.isolated`),
so the workers run SKD's own; where one dies all the same, what all of them were at is done again in a process apart.
"""

from __future__ import annotations

import itertools
import math
import multiprocessing
import os
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future, InvalidStateError, ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from types import TracebackType
from typing import Any, Final, NamedTuple, NoReturn, Self, TypeVar

from skd_sim.controllers.basic import BasicController
from skd_sim.controllers.controller import control_period_of, make_controller, require_sensor, with_control_period
from skd_sim.controllers.isolated import (
    CALL_LIMIT,
    IsolatedProcess,
    LostProcessError,
    end_children,
    isolated,
    isolated_each,
    portable,
    set_call_limit,
)
from skd_sim.errors import AssessmentError, OutOfReachError, UsageError
from skd_sim.interruption import SIGNALS
from skd_sim.options.car_and_adversary import CarUnderTest, is_own_world
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec

from skd_evaluator.assessment.run.episodes import aborted, run_episode

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

_AHEAD: Final = 16  # chunks for each worker that may be finished before their turn
_PARTS: Final = 4  # the rest of the items is at least so many chunks for each worker: none idles for long at the end
_NEWS: Final = 0.3  # weight of the last chunk in the time that an item takes
_POLL: Final = 0.25  # s
_FORK: Final = multiprocessing.get_context("fork")


# --- work on items


class Done(NamedTuple):
    """What became of a chunk of items.

    Attributes:
        results: of its items, as far as the first that failed.
        error: what that raised; None if none failed.
        seconds: wall-clock time that an item took, s.
    """

    results: list[Any]
    error: BaseException | None
    seconds: float


def do(work: Callable[[Any], Any], items: Sequence[Any]) -> Done:
    """Do `work` on items, in a worker, as far as the first that fails."""
    results: list[Any] = []
    error, begin = None, time.perf_counter()
    try:
        results.extend(_run_each(items) if work is _run_here else map(work, items))
    except BaseException as raised:  # whatever a user's code raises
        error = portable(raised)
    return Done(results, error, (time.perf_counter() - begin) / max(1, len(results) + (error is not None)))


@dataclass(frozen=True)
class Pace:
    """How long a chunk should take.

    Attributes:
        target: time that a chunk should take, s; long beside what sending it costs.
        least: time that a chunk should take at least, even near the end, s, as far as items allow.
    """

    target: float
    least: float

    def chunk(self, seconds: float | None, remaining: int, workers: int) -> int:
        """Return how many items the next chunk should have.

        Args:
            seconds: time that an item takes, s; None if it is not known yet.
            remaining: number of items that are not handed out yet.
            workers: number of workers that share them.
        """
        if seconds is None:
            return 1
        seconds = max(seconds, 1e-9)
        fair = math.ceil(remaining / (_PARTS * workers))
        return max(1, min(int(self.target / seconds), max(fair, int(self.least / seconds)), remaining))


def _run_each(episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
    """Run episodes; those with user code run in a child process, and one whose child is lost is aborted."""
    for whose, some in itertools.groupby(episodes, _code_of_others):
        yield from isolated_each(whose, _run_here, list(some), _lost_episode)


def _code_of_others(episode: EpisodeSpec) -> str:
    simulator = "" if is_own_world(episode.simulator) else f"simulator {episode.simulator}"
    return ", ".join(filter(None, (episode.car.user_code, simulator)))


def _run_here(episode: EpisodeSpec) -> EpisodeLog:
    return _sent(run_episode(episode))


def _lost_episode(episode: EpisodeSpec, reason: str) -> EpisodeLog:
    return _sent(aborted(episode, reason))


def _sent(log: EpisodeLog) -> EpisodeLog:
    """Return a log without its episode: the caller has it, so φ and scenario are not sent back."""
    return replace(log, episode=None)  # type: ignore[arg-type]


def _lost(_item: object, reason: str) -> NoReturn:
    raise AssessmentError(reason)


# --- runners


class Workers(ABC):
    """Runs episodes over an executor; results, and what is raised, are those of a plain loop.

    Several threads may use one at once, each with its own episodes: they share the workers.
    """

    pace = Pace(target=0.25, least=0.02)

    def __init__(self) -> None:
        """Begin without knowing how long anything takes."""
        self._seconds: dict[Callable[[Any], Any], float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close(wait=kind is None)

    @abstractmethod
    def start(self, warm_up: Sequence[EpisodeSpec] = (), *, inherited: Callable[[], None] = lambda: None) -> None:
        """Start the workers.

        Args:
            warm_up: makes them compile what episodes like these need.
            inherited: called in this process after that, and before workers are forked from it, if they are.
        """

    @abstractmethod
    def close(self, *, wait: bool = True) -> None:
        """End the work; what has not begun is dropped, and what has begun too unless `wait`."""

    @abstractmethod
    def _submit(self, work: Callable[[Any], Any], items: Sequence[Any]) -> Future[Any]:
        """Hand `do(work, items)` to the executor."""

    @abstractmethod
    def _workers(self) -> int:
        """Return how many there are now."""

    @abstractmethod
    def _again(
        self, work: Callable[[Any], Any], items: Sequence[Any], lost: Callable[[Any, str], Any], error: Exception
    ) -> Iterator[Any]:
        """Yield the results of items whose worker was lost, done one by one, and `lost` of those that lose it again."""

    def _unpacked(self, found: Any) -> Done:
        """Return what a future of `_submit` has given."""
        return Done(*found)

    @property
    def _elsewhere(self) -> bool:
        """Whether the work is done in other processes at all."""
        return True

    def _expect(self, episodes: Sequence[EpisodeSpec]) -> None:
        """Be told which episodes are to come."""
        return

    def _check(self) -> None:
        """Look whether the workers are still there, while no answer comes.

        Raises:
            AssessmentError: they are not.
        """
        return

    def _is_loss(self, error: Exception) -> bool:
        """Return whether an executor's exception says that a worker was lost."""
        return isinstance(error, BrokenExecutor)

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        """Run all of `episodes` and yield their logs in the same order.

        An episode whose process ends is aborted, with the reason.

        Raises:
            AssessmentError: the controller under test raised or gave no finite number, or processes end one after the
                other, or workers are out of reach.
        """
        self._expect(episodes)
        found = self.map(_run_here, episodes, _lost_episode)
        try:
            for episode, sent in zip(episodes, found, strict=True):
                yield replace(sent, episode=episode)
        finally:
            found.close()

    def map(
        self, work: Callable[[_Item], _Result], items: Sequence[_Item], lost: Callable[[_Item, str], _Result] = _lost
    ) -> Generator[_Result, None, None]:
        """Do `work`, a function of a module, on every item and yield what it returns in the same order.

        Args:
            work: function that is called with each item; what it raises is raised here.
            items: items to work on, one by one.
            lost: what stands for the result of an item whose process ended, for the reason given; an AssessmentError by
                default.

        Raises:
            AssessmentError: see `lost`; or one process after the other ends before it has finished anything.
        """
        if not self._elsewhere:
            yield from map(work, items)
            return
        self.start()
        chunks: deque[tuple[Sequence[Any], Future[Any]]] = deque()
        begun = 0
        try:
            while chunks or begun < len(items):
                workers = self._workers()
                while begun < len(items) and len(chunks) < _AHEAD * workers:
                    count = self.pace.chunk(self._seconds.get(work), len(items) - begun, workers)
                    chunk = items[begun : begun + count]
                    chunks.append((chunk, self._submit(work, chunk)))
                    begun += count
                yield from self._results(work, *chunks.popleft(), lost)
        finally:
            for _, future in chunks:
                future.cancel()

    def _results(
        self, work: Callable[[Any], Any], items: Sequence[Any], future: Future[Any], lost: Callable[[Any, str], Any]
    ) -> Iterator[Any]:
        """Yield the results of a chunk, once they are there."""
        try:
            while not future.done():  # `wait` does not see that one is cancelled
                wait_for([future], _POLL)
                self._check()
            done = self._unpacked(future.result())
        except CancelledError:
            self._check()
            raise OutOfReachError("the workers have ended") from None
        except Exception as error:
            if not self._is_loss(error):
                raise
            yield from self._again(work, items, lost, error)
            return
        known = self._seconds.get(work, done.seconds)
        self._seconds[work] = known + _NEWS * (done.seconds - known)
        yield from done.results
        if done.error is not None:
            raise done.error


class InProcessRunner(Workers):
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
        self._pool: ProcessPoolExecutor | None = None
        self._lock = threading.Lock()  # of the pool

    def start(self, warm_up: Sequence[EpisodeSpec] = (), *, inherited: Callable[[], None] = lambda: None) -> None:
        """Start the workers, after `warm_up` and `inherited` have run here: forked workers have what these compiled.

        Call it before other threads start: a process with threads is not safe to fork.
        """
        warm_up_with(warm_up)
        inherited()
        with self._lock:
            if self._isolated and self._pool is None:
                self._pool = self._forked()

    def _forked(self) -> ProcessPoolExecutor:
        begin = (os.getpid(), self._answer_limit)
        pool = ProcessPoolExecutor(self._count, mp_context=_FORK, initializer=_begin, initargs=begin)
        # Until a worker has settled what a signal means to it, it would do what it means to its parent.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            pool.submit(os.getpid)  # the first task has all of them forked
            # Only workers write results. Close the parent's copy: with it open the pool's thread would wait for the
            # rest of a message whose writer was killed, and never see the end of the pipe.
            vars(pool._result_queue)["_writer"].close()
        except BaseException:  # no descriptor or process is left for another one
            _end(pool)
            raise
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return pool

    def close(self, *, wait: bool = True) -> None:
        """End the workers; what has not begun is dropped, and what has begun too unless `wait`."""
        with self._lock:
            pool, self._pool = self._pool, None
        if pool is None:
            return
        if not wait:
            _end(pool)
        pool.shutdown(cancel_futures=True)
        end_children()

    def _expect(self, episodes: Sequence[EpisodeSpec]) -> None:
        self._isolated |= not all(episode.car.is_own and is_own_world(episode.simulator) for episode in episodes)

    @property
    def _elsewhere(self) -> bool:
        return self._isolated

    def _workers(self) -> int:
        return self._count

    def _submit(self, work: Callable[[Any], Any], items: Sequence[Any]) -> Future[Any]:
        with self._lock:
            if self._pool is None:
                raise AssessmentError("the workers have ended")
            try:
                future = self._pool.submit(do, work, items)
            except BrokenExecutor:
                self._pool = self._forked()
                future = self._pool.submit(do, work, items)
        vars(future)["set_exception"] = partial(_fail, future)
        return future

    def _again(
        self, work: Callable[[Any], Any], items: Sequence[Any], lost: Callable[[Any, str], Any], error: Exception
    ) -> Iterator[Any]:
        """Yield the results of items in a process apart: all in one if that survives, or else each by itself."""
        with self._lock:
            if self._pool is None:  # it was ended by `close`
                raise OutOfReachError("the workers have ended") from error
        for chunk in (items, *([one] for one in items)) if len(items) > 1 else (items,):
            try:
                done = isolated("worker", partial(do, work), chunk)
            except LostProcessError as loss:
                if len(chunk) == 1:
                    yield lost(chunk[0], loss.reason)
                continue
            yield from done.results
            if done.error is not None:
                raise done.error
            if len(chunk) == len(items):
                return


def _fail(future: Future[Any], error: BaseException) -> None:
    """Give a future its exception, unless it was cancelled: a pool whose workers have died would end at its error."""
    with suppress(InvalidStateError):
        Future.set_exception(future, error)


def _end(pool: ProcessPoolExecutor) -> None:
    """End the workers of a pool, whatever they are at."""
    for process in list((pool._processes or {}).values()):
        process.terminate()


def _begin(parent: int, answer_limit: float) -> None:
    """Begin a worker: Ctrl-C reaches the whole process group, and the parent alone decides how to end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    set_call_limit(answer_limit)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: int) -> None:
    """End this process when its parent has ended, by whatever death."""
    while os.getppid() == parent:
        time.sleep(_POLL)
    os._exit(1)


# --- around runners


@contextmanager
def in_background(work: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Do `work` in a process forked from this one, which ends with the block and of which nothing but files is left.

    Enter it before other threads start. Yields what waits for its end, and returns whether the work is done.
    """
    process = _FORK.Process(target=_do_quietly, args=(work, os.getpid()), daemon=True)
    process.start()

    def wait() -> bool:
        process.join()
        return process.exitcode == 0

    try:
        yield wait
    finally:
        process.kill()
        process.join()


def _do_quietly(work: Callable[[], None], parent: int) -> None:
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    try:
        work()
    except BaseException:  # the caller does it again, and meets the error
        os._exit(1)


def available_workers() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def warm_up_with(episodes: Sequence[EpisodeSpec]) -> None:
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
