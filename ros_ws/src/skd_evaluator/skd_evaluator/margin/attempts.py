"""Placeholder until the search is merged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from skd_sim.episode import Episode
from skd_sim.trajectory import FloatArray

from skd_evaluator.campaign.executor_runner import ExecutorRunner
from skd_evaluator.campaign.plan import Progress
from skd_evaluator.floor.anytime import anytime_floor
from skd_evaluator.margin.least_way import LeastWay


@dataclass
class One:
    """One."""

    way: LeastWay | None


@dataclass
class Searched:
    """Found."""

    results: list[One]
    budget: int
    converged: bool


def _one(episode: Episode) -> One:
    found = anytime_floor(episode, 200)
    if found is None or found.distance >= episode.scenario.eta_max:
        return One(None)
    return One(LeastWay(found.distance, found.trajectory, found.duration, 1.0, float("inf")))


def searched_margins(
    episodes: Sequence[Episode],
    ways: Sequence[Sequence[FloatArray]],
    runner: ExecutorRunner,
    progress: Progress,
    *,
    limit: int,
) -> Searched:
    """Search."""
    return Searched(list(runner.map(_one, episodes)), 200, False)
