"""Code of others runs in a child process: it may crash, hang, print or leave processes, and costs one piece of work."""

import contextlib
import ctypes
import faulthandler
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from common import is_alive, wait_until
from skd_sim.controllers import isolated as module
from skd_sim.controllers.isolated import (
    CALL_LIMIT,
    FAILED_STARTS,
    IsolatedProcess,
    LostProcessError,
    begin_call,
    end_children,
    isolated,
    isolated_each,
    set_call_limit,
)
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.world.episode import AbortKind, kind_of

SLEEPS = "import os, sys, time; open(sys.argv[1] + '/' + str(os.getpid()), 'w').close(); time.sleep(1000)"


@pytest.fixture(autouse=True)
def no_children() -> Iterator[None]:
    yield
    end_children()
    set_call_limit(CALL_LIMIT)
    module._Here.failed = 0


def double(number: int) -> int:
    return 2 * number


def pid(_item: object) -> int:
    return os.getpid()


def leave(code: int) -> None:
    os._exit(code)


def crash(_item: object) -> None:
    faulthandler.disable()
    ctypes.string_at(0)


def fail(error: BaseException) -> None:
    raise error


def hang(how: str) -> None:
    begin_call()
    if how == "sleeps":
        time.sleep(1000.0)
    elif how == "loops":
        while True:
            pass
    elif how == "holds Python's lock":
        ctypes.PyDLL(None).sleep(1000)
    else:
        os.kill(os.getpid(), signal.SIGSTOP)


def bear(item: tuple[Path, str]) -> None:
    """Start processes: one that holds no file of this one, and one that holds all of them; then end, or not."""
    folder, end = item
    subprocess.Popen([sys.executable, "-I", "-S", "-c", SLEEPS, str(folder)])
    if os.fork() == 0:
        (folder / str(os.getpid())).touch()
        time.sleep(1000.0)
    wait_until(lambda: len(list(folder.iterdir())) == 2, "the children")
    if end == "exit":
        os._exit(0)
    if end == "hang":
        hang("sleeps")
    if end == "close":  # of the pipe, too: what a class that becomes a daemon does
        os.closerange(3, 1000)


@pytest.fixture
def family(tmp_path: Path) -> Iterator[Path]:
    """A folder of the ids of processes, which are gone at the end."""
    yield tmp_path
    try:
        assert len(list(tmp_path.iterdir())) == 2
        wait_until(lambda: not any(is_alive(one.name) for one in tmp_path.iterdir()), "their end", 5.0)
    finally:
        for one in tmp_path.iterdir():
            if is_alive(one.name):
                os.kill(int(one.name), signal.SIGKILL)


def test_work_is_done_in_a_child_that_is_kept() -> None:
    assert [isolated("mine", double, number) for number in range(3)] == [0, 2, 4]
    child = isolated("mine", pid, None)
    assert child == isolated("mine", pid, None) != os.getpid()
    assert isolated("another", pid, None) not in (child, os.getpid())
    assert isolated("", pid, None) == os.getpid()


@pytest.mark.parametrize("error", [UsageError("wrong"), AssessmentError("failed"), ValueError("ours")])
def test_what_work_raises_is_raised(error: Exception) -> None:
    with pytest.raises(type(error), match=str(error)):
        isolated("mine", fail, error)
    assert isolated("mine", double, 1) == 2


@pytest.mark.parametrize(
    ("work", "item", "said"),
    [(leave, 0, "exit code 0"), (leave, 3, "exit code 3"), (crash, None, "was killed by SIGSEGV")],
)
def test_a_child_that_ends_costs_its_work_and_is_replaced(work: Any, item: object, said: str) -> None:
    before = isolated("controller a:Car", pid, None)
    with pytest.raises(LostProcessError, match=said) as caught:
        isolated("controller a:Car", work, item)
    assert kind_of(caught.value.reason) == AbortKind.ENDED
    assert "(controller a:Car)" in caught.value.reason
    assert isolated("controller a:Car", pid, None) != before


def double_unless_three(number: int) -> int:
    if number == 3:
        os._exit(4)
    if number == 6:
        raise UsageError("six")
    return 2 * number


def test_of_many_items_those_that_cost_the_child_are_lost_alone() -> None:
    def lost(number: int, reason: str) -> int:
        assert "exit code 4" in reason
        return -number

    found = []
    with pytest.raises(UsageError, match="six"):
        found.extend(isolated_each("mine", double_unless_three, range(9), lost))
    assert found == [0, 2, 4, -3, 8, 10]
    assert list(isolated_each("mine", double, range(3), lost)) == [0, 2, 4]


@pytest.mark.parametrize("how", ["sleeps", "loops", "holds Python's lock", "is stopped"])
def test_a_call_that_does_not_end_is_broken_off(how: str) -> None:
    set_call_limit(0.4)
    begin = time.monotonic()
    with pytest.raises(LostProcessError, match=r"a call took more than 0\.4 s \(mine\)") as caught:
        isolated("mine", hang, how)
    assert kind_of(caught.value.reason) == AbortKind.NO_ANSWER
    assert time.monotonic() - begin < 5.0


def test_children_that_end_at_once_end_the_assessment() -> None:
    for _ in range(FAILED_STARTS - 1):
        with pytest.raises(LostProcessError):
            isolated("mine", leave, 3)
    with pytest.raises(AssessmentError, match=r"3 episodes in a row failed.*exit code 3"):
        isolated("mine", leave, 3)


@pytest.mark.parametrize("end", ["", "exit", "hang", "close"])
def test_what_a_child_has_started_ends_with_it(family: Path, end: str) -> None:
    set_call_limit(0.5)
    child = IsolatedProcess()
    with pytest.raises(LostProcessError) if end else contextlib.nullcontext():
        child.run(bear, (family, end))
    child.close()
