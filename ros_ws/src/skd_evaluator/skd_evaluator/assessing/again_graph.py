"""Whether a stack is the same car whenever an episode is run: some are run again through a graph, in another order.

A stack that is a node of its own cannot be copied, nor be asked alone what it was asked before; but an episode can be
run again. In lockstep it goes as before, to the last bit, if the stack answers by what it hears. Two kinds of stacks do
not: those that keep something from one episode to the next, whose figures are those of another car in each order; and
those that never go the same way twice, as by threads or by time limits of their own, whose figures are a draw. Where
SKD starts the stack, the two are told apart: one of the first kind does the same again when all is done once more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome

from skd_evaluator.assessing.otherwise import Pair, flatters, further_of, is_same, some_of, told, went_otherwise
from skd_evaluator.campaign.judge.rating import Rating
from skd_evaluator.campaign.plan.lot import shuffled
from skd_evaluator.campaign.plan.plan import EpisodeRunner, Progress, Stage, split_episode_id, walks_a_way
from skd_evaluator.errors import AssessmentError
from skd_evaluator.margin.search.episode_tree import walked
from skd_evaluator.measure.doubt import DOUBT

LABEL = "episodes run again"
_OFTEN = 0.5  # share of the differences between two orders that two runs in the same order may have, of one that keeps

Graph = Callable[[], AbstractContextManager[EpisodeRunner]]
"""Runs a graph; None of what ran in another one is left in it, where SKD starts the stack."""


def groups_of(rating: Rating) -> list[list[EpisodeLog]]:
    """Return the episodes of a rating of which some are run again, of each kind as many."""
    return [[*rating.kamikaze_logs, *rating.replays], *_by_kind(rating.besides)]


def doubts_of_the_stack(
    name: str, groups: Sequence[Sequence[EpisodeLog]], graph: Graph, progress: Progress, *, anew: bool
) -> tuple[str, ...]:
    """Return, a line each, why a stack is not the car that its episodes show; empty if it is.

    Args:
        name: name of the car.
        groups: episodes that have been run in lockstep in SKD's own world; some of each group are run again.
        graph: runs a graph in which episodes are run again.
        progress: called with how far the work is.
        anew: whether each graph has a stack that was started for it alone.
    """
    first, episodes = _chosen(groups)
    if not first:
        return ()
    where = "graph" if anew else ""
    try:
        again = _run(graph, episodes, progress)
        changed, count = _changed(first, again)
        if count <= len(first) // 2:
            why = next(log.reason for log in again if log.outcome == Outcome.ABORTED)
            return (_unknown(len(first), why),)
        if not changed:
            return ()
        if flatters(changed):
            return (went_otherwise(name, changed, count, where),)
        if not anew:
            return (
                f"{told(changed, count, where)}; whether {name} keeps something from one episode to the next, or never "
                "goes the same way twice, is told where SKD starts it (--controller-command)",
            )
        repeated, _ = _changed(again, _run(graph, episodes, progress))
    except AssessmentError as error:
        return (_unknown(len(first), str(error)),)
    if len(repeated) <= _OFTEN * len(changed):
        return (went_otherwise(name, changed, count, where),)
    return (
        f"{told(changed, count, where)}, and {len(repeated)} when that was done once more in the same order: {name} "
        "does not go the same way twice, as by threads or time limits of its own; so each figure is one of those that "
        "it may have",
    )


def _unknown(count: int, why: str) -> str:
    return f"{DOUBT}when {count} episodes were run again to see whether they go as before, this came of it: {why}"


def _chosen(groups: Sequence[Sequence[EpisodeLog]]) -> tuple[list[EpisodeLog], list[Episode]]:
    """Return the logs of some episodes of each kind, the last of each first, and the episodes that run them again."""
    some = [log for group in groups for log in some_of(group)[::-1]]
    further = shuffled([log for group in groups for log in further_of(group, some)])
    return [*some, *further], [*(log.episode for log in some), *map(_led, further)]


def _by_kind(logs: Sequence[EpisodeLog]) -> Iterator[list[EpisodeLog]]:
    for stage in Stage:
        of_stage = [log for log in logs if split_episode_id(log.episode.episode_id)[0] == stage]
        for way in (False, True):
            if group := [log for log in of_stage if walks_a_way(log.episode) == way]:
                yield group


def _led(log: EpisodeLog) -> Episode:
    """Return the episode in which nobody plans: somebody walks where whoever planned had gone."""
    if log.episode.mode != Mode.KAMIKAZE:
        return log.episode
    velocities = np.diff(log.adversary, axis=0) / log.episode.scenario.time_step
    return walked(log.episode, [(vx, vy) for vx, vy in velocities.tolist()])


def _run(graph: Graph, episodes: Sequence[Episode], progress: Progress) -> list[EpisodeLog]:
    logs = []
    with graph() as runner:
        for log in runner.run(episodes):
            logs.append(log)
            progress(LABEL, len(logs), len(episodes))
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
