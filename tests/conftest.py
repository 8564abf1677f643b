"""What holds for all tests.

A suite that a shell started in the background ignores SIGINT, and so would every program that a test interrupts.
Hypothesis tries the same examples in each run and does not mind how long one takes; new ones are tried with
`--hypothesis-profile=explore`.

Side by side, those of tests/graph run in two processes: each half shares what it records and what it forks nodes from,
and no more than two of their modules are in each other's way. All others are shared out by their files, what takes long
first.
"""

from __future__ import annotations

import gc
import os
import signal
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from xdist.scheduler import LoadFileScheduling

gc.disable()  # until all is imported, which stays: to look for garbage in it takes longer than some tests

os.environ.pop("COLUMNS", None)  # of pytest-xdist: commands would fit their tables into 80 columns

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("explore", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("same", settings.get_profile("explore"), derandomize=True)
settings.load_profile("same")

_HERE = Path(__file__).resolve().parent
_LONGEST = (
    "graph", "packaging", "documentation", "adversary/test_car_fit.py", "sim/test_kernels.py",
    "evaluator", "benchmarks", "adversary",
)  # fmt: skip
"""Folders and files that are begun first, in this order: a long one at the end would leave the others idle."""


@pytest.fixture(scope="session", autouse=True)
def shortened() -> None:
    """Let only tests that look at pictures draw them, and drive few harmless runs."""
    from shortened import shorten  # which imports much: not in the process that only hands out tests

    shorten()


@pytest.fixture
def pictures_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    import vl_convert
    from shortened import CHART, DRAW, Figure

    monkeypatch.setattr(Figure, "savefig", DRAW)
    monkeypatch.setattr(vl_convert, "vegalite_to_png", CHART)


@pytest.fixture
def skd_here(tmp_path, monkeypatch, capsys):
    """`skd` in this process, for cases of which one in a process of its own shows enough: Python's start takes long."""
    from common import run_skd

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        monkeypatch.chdir(tmp_path)
        capsys.readouterr()
        code = run_skd(*arguments)
        return subprocess.CompletedProcess(arguments, code, *capsys.readouterr())

    return run


@pytest.fixture(scope="session")
def safe(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a safe trajectory that needs no planner: straight across."""
    folder = tmp_path_factory.mktemp("safe")
    rows = [f"{0.3 * tick!r},{-3.5 + 0.75 * tick!r},0.0" for tick in range(9)]
    (folder / "across.csv").write_text("t,x,y\n" + "\n".join(rows) + "\n")
    return folder


def _turn(item: pytest.Item) -> int:
    """Return the place of a test's file among those that are begun first."""
    places = (number for number, name in enumerate(_LONGEST) if item.path.is_relative_to(_HERE / name))
    return next(places, len(_LONGEST))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """In a process of several, bring what takes long to the front."""
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
                return f"graph, {'first' if name < 'test_ev' else 'second'} half"
            return super()._split_scope(nodeid)

    return Scheduler(config, log) if config.getoption("dist") == "loadfile" else None
