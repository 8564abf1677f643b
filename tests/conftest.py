"""What holds for all tests.

A suite that a shell started in the background ignores SIGINT, and so would every program that a test interrupts.
Hypothesis tries the same examples in each run and does not mind how long one takes; new ones are tried with
`--hypothesis-profile=explore`.

Tests of whole node graphs wait for other processes on a machine whose load nobody knows. One that fails is run once
more and stands in the summary as RERUN; what fails twice fails.

Side by side, those of tests/graph run in two processes: each half shares what it records and what it forks nodes from,
and no more than two of their modules are in each other's way. All others are shared out by their files, what takes long
first.
"""

from __future__ import annotations

import signal
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from xdist.scheduler import LoadFileScheduling

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("explore", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("same", settings.get_profile("explore"), derandomize=True)
settings.load_profile("same")

_HERE = Path(__file__).resolve().parent
_GRAPHS = (_HERE / "graph", _HERE / "packaging")
_LONGEST = (
    "graph", "packaging", "adversary/test_car_fit.py", "sim/test_compilation.py", "evaluator", "benchmarks",
    "adversary",
)  # fmt: skip
"""Folders and files that are begun first, in this order: a long one at the end would leave the others idle."""


def _turn(item: pytest.Item) -> int:
    """Return the place of a test's file among those that are begun first."""
    places = (number for number, name in enumerate(_LONGEST) if item.path.is_relative_to(_HERE / name))
    return next(places, len(_LONGEST))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let a test of whole node graphs fail once; in a process of several, bring what takes long to the front."""
    for item in items:
        if any(item.path.is_relative_to(folder) for folder in _GRAPHS):
            item.add_marker(pytest.mark.flaky(reruns=1))
    if hasattr(config, "workerinput"):
        items.sort(key=_turn)


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
