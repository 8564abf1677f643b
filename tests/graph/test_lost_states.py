"""An evaluator that is kept from listening for a while loses no states; where some are lost, it says so, and soon."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing.context import ForkServerContext
from pathlib import Path

import pytest
from common import PATIENCE
from graph_nodes import ADVERSARY, CONTROLLER, SIMULATOR, evaluator, running, start_node
from graph_support import assert_same_log
from skd_evaluator.assessment.run.episodes import run_episode
from skd_evaluator.ros import evaluator as evaluator_module
from skd_evaluator.ros.evaluator import Evaluator
from skd_sim.world.episode import AbortKind, Episode, Outcome, kind_of

PERIODS = 100
"""The car's decisions in a tick: an episode of nine ticks has some 800 states."""


@contextmanager
def graph(context: ForkServerContext, domain: int, folder: Path) -> Iterator[Evaluator]:
    modules = (SIMULATOR, CONTROLLER, ADVERSARY)
    nodes = [start_node(context, module, folder / module, domain) for module in modules]
    with running(*nodes), evaluator(own_world=True) as node:
        yield node


def deaf(node: Evaluator, monkeypatch: pytest.MonkeyPatch, seconds: float) -> Callable[[], bool]:
    """Keep the evaluator from listening for a while, once it has heard the first state; return whether it was."""
    listen, was = node._spin, list[bool]()

    def spin(timeout: float) -> None:
        if not was and node._samples.car:
            was.append(True)
            time.sleep(seconds)
        listen(timeout)

    monkeypatch.setattr(node, "_spin", spin)
    return lambda: bool(was)


def test_states_wait_for_an_evaluator_that_is_kept_from_listening(
    context: ForkServerContext, domain: int, tmp_path: Path, replay: Episode, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = replace(replay.scenario, control_period=replay.scenario.time_step / PERIODS)
    often = replace(replay, scenario=scenario)
    expected = run_episode(often)
    assert len(expected.car) * PERIODS > 500
    with graph(context, domain, tmp_path) as node:
        first = node.run_episode(often)
        was_deaf = deaf(node, monkeypatch, 3.0)
        second = node.run_episode(replace(often, episode_id=often.episode_id + 1))
        assert was_deaf()
    assert_same_log(first, expected)
    assert second.reason == ""
    assert_same_log(second, run_episode(replace(often, episode_id=often.episode_id + 1)))


def test_what_is_lost_all_the_same_is_said_and_soon(
    context: ForkServerContext, domain: int, tmp_path: Path, replay: Episode, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluator_module, "_LOST", 1.0)
    with graph(context, domain, tmp_path) as node:
        keep, count = node._samples.add_car, iter(range(10_000))

        def loses_the_third(stamp: int, *state: float) -> None:
            if next(count) != 2:
                keep(stamp, *state)

        monkeypatch.setattr(node._samples, "add_car", loses_the_third)
        begin = time.monotonic()
        log = node.run_episode(replay)
        took = time.monotonic() - begin
    assert log.outcome == Outcome.ABORTED
    assert kind_of(log.reason) == AbortKind.LOST
    assert "the episode ended, and 1 of its " in log.reason
    assert took < PATIENCE
