"""The margins of many attempts of one car, searched by several processes until more ticks hardly change the mean.

Attempts share what they learn of the controller: some, spread over all, are searched first and teach the others; all of
them teach the next pass. Which ones come first does not depend on who searches or how fast.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.controllers import make_controller
from skd_sim.controllers.isolated import LostProcessError, isolated
from skd_sim.episode.episode import Episode

from skd_evaluator.campaign.plan.plan import Progress
from skd_evaluator.campaign.run.side_by_side import answers_batches
from skd_evaluator.campaign.run.workers import ExecutorRunner
from skd_evaluator.margin.search.picture import SITUATION, Picture
from skd_evaluator.margin.search.search import DEFAULT_BUDGET, SearchResult, search_margin
from skd_evaluator.margin.search.together import GROUP, can_be_together, search_side_by_side

LABEL: Final = "margins"
LIMIT: Final = 8 * DEFAULT_BUDGET
"""Of the budget of a pass, ticks."""
CHANGE: Final = 0.02
"""Of the mean, below which it has converged."""
_TEACHERS = (16, 64)  # attempts that are searched first, and next
_NEIGHBOURS = 2  # whose ways an attempt begins with
_POOL = 1000  # samples


@dataclass(frozen=True, eq=False)
class SearchJob:
    """One attempt to search; see `search_margin`."""

    episode: Episode
    budget: int
    ways: tuple[FloatArray, ...]
    samples: FloatArray | None


@dataclass(frozen=True, eq=False)
class SearchedMargins:
    """What was found of many attempts.

    Attributes:
        results: one result for each attempt: its way is that of the best pass, its ticks those of all passes, its trace
            that of the last.
        converged: whether twice as many ticks changed the mean by less than `CHANGE`, or nothing is left to find.
        budget: budget of the last pass, in ticks for each attempt.
        means: (budget, mean margin in m, none found counting as η_max) of the first pass's powers of two, then of each
            pass that followed.
    """

    results: list[SearchResult]
    converged: bool
    budget: int
    means: tuple[tuple[int, float], ...]

    @property
    def unfound(self) -> int:
        """Attempts in which no hit was found, and not everything was tried: there may be one."""
        return sum(one.way is None and not one.exhausted for one in self.results)


def search_attempt(job: SearchJob) -> SearchResult:
    """Do a job, in whatever process."""
    return isolated(job.episode.car.user_code, _search_attempt, job)


def _search_attempt(job: SearchJob) -> SearchResult:
    car = job.episode.car
    make = partial(make_controller, car.controller, car.multiplier)
    return search_margin(job.episode, job.budget, job.ways, make, job.samples)


def searched_margins(
    episodes: Sequence[Episode],
    ways: Sequence[Sequence[FloatArray]],
    runner: ExecutorRunner,
    progress: Progress,
    budget: int = DEFAULT_BUDGET,
    limit: int = LIMIT,
) -> SearchedMargins:
    """Search the margins of attempts, and again with twice the budget until the mean changes by less than `CHANGE`.

    Args:
        episodes: kamikaze mode, all with the same car.
        ways: for each episode ways to begin with, such as those of planned kamikazes; see `search_margin`.
        runner: searches, in several processes.
        progress: called with how far the work is.
        budget: budget of the first pass, in ticks for each attempt.
        limit: greatest budget of a pass, ticks.

    Raises:
        ValueError: there are no episodes, or not as many ways.
    """
    if not episodes or len(ways) != len(episodes):
        raise ValueError(f"{len(episodes)} episodes with ways of {len(ways)} have no mean margin")
    begins = [tuple(one) for one in ways]
    margins = _Margins(episodes, begins, runner, progress)
    for batch in _batches(len(episodes)):
        margins.search(batch, budget)
    cap = np.array([[episode.scenario.eta_max] for episode in episodes])
    curve = np.minimum([one.trace for one in margins.results], cap).mean(axis=0)
    means = [(1 << power, float(mean)) for power, mean in enumerate(curve)]
    if means[-1][0] != budget:
        means.append((budget, margins.mean))
    before = [mean for ticks, mean in means if 2 * ticks <= budget][-1:]
    while True:
        left = [index for index, one in enumerate(margins.results) if not one.exhausted]
        settled = bool(before) and abs(before[0] - margins.mean) <= CHANGE * before[0]
        if settled or not left or 2 * budget > limit:
            return SearchedMargins(margins.results, settled or not left, budget, tuple(means))
        budget, before = 2 * budget, [margins.mean]
        margins.search(left, budget)
        means.append((budget, margins.mean))


class _Margins:
    """The best of each attempt so far, and what is known of the controller."""

    def __init__(
        self,
        episodes: Sequence[Episode],
        ways: Sequence[tuple[FloatArray, ...]],
        runner: ExecutorRunner,
        progress: Progress,
    ) -> None:
        self._episodes, self._ways, self._runner, self._progress = episodes, ways, runner, progress
        self._found: dict[int, SearchResult] = {}
        self._together: bool | None = None  # not asked yet
        self._pool = Picture(None, episodes[0].scenario.control_periods > 1)
        self._phi = [
            b"" if episode.safe_trajectory is None else episode.safe_trajectory.positions.tobytes()
            for episode in episodes
        ]
        self._alike: dict[bytes, list[int]] = {}
        for index, phi in enumerate(self._phi):
            self._alike.setdefault(phi, []).append(index)

    @property
    def results(self) -> list[SearchResult]:
        """Of all attempts, once each was searched."""
        return [self._found[index] for index in range(len(self._episodes))]

    @property
    def mean(self) -> float:
        """Of the margins, m."""
        margins = [
            episode.scenario.eta_max if one.way is None else one.way.distance
            for episode, one in zip(self._episodes, self.results, strict=True)
        ]
        return float(np.mean(margins))

    def search(self, indices: Sequence[int], budget: int) -> None:
        """Search some attempts with what all before them have taught."""
        samples = self._pool.rows[: self._pool.count].copy()
        jobs = [SearchJob(self._episodes[index], budget, self._begins(index), samples) for index in indices]
        again = len(self._found) == len(self._episodes)
        label = f"{LABEL}, {budget} ticks each" if again else LABEL
        done, total = (0, len(jobs)) if again else (len(self._found), len(self._episodes))
        for index, result in zip(indices, self._searched(jobs), strict=True):
            before = self._found.get(index)
            self._found[index] = result if before is None else _better(before, result)
            done += 1
            self._progress(label, done, total)
            for row in result.samples:
                if self._pool.count < _POOL:
                    self._pool.learn(row[:SITUATION], float(row[SITUATION]))

    def _searched(self, jobs: Sequence[SearchJob]) -> Iterator[SearchResult]:
        """Yield the results of jobs, in their order; those of a policy that takes batches are done side by side."""
        if self._together is None:
            car = self._episodes[0].car
            self._together = can_be_together(self._episodes[0]) and next(iter(self._runner.map(answers_batches, [car])))
        if not self._together:
            yield from self._runner.map(search_attempt, jobs)
            return
        groups = [jobs[at : at + GROUP] for at in range(0, len(jobs), GROUP)]
        for group, found in zip(groups, self._runner.map(_searched_group, groups, _not_searched), strict=True):
            yield from found or self._runner.map(search_attempt, group)

    def _begins(self, index: int) -> tuple[FloatArray, ...]:
        before = self._found.get(index)
        own = () if before is None or before.way is None else (before.way.trajectory.positions,)
        return (*own, *self._ways[index], *self._of_neighbours(index))

    def _of_neighbours(self, index: int) -> list[FloatArray]:
        """Return the least ways that were found in other attempts of the same safe trajectory."""
        found = [
            one.way
            for other in self._alike[self._phi[index]]
            if other != index and (one := self._found.get(other)) is not None and one.way is not None
        ]
        found.sort(key=lambda way: way.distance)
        return [way.trajectory.positions for way in found[:_NEIGHBOURS]]


def _searched_group(group: Sequence[SearchJob]) -> list[SearchResult]:
    try:
        return search_side_by_side(group)
    except LostProcessError as error:
        return _not_searched(group, error.reason)


def _not_searched(_group: Sequence[SearchJob], _reason: str) -> list[SearchResult]:
    return []


def _batches(count: int) -> list[list[int]]:
    """Return the attempts in the parts in which they are searched: some that are spread over all, then the others."""
    left, batches = list(range(count)), []
    for size in _TEACHERS:
        if len(left) <= size:
            break
        chosen = left[:: -(-len(left) // size)]
        batches.append(chosen)
        left = [index for index in left if index not in set(chosen)]
    return [*batches, left]


def _better(before: SearchResult, after: SearchResult) -> SearchResult:
    """Return the later result with the better way of both, and the ticks of both."""
    least = math.inf if before.way is None else before.way.distance
    keep = after.way is None or after.way.distance > least
    return replace(
        after,
        way=before.way if keep else after.way,
        trace=np.minimum(after.trace, least),
        simulated_ticks=before.simulated_ticks + after.simulated_ticks,
    )
