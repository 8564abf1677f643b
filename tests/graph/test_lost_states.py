"""An evaluator that is kept from listening for a while loses no states; where some are lost, it says so, and soon."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.context import ForkServerContext
from pathlib import Path

import pytest
from common import PATIENCE
from graph_nodes import ADVERSARY, CONTROLLER, SIMULATOR, evaluator, running, start_node
from skd_evaluator.ros import evaluator as evaluator_module
from skd_evaluator.ros.evaluator import Evaluator
from skd_sim.world.episode import AbortKind, EpisodeSpec, Outcome, kind_of
from skd_sim.world.state import CarState


@contextmanager
def graph(context: ForkServerContext, domain: int, folder: Path) -> Iterator[Evaluator]:
    modules = (SIMULATOR, CONTROLLER, ADVERSARY)
    nodes = [start_node(context, module, folder / module, domain) for module in modules]
    with running(*nodes), evaluator(own_world=True) as node:
        yield node


def test_what_is_lost_all_the_same_is_said_and_soon(
    context: ForkServerContext, domain: int, tmp_path: Path, replay: EpisodeSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluator_module, "_LOST", 1.0)
    with graph(context, domain, tmp_path) as node:
        keep, stamps = node._samples.add_car, list[int]()

        def loses_the_third(stamp: int, state: CarState) -> None:
            if stamp not in stamps:
                stamps.append(stamp)
            if stamps.index(stamp) != 2:  # a simulator that waits for a command sends its state again
                keep(stamp, state)

        monkeypatch.setattr(node._samples, "add_car", loses_the_third)
        begin = time.monotonic()
        log = node.run_episode(replay)
        took = time.monotonic() - begin
    assert log.outcome == Outcome.ABORTED
    assert kind_of(log.reason) == AbortKind.LOST
    assert "the episode ended, and 1 of its " in log.reason
    assert took < PATIENCE
