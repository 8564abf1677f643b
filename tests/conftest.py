"""What holds for all tests.

A suite that a shell started in the background ignores SIGINT, and so would every program that a test interrupts.
Hypothesis tries the same examples in each run and does not mind how long one takes; new ones are tried with
`--hypothesis-profile=explore`.

Tests of whole node graphs wait for other processes on a machine whose load nobody knows. One that starts some, and
fails, is run once more and stands in the summary as RERUN, with its traceback; a second one in the same run fails, as
does what fails twice (`--max-suite-reruns`, in pyproject.toml). Tests without living processes have no such excuse.

Side by side, those of tests/graph run in two processes: each half shares what it records and what it forks nodes from,
and no more than two of their modules are in each other's way. All others are shared out by their files, what takes long
first.
"""

from __future__ import annotations

import gc
import inspect
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from xdist.scheduler import LoadFileScheduling

gc.disable()  # until all is imported, which stays: to look for garbage in it takes longer than some tests

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("explore", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("same", settings.get_profile("explore"), derandomize=True)
settings.load_profile("same")

_HERE = Path(__file__).resolve().parent
_GRAPHS = (_HERE / "graph", _HERE / "packaging")
_STARTS = {"ForkedSkd", "Popen", "Program", "Skd", "running", "skd", "start_node", "whole_graph"}
"""What starts a process that a test then talks to, or waits for."""
_LONGEST = (
    "graph", "packaging", "documentation", "adversary/test_car_fit.py", "sim/test_compilation.py",
    "recordings/test_forged_episodes.py", "evaluator", "benchmarks", "adversary",
)  # fmt: skip
"""Folders and files that are begun first, in this order: a long one at the end would leave the others idle."""


@pytest.fixture(scope="session", autouse=True)
def undrawn() -> None:
    """Let only tests that look at pictures draw them."""
    from undrawn import leave_undrawn  # which imports matplotlib: not in the process that only hands out tests

    leave_undrawn()


@pytest.fixture
def pictures_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw pictures."""
    from undrawn import DRAW, Figure

    monkeypatch.setattr(Figure, "savefig", DRAW)


def _turn(item: pytest.Item) -> int:
    """Return the place of a test's file among those that are begun first."""
    places = (number for number, name in enumerate(_LONGEST) if item.path.is_relative_to(_HERE / name))
    return next(places, len(_LONGEST))


def _names(function: Callable[..., Any], seen: set[CodeType]) -> Iterator[str]:
    """Yield the names that a function uses, and that functions and classes of its module use which it calls."""
    function = inspect.unwrap(function)
    parts = [code] if isinstance(code := getattr(function, "__code__", None), CodeType) else []
    while parts:
        part = parts.pop()
        if part in seen:
            continue
        seen.add(part)
        parts += [constant for constant in part.co_consts if isinstance(constant, CodeType)]
        for name in part.co_names:
            yield name
            called = function.__globals__.get(name)
            if getattr(called, "__module__", None) != function.__module__:
                continue
            for inner in vars(called).values() if inspect.isclass(called) else (called,):
                if inspect.isfunction(inner):
                    yield from _names(inner, seen)


def _is_live(item: pytest.Item) -> bool:
    """Whether a test, or a fixture that is made for it or its module alone, starts processes."""
    if not isinstance(item, pytest.Function) or not any(item.path.is_relative_to(folder) for folder in _GRAPHS):
        return False
    fixtures = [one for found in item._fixtureinfo.name2fixturedefs.values() for one in found]
    functions = [item.function, *(one.func for one in fixtures if one.scope in ("function", "module"))]
    seen: set[CodeType] = set()
    return any(name in _STARTS for function in functions for name in _names(function, seen))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let one test of living processes fail once; in a process of several, bring what takes long to the front."""
    for item in items:
        if _is_live(item):
            item.add_marker(pytest.mark.flaky(reruns=1))
    if hasattr(config, "workerinput"):
        items.sort(key=_turn)


def pytest_collection_finish() -> None:
    """Look for garbage again, in what tests make."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadFileScheduling | None:
    """Share tests out by their files, but those of tests/graph as if they were two."""
    from xdist.scheduler import LoadFileScheduling

    class Scheduler(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            folder, _, name = nodeid.partition("::")[0].rpartition("/")
            if folder.endswith("tests/graph"):
                return f"graph, {'first' if name < 'test_k' else 'second'} half"
            return super()._split_scope(nodeid)

    return Scheduler(config, log) if config.getoption("dist") == "loadfile" else None
