"""Episodes, or any other items, dealt out in chunks over a `concurrent.futures.Executor`, and put in order again."""

from __future__ import annotations

import math
import queue
import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Future
from dataclasses import dataclass, fields
from types import TracebackType
from typing import Any, NamedTuple, NoReturn, Self, TypeVar

from skd_sim.choices.simulators import is_own_world
from skd_sim.controllers.isolated import LostProcessError, isolated, portable
from skd_sim.episode.episode import Episode, EpisodeLog

from skd_evaluator.campaign.run.assembly import aborted
from skd_evaluator.campaign.run.runner import run_episode
from skd_evaluator.campaign.run.worker_pool import LostWorkerError, say_finished
from skd_evaluator.errors import AssessmentError, OutOfReachError

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

RUNS = 3
"""So often an item is begun whose worker was ended by somebody else."""
_POLL = 0.25  # s between two looks at whether the workers are still there, while no answer comes
_SPARE = 2  # tasks that wait beside two for each worker: one that it is at, and the next
_AHEAD = 16  # tasks for each worker that may be finished before their turn
_PARTS = 4  # the rest of the items is at least so many tasks for each worker: none idles for long at the end
_NEWS = 0.3  # weight of the last task in the time that an item takes


class Answer(NamedTuple):
    """What became of one item.

    Attributes:
        fine: whether `value` is the item's result; if not, it is the exception that was raised.
        value: result of the item, or the exception.
        seconds: wall-clock time that the item took, s.
    """

    fine: bool
    value: Any
    seconds: float


def answers(work: Callable[[Any], Any], items: Sequence[Any]) -> list[Answer]:
    """Do `work` on items, in a worker, as far as the first that fails."""
    found: list[Answer] = []
    for item in items:
        begin = time.perf_counter()
        try:
            found.append(Answer(True, work(item), time.perf_counter() - begin))
        except BaseException as error:  # whatever a user's code raises
            found.append(Answer(False, portable(error), time.perf_counter() - begin))
            break
        say_finished()
    return found


@dataclass(frozen=True)
class Pace:
    """How long a task should take.

    Attributes:
        target: time that a task should take, s; long beside what sending a task costs.
        least: time that a task should take at least, even near the end, s, as far as items allow.
    """

    target: float
    least: float

    def chunk(self, seconds: float | None, remaining: int, workers: int) -> int:
        """Return how many items the next task should have.

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


_SENT = [field.name for field in fields(EpisodeLog) if field.name != "episode"]


def _sent(log: EpisodeLog) -> tuple[Any, ...]:
    """Return what a log is but for its episode, which whoever asked for it has: φ and scenario stay where they are."""
    return tuple(getattr(log, name) for name in _SENT)


def _run_and_send(episode: Episode) -> tuple[Any, ...]:
    """Run an episode, where code of others is in it in a child: should that be lost, the episode is aborted."""
    simulator = "" if is_own_world(episode.simulator) else f"simulator {episode.simulator}"
    whose = ", ".join(filter(None, (episode.car.user_code, simulator)))
    try:
        return isolated(whose, _run_here, episode)
    except LostProcessError as error:
        return _lost_episode(episode, error.reason)


def _run_here(episode: Episode) -> tuple[Any, ...]:
    return _sent(run_episode(episode))


def _lost_episode(episode: Episode, reason: str) -> tuple[Any, ...]:
    return _sent(aborted(episode, reason))


def _lost(_item: object, reason: str) -> NoReturn:
    raise AssessmentError(reason)


class ExecutorRunner(ABC):
    """Runs episodes over an executor; results, and what is raised, are those of a plain loop.

    Several threads may use one at once, each with its own episodes: they share the workers.
    """

    pace = Pace(target=0.25, least=0.02)
    """Of its tasks."""

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
    def start(self, warm_up: Sequence[Episode] = (), *, inherited: Callable[[], None] = lambda: None) -> None:
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
        """Hand `answers(work, items)` to the executor."""

    def _unpacked(self, found: Any) -> list[Answer]:
        """Return the answers that a future of `_submit` has given."""
        return list(found)

    @abstractmethod
    def _workers(self) -> int:
        """Return how many there are now."""

    @property
    def _apart(self) -> bool:
        """Whether the work is done elsewhere at all."""
        return True

    def _expect(self, episodes: Sequence[Episode]) -> None:
        """Be told which episodes are to come."""
        return

    def _check(self) -> None:
        """Look whether the workers are still there, while no answer comes.

        Raises:
            AssessmentError: they are not.
        """
        return

    def _loss(self, error: Exception) -> LostWorkerError | None:
        """Return what an executor's exception says of a lost worker; None where it says something else."""
        return error if isinstance(error, LostWorkerError) else None

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        """Run all of `episodes` and yield their logs in the same order.

        An episode whose worker ends or falls silent is aborted, with the reason; it is begun anew first, where somebody
        else has ended the worker.

        Raises:
            AssessmentError: the controller under test raised or gave no finite number, or workers end one after the
                other, or are out of reach.
        """
        self._expect(episodes)
        found = self.map(_run_and_send, episodes, _lost_episode)
        try:
            for episode, sent in zip(episodes, found, strict=True):
                yield EpisodeLog(episode, *sent)
        finally:
            found.close()

    def map(
        self, work: Callable[[_Item], _Result], items: Sequence[_Item], lost: Callable[[_Item, str], _Result] = _lost
    ) -> Generator[_Result, None, None]:
        """Do `work`, a function of a module, on every item and yield what it returns in the same order.

        Args:
            work: function that is called with each item; what it raises is raised here.
            items: items to work on, one by one.
            lost: what stands for the result of an item that no worker has finished, for the reason given; an
                AssessmentError by default.

        Raises:
            AssessmentError: see `lost`; or one worker after the other fails before it has finished anything.
        """
        if not self._apart:
            yield from map(work, items)
            return
        self.start()
        batch = _Batch(self, work, items, lost)
        try:
            for number in range(len(items)):
                yield batch.take(number)
        finally:
            batch.cancel()


class _Batch:
    """Items on their way through an executor; of one thread."""

    def __init__(
        self,
        runner: ExecutorRunner,
        work: Callable[[Any], Any],
        items: Sequence[Any],
        lost: Callable[[Any, str], Any],
    ) -> None:
        self._runner, self._work, self._items, self._lost = runner, work, items, lost
        self._at_work: dict[Future[Any], list[int]] = {}
        self._done: queue.SimpleQueue[Future[Any]] = queue.SimpleQueue()
        self._results: dict[int, Answer] = {}
        self._again: deque[list[int]] = deque()
        self._begun = 0  # items handed out, those to be done again not counted
        self._runs: Counter[int] = Counter()

    def take(self, number: int) -> Any:
        """Return the result of an item, of each in turn."""
        while number not in self._results or not self._done.empty():
            self._fill(number)
            try:
                future = self._done.get(timeout=_POLL)
            except queue.Empty:
                self._runner._check()
                continue
            self._settle(future)
        self._fill(number)
        answer = self._results.pop(number)
        if not answer.fine:
            raise answer.value
        return answer.value

    def _fill(self, turn: int) -> None:
        """Hand out as many tasks as keep the workers busy; what is finished before its turn must not pile up."""
        workers = self._runner._workers()
        pace, seconds = self._runner.pace, self._runner._seconds.get(self._work)
        total = len(self._items)
        while len(self._at_work) < 2 * workers + _SPARE:
            if self._again:
                numbers = self._again.popleft()
            else:
                chunk = pace.chunk(seconds, total - self._begun, workers)
                if self._begun >= min(total, turn + _AHEAD * workers * chunk):
                    return
                numbers = list(range(self._begun, self._begun + chunk))
                self._begun += chunk
            try:
                future = self._runner._submit(self._work, [self._items[number] for number in numbers])
            except BrokenExecutor as error:
                raise OutOfReachError(str(error)) from error
            self._at_work[future] = numbers
            future.add_done_callback(self._done.put)

    def _settle(self, future: Future[Any]) -> None:
        numbers = self._at_work.pop(future)
        try:
            found = self._runner._unpacked(future.result())
        except CancelledError:
            self._runner._check()
            raise OutOfReachError("the work was dropped by the workers") from None
        except BrokenExecutor as error:
            raise OutOfReachError(str(error)) from error
        except Exception as error:
            loss = self._runner._loss(error)
            if loss is None:
                raise
            self._lose(numbers, loss)
            return
        for number, answer in zip(numbers, found, strict=False):  # what follows a failure is never asked for
            self._results[number] = answer
        seconds = sum(answer.seconds for answer in found) / len(found)
        known = self._runner._seconds.get(self._work, seconds)
        self._runner._seconds[self._work] = known + _NEWS * (seconds - known)

    def _lose(self, numbers: list[int], loss: LostWorkerError) -> None:
        """Have the items of a lost task done again, but for the one that is to blame, after some tries."""
        if loss.finished is None and len(numbers) > 1:
            self._again.extend([number] for number in numbers)
            return
        guilty = numbers[min(loss.finished or 0, len(numbers) - 1)]
        if others := [number for number in numbers if number != guilty]:
            self._again.append(others)
        self._runs[guilty] += 1
        if loss.foreign and self._runs[guilty] < RUNS:
            self._again.append([guilty])
            return
        try:
            self._results[guilty] = Answer(True, self._lost(self._items[guilty], loss.reason), 0.0)
        except AssessmentError as error:
            self._results[guilty] = Answer(False, error, 0.0)

    def cancel(self) -> None:
        """Drop what nobody will ask for."""
        for future in self._at_work:
            future.cancel()
