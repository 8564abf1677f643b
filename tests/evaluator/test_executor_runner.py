"""Episodes dealt out over any executor: in order, none lost, none twice, bounded, whatever becomes of workers."""

from __future__ import annotations

import math
import threading
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skd_evaluator.campaign.plan.plan import Plan
from skd_evaluator.campaign.run.executor_runner import RUNS, ExecutorRunner, Pace, answers
from skd_evaluator.campaign.run.worker_pool import LostWorkerError
from skd_evaluator.errors import AssessmentError
from skd_sim.encounter.scenario import load_scenario


class Over(ExecutorRunner):
    """Over an executor that is there; keeps count of what is handed out."""

    def __init__(self, executor, workers=2):
        super().__init__()
        self.executor, self.count = executor, workers
        self.at_work = self.most = self.tasks = 0
        self.lock = threading.Lock()

    def start(self, warm_up=(), *, inherited=lambda: None):
        pass

    def close(self, *, wait=True):
        self.executor.shutdown(wait=wait, cancel_futures=True)

    def _workers(self):
        return self.count

    def _submit(self, work, items):
        with self.lock:
            self.tasks += 1
            self.at_work += 1
            self.most = max(self.most, self.at_work)
        future = self.executor.submit(answers, work, items)
        future.add_done_callback(self._over)
        return future

    def _over(self, _future):
        with self.lock:
            self.at_work -= 1


def square(item: int) -> int:
    return item * item


def fails_at_31(item: int) -> int:
    if item == 31:
        raise AssessmentError("no more")
    return item


@pytest.mark.parametrize("kind", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_any_executor_gives_what_a_loop_gives(kind):
    with Over(kind(2)) as runner:
        assert list(runner.map(square, range(500))) == [item * item for item in range(500)]
        assert runner.most <= 6  # two for each worker, and two more
        found = runner.map(fails_at_31, range(100))
        assert [next(found) for _ in range(31)] == list(range(31))
        with pytest.raises(AssessmentError, match="no more"):
            next(found)


def test_what_is_sent_back_has_no_episode_and_what_is_given_has_the_one_that_was_asked_for():
    from test_campaign import straight

    plan, phi = Plan(load_scenario("crossing")), straight()
    from skd_sim.episode.episode import Mode

    episodes = [plan.episode(Mode.REPLAY, 0, attempt, phi) for attempt in range(3)]
    with Over(ProcessPoolExecutor(1)) as runner:
        logs = list(runner.run(episodes))
    assert all(log.episode is episode for log, episode in zip(logs, episodes, strict=True))


def test_nobody_runs_far_ahead_of_whoever_takes_the_results():
    release = threading.Event()

    def slow_at_first(item: int) -> int:
        if item == 0:
            release.wait(60.0)
        return item

    with Over(ThreadPoolExecutor(2)) as runner:
        runner.pace = Pace(0.0, 0.0)  # one item a task
        threading.Timer(0.5, release.set).start()
        found = runner.map(slow_at_first, range(1000))
        assert next(found) == 0
        assert runner.tasks <= 2 * 16 + 6
        assert list(found) == list(range(1, 1000))


def test_what_nobody_asks_for_any_more_is_cancelled():
    gate = threading.Event()

    def waits(item: int) -> int:
        if item:
            gate.wait(60.0)
        return item

    runner = Over(ThreadPoolExecutor(1), workers=1)
    found = runner.map(waits, range(100))
    next(found)
    found.close()
    gate.set()
    runner.close()
    assert runner.tasks <= 6
    assert runner.at_work == 0


class Scripted(Over):
    """Whose workers die by a script: at each submission of an item so often, with or without a word of which it was."""

    def __init__(self, deaths, tells, foreign):
        super().__init__(None)
        self.deaths, self.tells, self.foreign = dict(deaths), tells, foreign
        self.ran = []

    def _submit(self, work, items):
        future = Future()
        for number, item in enumerate(items):
            if self.deaths.get(item, 0) > 0:
                self.deaths[item] -= 1
                future.set_exception(LostWorkerError("gone", number if self.tells else None, self.foreign))
                return future
        self.ran += items
        future.set_result(answers(work, items))
        return future

    def close(self, *, wait=True):
        pass


@settings(max_examples=100, deadline=None)
@given(
    count=st.integers(1, 60),
    deaths=st.dictionaries(st.integers(0, 59), st.integers(1, 5), max_size=6),
    tells=st.booleans(),
    foreign=st.booleans(),
)
def test_whatever_dies_each_item_has_its_result_or_its_reason_and_only_who_dies_too_often_has_a_reason(
    count, deaths, tells, foreign
):
    runner = Scripted(deaths, tells, foreign)
    runner._seconds[square] = 0.01  # chunks from the beginning
    found = list(runner.map(square, range(count), lambda item, reason: (item, reason)))
    assert len(found) == count
    for item, result in enumerate(found):
        assert result in (item * item, (item, "gone"))
        if item not in deaths:
            assert result == item * item
        elif (not foreign and tells) or deaths[item] >= RUNS + 1:
            assert result == (item, "gone")
        elif deaths[item] < RUNS and foreign:
            assert result == item * item
    done = [item for item, result in enumerate(found) if result == item * item]
    assert sorted(runner.ran) == done  # nothing ran twice that was taken


def test_an_executor_that_breaks_is_one_line():
    class Broken:
        def submit(self, *_arguments):
            raise BrokenExecutor("all gone")

        def shutdown(self, **_options):
            pass

    with Over(Broken()) as runner, pytest.raises(AssessmentError, match="all gone"):
        list(runner.map(square, range(3)))


@given(
    seconds=st.floats(1e-6, 100.0),
    remaining=st.integers(1, 10**6),
    workers=st.integers(1, 4000),
    target=st.floats(0.0, 10.0),
    least=st.floats(0.0, 1.0),
)
def test_chunks_are_long_beside_their_cost_but_leave_work_for_all(seconds, remaining, workers, target, least):
    chunk = Pace(target, least).chunk(seconds, remaining, workers)
    assert 1 <= chunk <= remaining
    assert chunk == 1 or chunk * seconds <= target * (1 + 1e-9)
    assert chunk <= max(1.0, math.ceil(remaining / (4 * workers)), least / seconds)
    assert Pace(target, least).chunk(None, remaining, workers) == 1
