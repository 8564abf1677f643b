"""Whether a stack is the same car whenever an episode is run: some are run again through a graph, in another order.

A stack that is a node of its own cannot be copied, nor be asked alone what it was asked before; but an episode can be
run again. In lockstep it goes as before, to the last bit, if the stack answers by what it hears. Two kinds of stacks do
not: those that keep something from one episode to the next, whose figures are those of another car in each order; and
those that never go the same way twice, as by threads or by time limits of their own, whose figures are a draw. They are
told apart when all is done once more in the same order: each of the three runs of one of the second kind is as likely
to be far from the two others, be it by a little noise; one of the first kind goes otherwise where the order is another.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.errors import UsageError

from skd_evaluator.assessing.otherwise import (
    Pair,
    by_kind,
    figure_of,
    first_run_flatters,
    further_of,
    is_same,
    one_run_stands_apart,
    some_of,
    told,
    went_otherwise,
)
from skd_evaluator.campaign.judge.rating import Rating
from skd_evaluator.campaign.plan.lot import shuffled
from skd_evaluator.campaign.plan.plan import EpisodeRunner, Progress, Stage, split_episode_id
from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.episode_tree import walked
from skd_evaluator.measure.doubt import DOUBT

LABEL = "episodes run again"
_OFTEN = 0.5  # share of the differences between two orders that two runs in the same order may have, of one that keeps
_MOST = 0.25  # share of the episodes of a figure that may be aborted where they are run again
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
        lost = _lost(first, again)
        if not changed or count <= len(first) // 2:
            return lost
        once_more = _run(graph, episodes, progress, limit)
    except (AssessmentError, UsageError, OSError) as error:  # as where the stack has removed what starts it
        return (_unknown(len(first), str(error)),)
    repeated, _ = _changed(again, once_more)
    runs = (first, again, once_more)
    sure = first_run_flatters(runs)  # by both: one of the two may be chance
    if sure or one_run_stands_apart(runs) or (repeats and len(repeated) <= _OFTEN * len(changed)):
        return (*lost, went_otherwise(name, changed, count, where, sure))
    if not repeats:
        return lost
    return (
        *lost,
        f"{told(changed, count, where)}, and {len(repeated)} when that was done once more in the same order: {name} "
        "does not go the same way twice, as by threads or time limits of its own; so each figure is one of those that "
        "it may have",
    )


def _lost(first: Sequence[EpisodeLog], again: Sequence[EpisodeLog]) -> tuple[str, ...]:
    """Return, in a line, of which figure too many episodes were aborted: nobody has seen how they go; empty if none.

    Whoever knows that it is run again could end just those in which it had been another car.
    """
    for kind in by_kind(list(zip(first, again, strict=True)), lambda both: both[0]):
        reasons = [other.reason for _one, other in kind if other.outcome == Outcome.ABORTED]
        if len(reasons) > _MOST * len(kind):
            which = f"{len(reasons)} of {len(kind)} {figure_of(kind[0][0])}"
            return (_unknown(len(first), f"{which} were aborted, the first one so: {reasons[0]}"),)
    return ()


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
