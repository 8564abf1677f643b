"""Graphs side by side, of which the first may come last; the graphs here are made of nothing."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from skd_evaluator.errors import AssessmentError
from skd_evaluator.ros.evaluator import Evaluator
from skd_evaluator.ros.graph import GraphPool
from skd_evaluator.ros.processes import AbortedEpisodes
from skd_sim.scenario.scenario import load_scenario
from skd_sim.world.episode import Episode, EpisodeLog, Mode, Outcome

EPISODE = Episode(load_scenario("crossing"), Mode.SAFE, 0, 0)


class Graphs:
    """The second is there at once, the first when it may."""

    def __init__(self, error: AssessmentError | None = None) -> None:
        self.may, self.published, self._error = threading.Event(), list[tuple[int, Any]](), error

    @contextmanager
    def make(self, number: int, _refuse_to_go_on: Callable[[], None]) -> Iterator[Evaluator]:
        if number == 0:
            assert self.may.wait(20.0)
            if self._error is not None:
                raise self._error
        yield cast(
            Evaluator,
            SimpleNamespace(
                prepare=lambda _patience: None,
                run_episode=lambda one: EpisodeLog(one, Outcome.ABORTED, np.empty((0, 2)), np.empty((0, 3))),
                publish_assessment=lambda rating: self.published.append((number, rating)),
            ),
        )


def _pool(graphs: Graphs) -> GraphPool:
    return GraphPool(2, graphs.make, cast(AbortedEpisodes, SimpleNamespace(note=lambda _log: None)), 1.0)


def test_an_assessment_waits_for_the_graph_in_which_it_is_published() -> None:
    """All episodes ran in the other one, as when little is left of a campaign that is resumed."""
    graphs, rating = Graphs(), cast(Any, object())
    with _pool(graphs) as pool:
        assert len(list(pool.run([EPISODE]))) == 1
        threading.Timer(0.2, graphs.may.set).start()
        pool.publish_assessment(rating)
    assert graphs.published == [(0, rating)]


def test_a_first_graph_that_cannot_start_ends_the_wait() -> None:
    graphs = Graphs(AssessmentError("no graph"))
    graphs.may.set()
    with _pool(graphs) as pool, pytest.raises(AssessmentError, match="no graph"):
        pool.publish_assessment(cast(Any, object()))
