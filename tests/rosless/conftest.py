"""Fixtures of the tests of rosless."""

from __future__ import annotations

import itertools
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "rosless" / "src"))

from common import new_domain
from rosless.context import Context
from rosless.executors import SingleThreadedExecutor
from rosless.node import Node
from rosless_support import PRELUDE, Process


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A domain of this test's own, also for the processes that it starts."""
    number = new_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    for variable in ("ROSLESS_ARGS", "ROSLESS_MSG_PATH", "CYCLONEDDS_URI", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.delenv(variable, raising=False)
    return number


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Process]]:
    """Start a program given as text; whatever still runs at the end of the test is killed."""
    started: list[Process] = []
    numbers = itertools.count()

    def _start(text: str, *arguments: str, **environment: str) -> Process:
        path = tmp_path / f"program_{next(numbers)}.py"
        path.write_text(PRELUDE + textwrap.dedent(text))
        process = Process(path, list(arguments), environment)
        started.append(process)
        return process

    yield _start
    for process in started:
        process.stop()


@pytest.fixture
def context(domain: int) -> Iterator[Context]:
    """An initialised context without arguments."""
    made = Context()
    made.init(args=[], domain_id=domain)
    yield made
    made.try_shutdown()
    made.destroy()


@pytest.fixture
def executor(context: Context) -> Iterator[SingleThreadedExecutor]:
    """An executor without nodes."""
    with SingleThreadedExecutor(context=context) as made:
        yield made


@pytest.fixture
def node(context: Context, executor: SingleThreadedExecutor) -> Iterator[Node]:
    """The node /ns/car, which the executor runs."""
    made = Node("car", context=context, namespace="ns")
    executor.add_node(made)
    yield made
    made.destroy_node()
