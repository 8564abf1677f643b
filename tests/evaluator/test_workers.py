"""Items dealt out over workers: in order, none lost, none twice, bounded, whatever becomes of the workers."""

import os
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from common import is_alive, wait_until
from skd_evaluator.assessment.plan import Plan
from skd_evaluator.assessment.run.workers import InProcessRunner, in_background
from skd_sim.errors import AssessmentError, OutOfReachError
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import AbortKind, Mode, Outcome, kind_of


def square(item: int) -> int:
    return item * item


def dies_at_13(item: int) -> int:
    if item == 13:
        os._exit(5)
    return 2 * item


@pytest.mark.parametrize("count", [1, 2])
def test_an_item_at_which_its_process_dies_costs_nothing_but_itself(count):
    reasons = []
    with InProcessRunner(count, isolated=True) as runner:
        found = list(runner.map(dies_at_13, range(60), lambda item, reason: (reasons.append(reason), -item)[1]))
        assert found == [-item if item == 13 else 2 * item for item in range(60)]
        assert list(runner.map(square, range(10))) == [item * item for item in range(10)]  # and the pool is there
    (reason,) = reasons
    assert kind_of(reason) == AbortKind.ENDED
    assert "exit code 5" in reason


def test_an_episode_at_which_its_process_dies_is_aborted(monkeypatch):
    from skd_evaluator.assessment.run import workers
    from test_campaign import straight

    run = workers.run_episode
    monkeypatch.setattr(workers, "run_episode", lambda one: os._exit(7) if one.episode_id == doomed else run(one))
    plan, phi = Plan(load_scenario("crossing")), straight()
    episodes = [plan.episode(Mode.REPLAY, 0, trial, phi) for trial in range(12)]
    doomed = episodes[5].episode_id
    with InProcessRunner(2) as runner:
        logs = list(runner.run(episodes))
    assert [log.episode for log in logs] == episodes
    assert [log.outcome == Outcome.ABORTED for log in logs] == [number == 5 for number in range(12)]
    assert "exit code 7" in logs[5].reason


def sleeps(item: int) -> int:
    time.sleep(1000.0 if item else 0.0)
    return os.getpid()


def test_work_under_way_is_dropped_where_the_block_is_left_by_an_error():
    def interrupted() -> None:
        with InProcessRunner(2) as runner:
            workers.append(next(runner.map(sleeps, range(10))))
            raise KeyboardInterrupt

    workers: list[int] = []
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not is_alive(workers[0])
    assert time.monotonic() - begin < 500.0


def begin_a_result(file: Path) -> None:
    """Write the first bytes of a result, as a worker that is killed on the way has."""
    frame = sys._getframe()
    while frame is not None and "result_queue" not in frame.f_locals:
        frame = frame.f_back
    os.write(frame.f_locals["result_queue"]._writer.fileno(), struct.pack("!i", 1000) + b"half")
    file.touch()
    time.sleep(600)


def test_workers_that_are_ended_within_a_result_are_not_waited_for(tmp_path):
    runner = InProcessRunner(2)
    runner.start()
    errors: list[OutOfReachError] = []

    def ask():
        with pytest.raises(OutOfReachError, match="the workers have ended") as raised:
            list(runner.map(begin_a_result, [tmp_path / "begun"]))
        errors.append(raised.value)

    asking = threading.Thread(target=ask, daemon=True)
    asking.start()
    wait_until((tmp_path / "begun").exists)
    closing = threading.Thread(target=runner.close, kwargs={"wait": False}, daemon=True)
    closing.start()
    closing.join(10.0)
    assert not closing.is_alive()
    asking.join(10.0)
    assert errors  # and the item is not tried again


INTERRUPTED = """
import contextlib, signal, time
from skd_evaluator.assessment.run.workers import InProcessRunner

def sleeps(item):
    time.sleep(600)

runner = InProcessRunner(2)
runner.start()
signal.signal(signal.SIGALRM, signal.default_int_handler)
signal.alarm(1)
with contextlib.suppress(KeyboardInterrupt):
    list(runner.map(sleeps, [b"more than a pipe holds" * 10_000] * 20))
runner.close(wait=False)
"""


def test_an_end_in_the_midst_of_work_is_quick_and_silent():
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], timeout=60, check=True, capture_output=True, text=True)
    assert not done.stderr


def test_all_who_wait_for_work_learn_that_the_workers_were_ended():
    runner = InProcessRunner(1, isolated=True)
    runner.start()
    ended = []

    def ask():
        with pytest.raises((AssessmentError, OutOfReachError)):
            list(runner.map(time.sleep, [600.0] * 4))
        ended.append(True)

    asking = [threading.Thread(target=ask, daemon=True) for _ in range(4)]
    for thread in asking:
        thread.start()
    time.sleep(1.0)
    runner.close(wait=False)
    for thread in asking:
        thread.join(10.0)
    assert len(ended) == 4


def test_what_is_done_in_the_background_is_on_disk_and_said(tmp_path, capfd):
    def work() -> None:
        os.write(1, b"nobody is to read this")
        (tmp_path / "number").write_text(str(os.getpid()))

    with in_background(work) as wait:
        assert wait()
        assert wait()
    assert int((tmp_path / "number").read_text()) != os.getpid()
    assert capfd.readouterr() == ("", "")


def test_work_in_the_background_ends_with_its_block(tmp_path):
    def work() -> None:
        (tmp_path / "number").write_text(str(os.getpid()))
        time.sleep(1000.0)

    begin = time.monotonic()
    with in_background(work):
        wait_until(lambda: (tmp_path / "number").exists() and (tmp_path / "number").read_text())
    assert not is_alive((tmp_path / "number").read_text())
    assert time.monotonic() - begin < 500.0
