"""Nodes as processes forked from one that has imported everything: the order of starts is the order of joining."""

from __future__ import annotations

import contextlib
import gc
import importlib
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from multiprocessing.context import ForkServerContext, ForkServerProcess
from pathlib import Path
from typing import TYPE_CHECKING

from common import PATIENCE

if TYPE_CHECKING:
    from skd_evaluator.ros.evaluator import Evaluator

SIMULATOR = "skd_sim.ros.simulator_node"
CONTROLLER = "skd_sim.ros.controller_node"
ADVERSARY = "skd_adversary.ros.adversary_node"
EVALUATOR = "skd_evaluator.ros.evaluator_node"
NODES = (SIMULATOR, CONTROLLER, ADVERSARY, EVALUATOR)
_PRELOAD = "SKD_TEST_PRELOAD"
_imported_by = os.getpid()
_lock = threading.Lock()
"""multiprocessing, when it starts a process, also asks after all others; two threads must not do that at once."""


def _run(module: str, arguments: Sequence[str], environment: Mapping[str, str], log: str) -> None:
    os.environ.update(environment)
    output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    sys.exit(importlib.import_module(module).main(list(arguments)))


def _see_who_imported() -> None:
    sys.exit(0 if _imported_by == os.getppid() else 1)


def fork_server() -> ForkServerContext:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    os.environ[_PRELOAD] = "1"
    folders = Path(__file__).parents[:2]
    there = filter(None, [os.environ.get("PYTHONPATH")])  # an empty entry would be the working folder
    os.environ["PYTHONPATH"] = os.pathsep.join([*map(str, folders), *there])
    process = context.Process(target=_see_who_imported)
    process.start()
    process.join()
    del os.environ[_PRELOAD]
    # a server that fails to import goes on without a word, and every node imports everything anew
    assert process.exitcode == 0
    return context


def start_node(
    context: ForkServerContext, module: str, log: Path, domain: int, *words: str, **parameters: object
) -> ForkServerProcess:
    arguments = [*words, "--ros-args"] if parameters else list(words)
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    environment = {"ROS_DOMAIN_ID": str(domain)}
    name = f"{module} {' '.join(words)} ({log.name})"
    process = context.Process(target=_run, args=(module, arguments, environment, str(log)), name=name, daemon=True)
    with _lock:
        process.start()
    return process


def wait_for_end(process: ForkServerProcess, timeout: float = PATIENCE) -> int | None:
    """Return a process's exit code; none if it still runs after a while."""
    end = time.monotonic() + timeout
    while True:
        with _lock:
            code = process.exitcode
        if code is not None or time.monotonic() > end:
            return code
        time.sleep(0.01)


@contextlib.contextmanager
def running(*processes: ForkServerProcess) -> Iterator[None]:
    """End nodes, whatever happens; each ends well on SIGTERM."""
    try:
        yield
    finally:
        for process in processes:
            process.terminate()
        codes = {process.name: wait_for_end(process) for process in processes}
        for process in processes:
            process.kill()
            wait_for_end(process)
    assert {name: code for name, code in codes.items() if code != 0} == {}


@contextlib.contextmanager
def evaluator(
    record_to: Path | None = None, *, silence_limit: float = PATIENCE, own_world: bool = False
) -> Iterator[Evaluator]:
    """The evaluator of a graph whose other nodes somebody starts, in this process."""
    from skd_evaluator.ros.evaluator import Evaluator

    node = Evaluator()
    node.begin_campaign("test", record_to=record_to, silence_limit=silence_limit, own_world=own_world)
    try:
        yield node
    finally:
        node.destroy_node()


if os.environ.get(_PRELOAD):
    importlib.import_module("shortened").shorten()
    for _module in NODES:
        importlib.import_module(_module)
    importlib.import_module(ADVERSARY).warm_up()
    gc.freeze()  # or collecting would copy every page into each node
