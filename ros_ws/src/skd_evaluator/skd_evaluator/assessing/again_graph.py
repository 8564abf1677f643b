"""Whether a stack is the same car whenever an episode is run: some are run again through a graph, in another order.

A stack that is a node of its own cannot be copied, nor be asked alone what it was asked before; but an episode can be
run again. In lockstep it goes as before, to the last bit, if the stack answers by what it hears. Two kinds of stacks do
not: those that keep something from one episode to the next, whose figures are those of another car in each order; and
those that never go the same way twice, as by threads or by time limits of their own, whose figures are a draw. They are
told apart when all is done once more in the same order: any two of the three runs of one of the second kind are as far
apart, be it by a little noise; and one of the first kind goes otherwise where the order is another one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome

from skd_evaluator.assessing.otherwise import (
    Pair,
    by_kind,
    flattered,
    further_of,
    is_same,
    some_of,
    surely_more,
    told,
    way_apart,
    went_otherwise,
)
from skd_evaluator.campaign.judge.rating import Rating
from skd_evaluator.campaign.plan.lot import shuffled
from skd_evaluator.campaign.plan.plan import EpisodeRunner, Progress, Stage, split_episode_id
from skd_evaluator.campaign.run.led import ALIKE
from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.episode_tree import walked
from skd_evaluator.measure.doubt import DOUBT

LABEL = "episodes run again"
_OFTEN = 0.5  # share of the differences between two orders that two runs in the same order may have, of one that keeps
_FAR = 10.0  # times as far apart, so that it is no chance of the same noise
_LOST = 60.0  # s that those of the episodes may take which are aborted: a stack may be silent in each of them
_SHORT, _LONG, _SLOWER = 60.0, 600.0, 2.0  # s, s, times as long as all episodes of a rating took

Graph = Callable[[], AbstractContextManager[EpisodeRunner]]
"""Runs a graph; where SKD starts the stack, nothing of what ran in another one is left in it."""


class TimedRunner:
    """A runner that knows how long another one takes.

    Attributes:
        count: how many episodes have been run.
        seconds: how long they took, wall-clock time.
    """

    def __init__(self, runner: EpisodeRunner) -> None:
        """Let `runner` do the work."""
        self._runner = runner
        self.count, self.seconds = 0, 0.0

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        """Run all of `episodes`; see `EpisodeRunner`."""
        begin = time.perf_counter()
        for log in self._runner.run(episodes):
            self.count += 1
            self.seconds += time.perf_counter() - begin
            yield log
            begin = time.perf_counter()

    def limit(self, episodes: int) -> float:
        """Return how long it may take to run some of them again, s.

        Args:
            episodes: how many a rating has; of some that have been run before nobody knows how long they took.
        """
        return max(_SHORT if self.count >= episodes else _LONG, _SLOWER * self.seconds)


def groups_of(rating: Rating) -> list[list[EpisodeLog]]:
    """Return the episodes of a rating of which some are run again, of each kind as many."""
    return [[*rating.kamikaze_logs, *rating.replays], *by_kind(rating.besides, lambda log: log)]


def doubts_of_the_stack(
    name: str,
    groups: Sequence[Sequence[EpisodeLog]],
    graph: Graph,
    progress: Progress,
    *,
    anew: bool,
    limit: float,
    repeats: bool = True,
) -> tuple[str, ...]:
    """Return, a line each, why a stack is not the car that its episodes show; empty if it is.

    Args:
        name: name of the car.
        groups: episodes that have been run in SKD's own world; some of each group are run again.
        graph: runs a graph in which episodes are run again.
        progress: called with how far the work is.
        anew: whether each graph has a stack that was started for it alone.
        limit: how long a graph may take to run them again, wall seconds.
        repeats: whether an episode goes as before, if the stack answers by what it hears; not so in real time.
    """
    first, episodes = _chosen(groups)
    if not first:
        return ()
    where = "graph" if anew else ""
    try:
        again = _run(graph, episodes, progress, limit)
        changed, count = _changed(first, again)
        aborted = _aborted_more_often([log for group in groups for log in group], again)
        if not changed or count <= len(first) // 2:
            return aborted
        once_more = _run(graph, episodes, progress, limit)
    except AssessmentError as error:
        return (_unknown(len(first), str(error)),)
    repeated, _ = _changed(again, once_more)
    flatters = flattered(changed) and flattered(_changed(first, once_more)[0])  # one of the two may be chance
    keeps = _order_tells(first, again, once_more) or (repeats and len(repeated) <= _OFTEN * len(changed))
    if flatters or keeps:
        return (*aborted, went_otherwise(name, changed, count, where))
    if not repeats:
        return aborted
    return (
        *aborted,
        f"{told(changed, count, where)}, and {len(repeated)} when that was done once more in the same order: {name} "
        "does not go the same way twice, as by threads or time limits of its own; so each figure is one of those that "
        "it may have",
    )


def _order_tells(first: Sequence[EpisodeLog], again: Sequence[EpisodeLog], once_more: Sequence[EpisodeLog]) -> bool:
    """Whether a stack surely goes otherwise in another order than it does twice in the same one: a sign test."""
    far = near = 0
    for logs in zip(first, again, once_more, strict=True):
        if Outcome.ABORTED not in {log.outcome for log in logs}:
            orders, same = way_apart(*logs[:2]), way_apart(*logs[1:])
            far += orders > _FAR * max(same, ALIKE)
            near += same > _FAR * max(orders, ALIKE)
    return surely_more(far, near)


def _aborted_more_often(first: Sequence[EpisodeLog], again: Sequence[EpisodeLog]) -> tuple[str, ...]:
    """Return that surely more episodes were aborted than of all before, or most of them: nobody saw how they went."""
    reasons = [log.reason for log in again if log.outcome == Outcome.ABORTED]
    before = sum(log.outcome == Outcome.ABORTED for log in first) * len(again) / len(first)
    if not surely_more(len(reasons), round(before)) and 2 * len(reasons) < len(again):
        return ()
    return (_unknown(len(again), f"{len(reasons)} were aborted, the first of them because: {reasons[0]}"),)


def _unknown(count: int, why: str) -> str:
    return f"{DOUBT}when {count} episodes were run again to see whether they go as before, this came of it: {why}"


def _chosen(groups: Sequence[Sequence[EpisodeLog]]) -> tuple[list[EpisodeLog], list[Episode]]:
    """Return the logs of some episodes of each kind, the last of each first, and the episodes that run them again."""
    some = [log for group in groups for log in some_of(group)[::-1]]
    further = shuffled([log for group in groups for log in further_of(group, some)])
    return [*some, *further], [*(log.episode for log in some), *map(_led, further)]


def _led(log: EpisodeLog) -> Episode:
    """Return the episode in which nobody plans: somebody walks where whoever planned had gone.

    The number of one from which the adversary learned belongs to one that plans.
    """
    stage = split_episode_id(log.episode.episode_id)[0]
    if log.episode.mode != Mode.KAMIKAZE or stage != Stage.KAMIKAZE:
        return log.episode
    velocities = np.diff(log.adversary, axis=0) / log.episode.scenario.time_step
    return walked(log.episode, [(vx, vy) for vx, vy in velocities.tolist()])


def _run(graph: Graph, episodes: Sequence[Episode], progress: Progress, limit: float) -> list[EpisodeLog]:
    logs: list[EpisodeLog] = []
    begin, lost = time.perf_counter(), 0.0
    with graph() as runner:
        last = time.perf_counter()
        for log in runner.run(episodes):
            logs.append(log)
            progress(LABEL, len(logs), len(episodes))
            now = time.perf_counter()
            lost, last = lost + (now - last) * (log.outcome == Outcome.ABORTED), now
            if lost > _LOST:
                raise AssessmentError(log.reason)
            if now - begin > limit:
                raise AssessmentError(f"after {now - begin:.0f} s only {len(logs)} were over")
    return logs


def _changed(first: Sequence[EpisodeLog], second: Sequence[EpisodeLog]) -> tuple[list[Pair], int]:
    """Return the episodes that went otherwise, and how many can be compared."""
    pairs = [
        (one, _named_alike(one, other))
        for one, other in zip(first, second, strict=True)
        if Outcome.ABORTED not in (one.outcome, other.outcome)
    ]
    return [(one, other) for one, other in pairs if not is_same(one, other)], len(pairs)


def _named_alike(one: EpisodeLog, other: EpisodeLog) -> EpisodeLog:
    """Return the second run with the end of the first if both or neither collided; whoever is led cannot miss."""
    alike = (one.outcome == Outcome.COLLISION) == (other.outcome == Outcome.COLLISION)
    return replace(other, outcome=one.outcome) if alike else other
