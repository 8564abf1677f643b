"""The margins of a car that can only be driven: found by whole episodes, planned in a learned picture of it.

A stack behind the node graph cannot be copied in the middle of an episode. So every way is walked from its start,
under the draws of its attempt, and what the car did teaches the picture in which the next ways are planned. All
attempts share one picture and take their turns round by round, so that several graphs can run a round side by side. A
hit that happened counts, however well the stack repeats itself; how well that is, is found by walking the best ways
once more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from skd_sim.episode.episode import Episode, EpisodeLog, Outcome
from skd_sim.episode.randomness import Role, generator

from skd_evaluator.campaign.plan.plan import EpisodeRunner, Progress
from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.episode_tree import EpisodeTree, Proposals, walked
from skd_evaluator.margin.search.picture import Picture
from skd_evaluator.margin.search.tree import ENOUGH, Velocity
from skd_evaluator.measure.distances.least_way import LeastWay

LABEL: Final = "margins"
BUDGET: Final = 16
"""Episodes of an attempt, before it is asked whether more would change the mean."""
LIMIT: Final = 64
CHANGE: Final = 0.02
"""Of the mean, below which it has converged."""
_TURNS = 8  # plans that may fail before somebody tries something by chance
_CHANCE = 3  # of so many turns without a hit one is left to chance
_DRAWS = 2  # after the two streams of the search in process


@dataclass(frozen=True, eq=False)
class WalkedMargins:
    """What whole episodes have found.

    Attributes:
        ways: the least way of each attempt that ended in a hit; None: no hit within η_max.
        converged: whether twice as many episodes changed the mean by less than `CHANGE`.
        budget: number of episodes for each attempt.
        repeated: how many of the ways that hit did so again when they were walked once more.
        hits: how many ways hit.
        apart: greatest distance of the car (m) from where it was after the same ways before.
        episodes: number of episodes that were run, aborted ones included.
        reasons: why episodes were aborted, one each.
    """

    ways: list[LeastWay | None]
    converged: bool
    budget: int
    repeated: int
    hits: int
    apart: float
    episodes: int
    reasons: tuple[str, ...]

    @property
    def aborted(self) -> int:
        """Number of episodes that were aborted."""
        return len(self.reasons)

    @property
    def unfound(self) -> int:
        """Attempts in which no hit was found: there may be one, for episodes are few."""
        return sum(way is None for way in self.ways)

    @property
    def text(self) -> str:
        """How they were found, in a few words."""
        again = f"{self.repeated} of {self.hits} ways hit again when walked once more" if self.hits else "none hit"
        return (
            f"by up to {self.budget} whole episodes an attempt; {again}, the car at most {self.apart:.2g} m elsewhere"
        )


class _Attempt:
    """One attempt, with what is known of it."""

    def __init__(self, episode: Episode, picture: Picture) -> None:
        self.episode = episode
        self.tree = EpisodeTree(episode, picture)
        self._plans = Proposals(self.tree, picture, generator(episode.seed, episode.episode_id, Role.FLOOR, 1))
        self._rng = generator(episode.seed, episode.episode_id, Role.FLOOR, _DRAWS)
        self.best: list[Velocity] = []
        self._turn = 0

    @property
    def done(self) -> bool:
        """Whether nothing less can be found."""
        return self.tree.least <= ENOUGH

    @property
    def margin(self) -> float:
        """The least that happened, m; η_max: nothing."""
        eta_max = self.episode.scenario.eta_max
        return eta_max if self.tree.best_way is None else min(self.tree.best_way.distance, eta_max)

    def as_phi(self) -> list[Velocity]:
        """Return φ itself, velocities per tick, m/s."""
        step = self.episode.scenario.time_step
        return [(vx, vy) for vx, vy in (np.diff(self.tree.phi, axis=0) / step).tolist()]

    def next_way(self) -> list[Velocity]:
        """Return what to try next: the best plan, or, where there is none or plans have not hit yet, a chance one."""
        self._turn += 1
        if self.tree.best_way is None and self._turn % _CHANCE == 0:
            return self._by_chance()
        planned = self._plans.propose(_TURNS)
        return self._by_chance() if planned is None else planned

    def _by_chance(self) -> list[Velocity]:
        """Return a way that goes as φ until a tick, and then takes one action for some ticks."""
        ticks = self.episode.scenario.ticks
        leave = int(self._rng.integers(min(len(self.tree.phi), ticks)))
        stay = 1 + int(self._rng.integers(ticks - leave))
        way = int(self._rng.integers(len(self.tree.table(0))))
        phi = self.as_phi() + [(0.0, 0.0)] * ticks
        return phi[:leave] + [self.tree.table(leave + index)[way] for index in range(stay)]

    def learn(self, log: EpisodeLog, way: list[Velocity] | None = None) -> None:
        """Take note of what happened on a way, velocities per tick; None: a kamikaze's own."""
        least = self.tree.least
        self.tree.learn(log)
        if way is None:
            moved = np.diff(log.adversary, axis=0) / self.episode.scenario.time_step
            way = [(vx, vy) for vx, vy in moved.tolist()]
        else:
            self._plans.note_failure()
        if self.tree.least < least:
            self.best = way


def why_not_walked(episode: Episode) -> str:
    """Return why ways cannot be planned in an encounter, in one line; empty where they can."""
    if not episode.scenario.road.straight:
        return "the margin of a stack is searched on straight roads only"
    if not EpisodeTree(episode, Picture(None, False)).is_pedestrian:
        return "the margin of a stack is searched for a pedestrian only"
    return ""


def walked_margins(
    episodes: Sequence[Episode],
    known: Mapping[int, Sequence[EpisodeLog]],
    runner: EpisodeRunner,
    progress: Progress,
    budget: int = BUDGET,
    limit: int = LIMIT,
) -> WalkedMargins:
    """Search the margins of attempts by whole episodes, twice as many until the mean changes by less than `CHANGE`.

    Args:
        episodes: the attempts: mode kamikaze, all of one car, at least one; `why_not_walked` has no objection to them.
        known: what happened to kamikazes in them, by their ids.
        runner: runs episodes, in their order.
        progress: called with how far the work is.
        budget: number of episodes for each attempt to begin with.
        limit: greatest number of episodes for each attempt.

    Raises:
        AssessmentError: all of the first ways were aborted, or no episode can be run any more.
    """
    picture = Picture(None, episodes[0].scenario.control_periods > 1)
    attempts = [_Attempt(episode, picture) for episode in episodes]
    for attempt in attempts:
        for log in known.get(attempt.episode.episode_id, ()):
            attempt.learn(log)
    reasons = _walk(attempts, [attempt.as_phi() for attempt in attempts], runner)
    if len(reasons) == len(attempts):
        raise AssessmentError(f"every way that was walked was aborted ({reasons[0]})")
    episodes_run = len(attempts)
    means = {1: _mean(attempts)}
    walks = 1
    budget = min(budget, limit)
    while True:
        left = [attempt for attempt in attempts if not attempt.done]
        reasons += _walk(left, [attempt.next_way() for attempt in left], runner)
        episodes_run += len(left)
        walks += 1
        means[walks] = _mean(attempts)
        progress(f"{LABEL}, whole episodes", walks, budget)
        if walks < budget and left:
            continue
        before = means[max(1, walks // 2)]
        settled = all(attempt.tree.best_way is not None for attempt in attempts) or 2 * budget > limit
        converged = not left or (settled and abs(before - means[walks]) <= CHANGE * before)
        if converged or 2 * budget > limit:
            break
        budget *= 2
    hits, repeated, lost = _repeat(attempts, runner)
    return WalkedMargins(
        [attempt.tree.best_way for attempt in attempts],
        converged,
        walks,
        repeated,
        hits,
        max(attempt.tree.apart for attempt in attempts),
        episodes_run + hits,
        (*reasons, *lost),
    )


def _mean(attempts: Sequence[_Attempt]) -> float:
    return float(np.mean([attempt.margin for attempt in attempts]))


def _walk(attempts: Sequence[_Attempt], ways: Sequence[list[Velocity]], runner: EpisodeRunner) -> list[str]:
    """Run episodes along one way for each attempt, learn from them, and return why some were aborted."""
    episodes = [walked(attempt.episode, way) for attempt, way in zip(attempts, ways, strict=True)]
    reasons = []
    for attempt, way, log in zip(attempts, ways, runner.run(episodes), strict=True):
        reasons += [log.reason] * (log.outcome == Outcome.ABORTED)
        attempt.learn(log, way)
    return reasons


def _repeat(attempts: Sequence[_Attempt], runner: EpisodeRunner) -> tuple[int, int, list[str]]:
    """Walk each best way once more; return how many there are, how many hit again, and why some were aborted."""
    ours = [attempt for attempt in attempts if attempt.tree.best_way is not None]
    repeated, reasons = 0, list[str]()
    logs = runner.run([walked(attempt.episode, attempt.best) for attempt in ours])
    for attempt, log in zip(ours, logs, strict=True):
        reasons += [log.reason] * (log.outcome == Outcome.ABORTED)
        repeated += log.hit
        attempt.tree.learn(log)
    return len(ours), repeated, reasons
