"""The margins of many trials of one car, searched in rounds of twice the effort until more of it hardly changes them.

What is found in one trial is offered to the others: within a group of trials of one φ at once, to other groups after
each round. How far the mean may still be too high is estimated by searching some trials, drawn at random, several times
as deep. What is found depends on the seed alone, not on who searches or how fast.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from skd_sim.errors import AssessmentError
from skd_sim.world.episode import EpisodeLog, EpisodeSpec
from skd_sim.world.state import FloatArray, IntArray

from skd_evaluator.assessment.options import DEFAULT_MARGIN_LIMIT
from skd_evaluator.margin.search.candidates import ActionSpace
from skd_evaluator.margin.search.group import OTHER, SOURCES, Group
from skd_evaluator.margin.search.trial import Trial
from skd_evaluator.metrics.deviation import Hit
from skd_evaluator.metrics.margins import CONVERGED_WITHIN, Excess, Search

CHANGE: Final = 0.02
"""Of the mean, below which it may have converged: in each of the last two doublings, and in the three beyond of trials
that are searched deeper."""
DEEPER: Final = 8
"""Times as deep some trials are searched, or all where they are few."""
DEEP_TRIALS: Final = 20
_FEW: Final = 64  # trials
_HARD: Final = 0.25, 3.0
"""Share of the trials, those of greatest margin, and how many times as hard they are searched as the others: there most
is to be gained."""
_EXCESS: Final = 0.01, CONVERGED_WITHIN
"""Of the mean: estimated error of a search that has converged, and with its standard error."""
_UNCHANGED: Final = 0.01  # of the mean margin of an earlier version
_AT_LEAST: Final = 64  # candidates a trial where the mean is another than that
_SAME_PHI, _OTHER_PHI = 8, 4  # sequences that a group is offered from others after each round


class Effort(NamedTuple):
    """How much is searched.

    Attributes:
        first: candidates a trial in the first round.
        limit: candidates a trial at most, but for those that are searched deeper.
        excursions: candidates a trial to begin with.
        deepens: whether some trials are searched several times as deep; without it no search has converged.
    """

    first: int = 16
    limit: int = DEFAULT_MARGIN_LIMIT
    excursions: int = 12
    deepens: bool = True


IN_PROCESS: Final = Effort()
WARM_START: Final = Effort(first=2, excursions=2)
"""Of one whose earlier version has been searched; see `Earlier`."""
WHOLE_EPISODES: Final = Effort(first=8, limit=128, excursions=2)
"""Of a stack behind the node graph."""
HELD_COMMANDS: Final = Effort(first=4, limit=16, excursions=2, deepens=False)
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


class Earlier(NamedTuple):
    """What is known of an earlier version of a car: a search from its hits on stops early where the mean is the same.

    Attributes:
        logs: what happens to the car on its hits, by the id of the trial.
        mean: its margin, m; None where it is of other trials.
    """

    logs: Mapping[int, EpisodeLog]
    mean: float | None


KnownLogs = Mapping[int, Sequence[EpisodeLog]]
"""What happened to kamikazes, by the id of the episode."""
Rounds = Callable[[Sequence[Group], str], list[Group]]
"""Searches groups up to their goals, and returns them as they are then, in order; the last argument says what the round
is for, in a progress line."""


def search_margins(
    episodes: Sequence[EpisodeSpec],
    known: KnownLogs,
    rounds: Rounds,
    effort: Effort = IN_PROCESS,
    earlier: Earlier | None = None,
) -> SearchedMargins:
    """Return the margins of trials.

    Args:
        episodes: the trials: kamikaze mode, all of one car, φ by φ, at least one.
        known: what happened to kamikazes in them.
        rounds: searches.
        effort: how much is searched.
        earlier: what is known of an earlier version of the car.

    Raises:
        AssessmentError: the car fails.
    """
    searched = _Search(episodes, known, rounds, effort.excursions)
    if earlier is not None:
        searched.begin_with(earlier.logs)
    few = effort.deepens and len(episodes) <= DEEP_TRIALS
    limit = effort.limit * (DEEPER if few else 1)
    scaled = effort.first * max(1, _FEW // len(episodes))  # where trials are few, they learn little from one another
    budget = min(max(effort.first, min(limit // 4, scaled)), limit)
    means = [(0, searched.mean)]
    excess: Excess | None = None
    while True:
        before = searched.margins
        searched.round(budget)
        means.append((budget, searched.mean))
        if searched.is_done:
            return searched.result(True, budget, None, means)
        last, latest = 2 * budget > limit, [mean for _, mean in means[1:]]
        small = [_near(after, before) for before, after in itertools.pairwise(latest[-3:])]
        steady = searched.has_all_hits and len(small) == 2 and all(small)
        if earlier is not None and budget < _AT_LEAST:
            steady &= earlier.mean is not None and abs(latest[-1] - earlier.mean) <= _UNCHANGED * earlier.mean
        good = False
        if few:
            excess = _excess(before - searched.margins)
            good = steady and len(latest) > 3 and _near(latest[-1], latest[-4])
        elif effort.deepens and (steady or last):
            excess, brought = searched.deepen(budget)
            least, most = (share * searched.mean for share in _EXCESS)
            good = steady and brought <= CHANGE * latest[-1]
            good &= excess.mean <= least and excess.mean + excess.error <= most
        if last or good:
            return searched.result(good, min(budget, effort.limit), excess, means)
        budget *= 2


def _near(after: float, before: float) -> bool:
    return before - after <= CHANGE * before


def _excess(gains: FloatArray, already: float = 0.0, share: float = 1.0) -> Excess:
    """Return what is missing in a share of the trials where others gained so much (m), of which they have a part."""
    error = float(gains.std(ddof=1)) / math.sqrt(len(gains)) if len(gains) > 1 else 0.0
    return Excess(share * max(0.0, float(gains.mean()) - already), share * error, len(gains))


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
) -> FloatArray:
    """Return the margins of trials, m, in which hits of another car are tried too; nothing further is searched.

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
    searched = _Search(episodes, {number: [log] for number, log in known.items()}, rounds, 0)
    searched.offer(hits)
    searched.round(0)
    return searched.margins


class _Search:
    """All groups, one for each number of φ."""

    def __init__(
        self,
        episodes: Sequence[EpisodeSpec],
        known: Mapping[int, Sequence[EpisodeLog]],
        rounds: Rounds,
        excursions: int,
    ) -> None:
        self._rounds = rounds
        groups = itertools.groupby(episodes, key=lambda one: one.episode_id >> 32)
        self._groups = [Group(list(group), excursions) for _, group in groups]
        self._rng = np.random.Generator(np.random.PCG64(np.random.SeedSequence(episodes[0].seed)))
        for group in self._groups:
            for trial in group.trials:
                for log in known.get(trial.episode.episode_id, ()):
                    trial.learn(None, log)
                    if log.hit:
                        group.offer(group.space.actions_along(log.adversary), OTHER)

    @property
    def _trials(self) -> list[Trial]:
        return [trial for group in self._groups for trial in group.trials]

    def begin_with(self, logs: Mapping[int, EpisodeLog]) -> None:
        """Begin with what happens on the hits of an earlier version, by the id of the episode."""
        for group in self._groups:
            ids = [trial.episode.episode_id for trial in group.trials]
            group.begin_with({place: logs[number] for place, number in enumerate(ids) if number in logs})

    def offer(self, hits: Sequence[OtherHit]) -> None:
        """Offer trajectories on which another car hits, the least deviation first."""
        spaces = {one.space.path.tobytes(): one.space for one in self._groups}
        offers: dict[bytes, list[IntArray]] = {}
        for safe, positions in hits:
            path = np.ascontiguousarray(safe).tobytes()
            first = self._groups[0].space
            space = spaces.setdefault(path, ActionSpace(first.scenario, first.end, safe))
            offers.setdefault(path, []).append(space.actions_along(positions))
        firsts = [of_path[0] for of_path in offers.values()]
        for group in self._groups:
            for actions in reversed(offers.get(group.space.path.tobytes(), firsts)):  # the last offer is tried first
                group.offer(actions, OTHER)

    @property
    def margins(self) -> FloatArray:
        """The margin of each trial, m, in the order of the episodes; η_max where no hit was found."""
        return np.array([trial.least for trial in self._trials])

    @property
    def mean(self) -> float:
        """Mean margin, m; a trial without a hit counts as η_max."""
        return float(self.margins.mean())

    @property
    def is_done(self) -> bool:
        """Whether nothing less can be found."""
        return all(trial.is_done for trial in self._trials)

    @property
    def has_all_hits(self) -> bool:
        """Whether a hit was found in each trial; one without is unfinished."""
        return all(trial.best is not None for trial in self._trials)

    def round(self, budget: int, deeper: Collection[int] = ()) -> None:
        """Search with so many candidates a trial on average, and more in some episodes; then share what was found."""
        margins, (share, times) = self.margins, _HARD
        weights = np.where(margins > np.quantile(margins, 1.0 - share), times, 1.0)
        for trial, weight in zip(self._trials, weights / weights.mean(), strict=True):
            trial.goal = DEEPER * budget if trial.episode.episode_id in deeper else int(weight * budget)
        checked = f"{len(deeper)} trials checked with {DEEPER * budget} candidates each"
        what = checked if deeper else f"{budget} candidates a trial"
        what = what if budget else "trajectories of the other car"
        self._groups = self._rounds(self._groups, what)
        reasons = [reason for group in self._groups for reason in group.reasons]
        if len(reasons) == sum(trial.driven for trial in self._trials):
            nothing = "no trajectory could be driven: see `ending` and `eta_max` of the scenario"
            raise AssessmentError(f"every candidate was aborted ({reasons[0]})" if reasons else nothing)
        self._share()

    def _share(self) -> None:
        """Offer the best hits of each group to all groups: most to those of the same φ."""
        paths = [group.space.path.tobytes() for group in self._groups]
        pools = [(path, group.found) for path, group in zip(paths, self._groups, strict=True)]
        for path, group in zip(paths, self._groups, strict=True):
            mine = [actions for of, pool in pools if of == path for actions in pool[:_SAME_PHI]]
            others = [pool[0] for of, pool in pools if of != path and pool]
            drawn = self._rng.permutation(len(others))[:_OTHER_PHI].tolist()
            for actions in (*mine[: 2 * _SAME_PHI], *(others[number] for number in drawn)):
                group.offer(actions, OTHER)

    def deepen(self, budget: int) -> tuple[Excess, float]:
        """Search some trials several times as deep, and all others with what is found there.

        Returns:
            What that says of the mean, and by how much the mean of those trials fell, m.
        """
        before = self.margins
        deep = np.zeros(len(before), dtype=bool)
        deep[self._rng.permutation(len(before))[:DEEP_TRIALS]] = True
        self.round(budget, {trial.episode.episode_id for trial in itertools.compress(self._trials, deep)})
        self.round(budget)
        gains = before - self.margins
        # What deeper search brought was tried in the rest, too: what that did not bring there is still missing.
        excess = _excess(gains[deep], float(gains[~deep].mean()), float((~deep).mean()))
        return excess, float(gains[deep].mean())

    def result(
        self, converged: bool, budget: int, excess: Excess | None, means: Sequence[tuple[int, float]]
    ) -> SearchedMargins:
        """Return what was found."""
        found, sources = self._trials, []
        for name in SOURCES:
            each = [group.sources[name] for group in self._groups]
            hits, lowered = sum(one.hits for one in each), math.fsum(one.lowered for one in each)
            used = sum(one.candidates for one in each)
            sources.append({"source": name, "candidates": used, "hits": hits, "lowered": lowered})
        return SearchedMargins(
            [one.best for one in found],
            [one.hit for one in found],
            Search(budget, converged, excess, tuple(sources)),
            tuple(means),
            sum(trial.driven for trial in found),
            tuple(reason for group in self._groups for reason in group.reasons),
        )
