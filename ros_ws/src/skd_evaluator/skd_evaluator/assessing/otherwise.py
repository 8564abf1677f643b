"""Episodes that are run again: which of all, whether they went as before, and what it means that they did not."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from skd_sim.episode.aborts import AbortKind, kind_of
from skd_sim.episode.episode import EpisodeLog, Mode, Outcome

from skd_evaluator.campaign.plan.lot import spread_by_lot
from skd_evaluator.campaign.plan.plan import Stage, split_episode_id, walks_a_way
from skd_evaluator.campaign.run.led import ALIKE, NEARLY
from skd_evaluator.measure.doubt import DISBELIEF, DOUBT

EPISODES = 12
"""So many are run again as they were, one by lot of each of as many parts of all."""
FURTHER, SHARE = 48, 20
"""So many more at most, and one of so many, are run again with somebody who is led where whoever planned had gone."""
LOST = 8
"""So many that were aborted are run again at most."""
_BY_CHANCE = 0.05  # so seldom may chance alone have so many collisions come, and so few go
_FAR = 10.0  # times as far apart, so that it is no chance of the same noise
_OF_STAGES = {
    Stage.RISK: "a crossing of the risk",
    Stage.SAFE: "a static test",
    Stage.PROBE: "a probe",
    Stage.LEARNING: "a kamikaze from which the adversary learned",
}
_FIGURES_OF = {
    Stage.RISK: "crossings of the risk",
    Stage.SAFE: "static tests",
    Stage.PROBE: "episodes to learn from",
    Stage.LEARNING: "episodes to learn from",
}
_RATED = "kamikazes and runs along φ"

_Item = TypeVar("_Item")
Pair = tuple[EpisodeLog, EpisodeLog]
"""The first and the second run of an episode."""


def some_of(logs: Sequence[EpisodeLog]) -> list[EpisodeLog]:
    """Return a few episodes, spread over all."""
    return spread_by_lot([log for log in logs if log.outcome != Outcome.ABORTED], EPISODES)


def further_of(logs: Sequence[EpisodeLog], but: Sequence[EpisodeLog]) -> list[EpisodeLog]:
    """Return some more of them, which cost little as nobody plans in them again."""
    taken = set(map(id, but))
    left = [log for log in logs if log.outcome != Outcome.ABORTED and id(log) not in taken]
    return spread_by_lot(left, min(FURTHER, max(EPISODES, len(logs) // SHARE)))


def lost_of(logs: Sequence[EpisodeLog]) -> list[EpisodeLog]:
    """Return a few episodes whose process ended; who gave no answer takes as long as it may each time."""
    ended = [log for log in logs if log.outcome == Outcome.ABORTED and kind_of(log.reason) == AbortKind.ENDED]
    return spread_by_lot(ended, LOST)


def hid_hits(name: str, lost: Sequence[Pair], logs: Sequence[EpisodeLog]) -> tuple[str, ...]:
    """Return, in a line, that aborted episodes surely collide more often when they are run again than others have.

    Whoever crashes by chance does so in those that collide as often as in others. One that is aborted again says
    nothing. Empty where chance explains it.

    Args:
        name: name of the car.
        lost: the aborted episodes with their second runs.
        logs: all episodes.
    """
    kinds: dict[tuple[str, Mode], list[bool]] = {}
    for one, again in lost:
        if again.outcome != Outcome.ABORTED:
            kinds.setdefault(_of(one), []).append(again.outcome == Outcome.COLLISION)
    for kind, hits in kinds.items():
        others = [
            log.outcome == Outcome.COLLISION for log in logs if log.outcome != Outcome.ABORTED and _of(log) == kind
        ]
        share = (sum(others) + 1) / (len(others) + 2)  # none of few does not mean never
        if sum(hits) and _at_least(sum(hits), len(hits), share) < _BY_CHANCE / len(kinds):
            return (
                f"{DISBELIEF}{sum(hits)} of {len(hits)} aborted episodes ({_in_words(*kind)}) collided when they were "
                f"run again in a new process, and of others {sum(others)} of {len(others)} had: {name} ends its "
                "process more often where it is about to collide, and its figures leave that out",
            )
    return ()


def _of(log: EpisodeLog) -> tuple[str, Mode]:
    return figure_of(log), log.episode.mode


def _in_words(figure: str, mode: Mode) -> str:
    together = figure == _RATED
    return ("kamikazes" if mode == Mode.KAMIKAZE else "runs along φ") if together else figure


def is_same(first: EpisodeLog, second: EpisodeLog) -> bool:
    """Whether two logs of an episode tell the same."""
    if _stage(first) == Stage.RISK:  # which `commands` may have answered, by a little otherwise than `command`
        count = min(len(first.car), len(second.car))
        return np.allclose(first.car[:count], second.car[:count], rtol=0.0, atol=NEARLY)
    if first.outcome != second.outcome or first.adversary.shape != second.adversary.shape:
        return False
    pairs = ((first.adversary, second.adversary), (first.car, second.car))
    return all(np.allclose(one, other, rtol=0.0, atol=ALIKE) for one, other in pairs)


def collisions(changed: Sequence[Pair]) -> tuple[int, int]:
    """Return how many episodes collided in their second run alone, and how many in their first alone."""
    collided = [tuple(log.outcome == Outcome.COLLISION for log in both) for both in changed]
    return collided.count((False, True)), collided.count((True, False))


def flattered(changed: Sequence[Pair]) -> Sequence[Pair]:
    """Return those in which the first runs had surely fewer collisions than the second ones: a sign test.

    They are all, or those of which one figure is; empty where chance explains it. A car that is careful in crossings
    of the risk alone has as many collisions more along φ when all is run in another order.
    """
    if surely_more(*collisions(changed)):
        return changed
    kinds = by_kind(changed, lambda both: both[0])
    chance = _BY_CHANCE / max(1, len(kinds))
    return next((one for one in kinds if surely_more(*collisions(one), chance)), ())


def by_kind(items: Sequence[_Item], log_of: Callable[[_Item], EpisodeLog]) -> list[list[_Item]]:
    """Return items in groups, of one figure each, by the log of each."""
    kinds: dict[str, list[_Item]] = {}
    for one in items:
        kinds.setdefault(figure_of(log_of(one)), []).append(one)
    return list(kinds.values())


def surely_more(many: int, few: int, chance: float = _BY_CHANCE) -> bool:
    """Whether so many are more than so few by more than chance, were each as likely to be one of either."""
    return many > few and _at_least(many, many + few) < chance


def first_run_flatters(runs: Sequence[Sequence[EpisodeLog]]) -> str:
    """Return in words of which figure the first of three runs of the same episodes surely had fewer collisions.

    Of who goes by chance, each run of an episode is as likely to be the one of three that collides alone, or that does
    not: a permutation test, of all and of those of one figure. Empty where chance explains it.
    """
    groups = _groups(runs)
    for group in groups:
        mixed = [hits for hits in map(_collided, group) if any(hits) and not all(hits)]
        chance = _BY_CHANCE / (2.0 if group is groups[0] else 2.0 * (len(groups) - 1))
        spared = sum(not first for first, *_others in mixed)
        if _as_many([1.0 - sum(hits) / len(hits) for hits in mixed], spared) < chance:
            what = "episodes" if group is groups[0] else figure_of(group[0][0])
            return (
                f"{spared} {what} of {len(group)} collided when they were run again, once or twice, and not before; "
                f"{len(mixed) - spared} before, and not each time after it"
            )
    return ""


def _groups(runs: Sequence[Sequence[EpisodeLog]]) -> list[list[tuple[EpisodeLog, ...]]]:
    """Return the logs of each episode that no run has aborted: of all, and then of those of each figure."""
    whole = [logs for logs in zip(*runs, strict=True) if Outcome.ABORTED not in {log.outcome for log in logs}]
    return [whole, *by_kind(whole, lambda logs: logs[0])]


def _collided(logs: Sequence[EpisodeLog]) -> tuple[bool, ...]:
    return tuple(log.outcome == Outcome.COLLISION for log in logs)


def _as_many(chances: Sequence[float], count: int) -> float:
    """Return how likely at least `count` of independent events are, of which each has its own probability."""
    sums = np.ones(1)
    for chance in chances:
        sums = np.convolve(sums, [1.0 - chance, chance])
    return float(np.sum(sums[count:]))


def one_run_stands_apart(runs: Sequence[Sequence[EpisodeLog]]) -> bool:
    """Whether one of three runs of the same episodes surely is another one than the two others.

    Of who goes by chance each run is as likely to be the one that goes otherwise, of all and of those of one figure.

    Args:
        runs: the logs of each run, in the order of the episodes.
    """
    groups = _groups(runs)
    chance = _BY_CHANCE / (len(groups) * len(runs))
    for group in groups:
        apart = [one for one in map(_apart, group) if one is not None]
        if any(_at_least(apart.count(run), len(apart), 1.0 / len(runs)) < chance for run in set(apart)):
            return True
    return False


def _apart(logs: Sequence[EpisodeLog]) -> int | None:
    """Return which of three logs of an episode is far from the two others, which are near each other; None if none."""
    far = [way_apart(logs[(one + 1) % 3], logs[(one + 2) % 3]) for one in range(3)]  # the two others
    nearest = min(range(3), key=far.__getitem__)
    rest = [one for number, one in enumerate(far) if number != nearest]
    return nearest if min(rest) > _FAR * max(far[nearest], ALIKE) else None


def way_apart(first: EpisodeLog, second: EpisodeLog) -> float:
    """Return how far the car of one log was from that of another at most, as long as both lasted, m and m/s."""
    count = min(len(first.car), len(second.car))
    return float(np.max(np.abs(first.car[:count] - second.car[:count]), initial=0.0))


def went_otherwise(name: str, changed: Sequence[Pair], count: int, where: str = "process", sure: str = "") -> str:
    """Return in a line what it means that some of `count` episodes of a car that can repeat itself went otherwise.

    It is more than a doubt where the first runs had surely fewer collisions: the rating flatters the car.

    Args:
        name: name of the car.
        changed: the episodes that went otherwise.
        count: how many were run again.
        where: what was new in their second run.
        sure: why it surely is flattered, if more runs than two say so; see `first_run_flatters`.
    """
    if where == "process":
        more, orders = "what reset gave it and what it saw since", "the order of the episodes and on --workers"
    else:
        more, orders = "what it hears in an episode", "the order of the episodes"
    begin = DISBELIEF if sure or flattered(changed) else DOUBT
    return (
        f"{begin}{told(changed, count, where)}{sure and f'; {sure}'}: {name} answers by more than "
        f"{more}, as by what it keeps from one episode to the next; so its figures depend on {orders}"
    )


def told(changed: Sequence[Pair], count: int, where: str) -> str:
    """Return in words how many of `count` episodes went otherwise, which one was the first, and who collided when."""
    come, gone = collisions(changed)
    said = f"; {come} of them collided then alone, {gone} before alone" if come or gone else ""
    if 0 < len(part := flattered(changed)) < len(changed):
        said += ", and of {2} {0} and {1}".format(*collisions(part), figure_of(part[0][0]))
    new = f"in a new {where} and " if where else ""
    return (
        f"{len(changed)} of {count} episodes went otherwise when they were run again, {new}in another order (the first "
        f"is {named(changed[0][0])}{said})"
    )


def figure_of(log: EpisodeLog) -> str:
    """Return in words of which figure an episode is one."""
    if _is_way_of_search(log):
        return "ways of the margin's search"
    return _FIGURES_OF.get(_stage(log), _RATED)


def named(log: EpisodeLog) -> str:
    """Return in words which episode a log is of."""
    kind = "a kamikaze" if log.episode.mode == Mode.KAMIKAZE else "a run along φ"
    kind = _OF_STAGES.get(_stage(log), kind)
    if _is_way_of_search(log):
        kind = "a way of the margin's search"
    return f"{kind}, episode {log.episode.episode_id}"


def _is_way_of_search(log: EpisodeLog) -> bool:
    return walks_a_way(log.episode) and _stage(log) == Stage.KAMIKAZE


def _at_least(come: int, count: int, share: float = 0.5) -> float:
    """Return how likely at least `come` of `count` are where each comes with a probability of `share`."""
    return sum(math.comb(count, one) * share**one * (1.0 - share) ** (count - one) for one in range(come, count + 1))


def _stage(log: EpisodeLog) -> Stage:
    return split_episode_id(log.episode.episode_id)[0]
