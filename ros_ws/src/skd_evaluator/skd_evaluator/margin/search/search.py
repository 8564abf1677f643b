"""The margins of many trials of one car, searched in rounds of twice the effort until more of it hardly changes them.

What is found in one trial is offered to the others: within a group of trials of one φ at once, to other groups after
each round. How far the mean may still be too high is estimated by searching some trials, drawn at random, several times
as deep. What is found depends on the seed alone, not on who searches or how fast.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from skd_sim.arrays import FloatArray, IntArray
from skd_sim.world.episode import EpisodeLog, EpisodeSpec

from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.candidates import ActionSpace
from skd_evaluator.margin.search.group import OTHER, SOURCES, Brought, Group
from skd_evaluator.margin.search.trial import Trial
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.metrics.margins import CONVERGED_WITHIN, Excess, Search

CHANGE: Final = 0.02
"""Of the mean, below which it may have converged: in the last two doublings, and in the three beyond of deep trials."""
DEEPER: Final = 8
"""Times as deep some trials are searched."""
_DEEP_TRIALS: Final = 24
_FEW: Final = 64  # trials
_EXCESS: Final = 0.01, CONVERGED_WITHIN
"""Of the mean: estimated error of a search that has converged, and with its standard error."""
_SAME_PHI, _OTHER_PHI = 8, 4  # sequences that a group is offered from others after each round


class Effort(NamedTuple):
    """How much is searched.

    Attributes:
        first: candidates a trial in the first round.
        limit: candidates a trial at most, but for those that are searched deeper.
        excursions: candidates a trial to begin with.
        free_plans: whether driving takes so long that planning does not count.
        deepens: whether some trials are searched several times as deep; without it no search has converged.
    """

    first: int = 16
    limit: int = 512
    excursions: int = 12
    free_plans: bool = False
    deepens: bool = True


IN_PROCESS: Final = Effort()
WHOLE_EPISODES: Final = Effort(first=8, limit=64, excursions=2, free_plans=True)
"""Of a stack behind the node graph."""
HELD_COMMANDS: Final = Effort(first=4, limit=16, excursions=2, free_plans=True, deepens=False)
"""Of one that does not answer each state: an episode may take as long as it simulates, and no hit is certain."""


@dataclass(frozen=True, eq=False)
class SearchedMargins:
    """What was found.

    Attributes:
        hits: for each trial the hit of least deviation; None: none was found within η_max.
        episodes: the episodes that ended in them.
        search: how they were searched for.
        means: (candidates a trial, mean margin in m) after each round.
        driven: episodes that were driven in all trials.
        reasons: why some of them were aborted, one each.
    """

    hits: list[Hit | None]
    episodes: list[EpisodeSpec | None]
    search: Search
    means: tuple[tuple[int, float], ...]
    driven: int
    reasons: tuple[str, ...]


Rounds = Callable[[Sequence[Group], int, str], list[Group]]
"""Searches groups until so many candidates a trial are spent, and returns them as they are then, in order; the last
argument says what the round is for, in a progress line."""


def search_margins(
    episodes: Sequence[EpisodeSpec],
    known: Mapping[int, Sequence[EpisodeLog]],
    rounds: Rounds,
    effort: Effort = IN_PROCESS,
) -> SearchedMargins:
    """Return the margins of trials.

    Args:
        episodes: the trials: kamikaze mode, all of one car, at least one.
        known: what happened to kamikazes in them, by the id of the episode.
        rounds: searches.
        effort: how much is searched.

    Raises:
        AssessmentError: the car fails.
    """
    searched = _Search(episodes, known, rounds, effort)
    means = [(0, searched.mean)]
    scaled = effort.first * max(1, _FEW // len(episodes))  # where trials are few, they learn little from one another
    budget = min(max(effort.first, min(effort.limit // 4, scaled)), effort.limit)
    while True:
        searched.round(budget)
        means.append((budget, searched.mean))
        if searched.is_done:
            return searched.result(True, budget, None, means)
        last = 2 * budget > effort.limit
        latest = [mean for _, mean in means[-3:]]
        steady = len(means) > 3 and all(map(_near, latest[1:], latest)) and searched.has_all_hits
        if last and not effort.deepens:
            return searched.result(False, budget, None, means)
        if effort.deepens and (steady or last):
            shallow = searched.mean
            excess, brought = searched.deepen(budget)
            least, most = (share * searched.mean for share in _EXCESS)
            good = brought <= CHANGE * shallow and excess.mean <= least and excess.mean + excess.error <= most
            if last or good:
                return searched.result(steady and good, budget, excess, means)
        budget *= 2


class OtherHit(NamedTuple):
    """A trajectory on which another car hits.

    Attributes:
        safe: φ from which it deviates, n × 2, m.
        positions: at ticks, the last at the end of the tick of the contact, n × 2, m.
    """

    safe: FloatArray
    positions: FloatArray


def margins_with_other_hits(
    episodes: Sequence[EpisodeSpec], known: Mapping[int, EpisodeLog], hits: Sequence[OtherHit], rounds: Rounds
) -> list[float]:
    """Return the margins of trials, m, in which hits of others are tried too; nothing further is searched.

    Each trial meets all hits of its own φ. Where there is none of it, it meets the first hit of each other φ, with the
    same actions.

    Args:
        episodes: the trials, as of `search_margins`.
        known: the best hit of each trial that has one, by the id of its episode.
        hits: what else is tried, best first.
        rounds: drives.

    Raises:
        AssessmentError: the car fails.
    """
    searched = _Search(episodes, {}, rounds, Effort(excursions=0))
    searched.begin_with(known, hits)
    searched.round(0)
    return searched.margins


def _near(after: float, before: float) -> bool:
    return abs(before - after) <= CHANGE * before


class _Search:
    """All groups, one for each number of φ."""

    def __init__(
        self,
        episodes: Sequence[EpisodeSpec],
        known: Mapping[int, Sequence[EpisodeLog]],
        rounds: Rounds,
        effort: Effort,
    ) -> None:
        self._rounds = rounds
        order: dict[tuple[int, bytes], list[EpisodeSpec]] = {}
        for episode in episodes:
            assert episode.safe_trajectory is not None
            number, path = episode.episode_id >> 32, episode.safe_trajectory.positions.tobytes()
            order.setdefault((number, path), []).append(episode)
        self._groups = [Group(group, effort.excursions, effort.free_plans) for group in order.values()]
        self._place = [episode.episode_id for episode in episodes]
        self._rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(episodes[0].seed)))
        self._deep: list[Group] = []
        for group in self._groups:
            for trial in group.trials:
                for log in known.get(trial.episode.episode_id, ()):
                    trial.learn(None, log)
                    if log.hit:
                        group.offer(group.space.actions_along(log.trajectory.positions), OTHER)

    @property
    def _trials(self) -> list[Trial]:
        return [trial for group in self._groups for trial in group.trials]

    def begin_with(self, known: Mapping[int, EpisodeLog], hits: Sequence[OtherHit]) -> None:
        """Take the best hit of each trial, by the id of its episode, and offer hits of others, best first."""
        for trial in self._trials:
            if trial.episode.episode_id in known:
                trial.learn(None, known[trial.episode.episode_id])
        spaces = {one.space.path.tobytes(): one.space for one in self._groups}
        offers: dict[bytes, list[IntArray]] = {}
        for safe, positions in hits:
            path = np.ascontiguousarray(safe).tobytes()
            space = spaces.setdefault(path, ActionSpace(self._groups[0].space.scenario, safe))
            stays = np.concatenate([positions, positions[-1:]])  # so that the tick of the contact counts in full
            offers.setdefault(path, []).append(space.actions_along(stays))
        firsts = [of_path[0] for of_path in offers.values()]
        for group in self._groups:
            for actions in reversed(offers.get(group.space.path.tobytes(), firsts)):  # the last offer is tried first
                group.offer(actions, OTHER)

    @property
    def margins(self) -> list[float]:
        """The margin of each trial, m, in the order of the episodes; η_max where no hit was found."""
        trials = {trial.episode.episode_id: trial.least for trial in self._trials}
        return [trials[one] for one in self._place]

    @property
    def mean(self) -> float:
        """Mean margin, m; a trial without a hit counts as η_max."""
        return float(np.mean([trial.least for trial in self._trials]))

    @property
    def is_done(self) -> bool:
        """Whether nothing less can be found."""
        return all(group.is_done for group in self._groups)

    @property
    def has_all_hits(self) -> bool:
        """Whether a hit was found in each trial; one without is unfinished."""
        return all(trial.best is not None for trial in self._trials)

    def round(self, budget: int) -> None:
        """Search until so many candidates a trial are spent, and share what was found."""
        self._groups = self._rounds(self._groups, budget, f"{budget} candidates a trial")
        if self._aborted == sum(trial.driven for trial in self._trials):
            raise AssessmentError(f"every candidate was aborted ({self._groups[0].reasons[0]})")
        self._share(self._groups)

    @property
    def _aborted(self) -> int:
        return sum(len(group.reasons) for group in self._groups)

    def _share(self, sources: Sequence[Group]) -> None:
        """Offer the best hits of each group to all groups: most to those of the same φ."""
        paths = [group.space.path.tobytes() for group in self._groups]
        best = [(source.space.path.tobytes(), actions) for source in sources for actions in source.found[:_SAME_PHI]]
        firsts = [(source.space.path.tobytes(), source.found[0]) for source in sources if source.found]
        for path, group in zip(paths, self._groups, strict=True):
            mine = [actions for of, actions in best if of == path][: 2 * _SAME_PHI]
            others = [actions for of, actions in firsts if of != path]
            drawn = self._rng.permutation(len(others))[:_OTHER_PHI].tolist()
            for actions in (*mine, *(others[number] for number in drawn)):
                group.offer(actions, OTHER)

    def deepen(self, budget: int) -> tuple[Excess, float]:
        """Search some trials several times as deep and share what was found.

        Returns:
            What that says of the mean, and by how much the mean of those trials fell, m.
        """
        trials = self._trials
        before = {trial.episode.episode_id: trial.least for trial in trials}
        if not self._deep:
            chosen = self._rng.permutation(len(trials))[: min(_DEEP_TRIALS, len(trials))]
            ids = {trials[number].episode.episode_id for number in chosen.tolist()}
            self._deep = [group.part(ids) for group in self._groups]
            self._deep = [group for group in self._deep if group.trials]
        else:
            for group in self._deep:
                group.take({trial.episode.episode_id: trial for trial in trials})
        self._deep = self._rounds(self._deep, DEEPER * budget, f"{DEEPER * budget} candidates in some trials")
        deep = {trial.episode.episode_id: trial for group in self._deep for trial in group.trials}
        gains = np.array([before[number] - min(before[number], trial.least) for number, trial in deep.items()])
        for group in self._groups:
            group.take(deep)
        self._share(self._deep)
        self._groups = self._rounds(self._groups, budget, "hits of those trials in the others")  # the budget is spent
        rest = [
            before[one.episode.episode_id] - one.least for one in self._trials if one.episode.episode_id not in deep
        ]
        # What deeper search brought was offered to the rest, too: what that did not bring there is still missing.
        missing = gains.mean() - (np.mean(rest) if rest else 0.0)
        share = len(rest) / len(trials) if rest else 1.0
        error = float(gains.std(ddof=1)) / math.sqrt(len(gains)) if rest and len(gains) > 1 else 0.0
        return Excess(share * max(0.0, float(missing)), share * error, len(gains)), float(gains.mean())

    def result(
        self, converged: bool, budget: int, excess: Excess | None, means: Sequence[tuple[int, float]]
    ) -> SearchedMargins:
        """Return what was found."""
        trials = {trial.episode.episode_id: trial for trial in self._trials}
        found, groups = [trials[one] for one in self._place], (*self._groups, *self._deep)
        sources = tuple({"source": source, **_sum([group.brought[source] for group in groups])} for source in SOURCES)
        return SearchedMargins(
            [one.best for one in found],
            [one.hit for one in found],
            Search(budget, converged, excess, sources),
            tuple(means),
            sum(trial.driven for group in groups for trial in group.trials),
            tuple(reason for group in groups for reason in group.reasons),
        )


def _sum(brought: Sequence[Brought]) -> dict[str, int | float]:
    return {
        "candidates": sum(one.candidates for one in brought),
        "hits": sum(one.hits for one in brought),
        "lowered": math.fsum(one.lowered for one in brought),
    }
