"""What is looked at again, drawn by lot: who knew it beforehand could be honest in that alone.

No figure depends on it, so it follows from no seed: a car may know that.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, TypeVar

from skd_sim.episode.episode import Episode, EpisodeLog

from skd_evaluator.campaign.plan.plan import EpisodeRunner

_Item = TypeVar("_Item")
_MOST: Final = 240  # episodes that are kept, to be run again; all of fewer
_CHANCE = random.SystemRandom()


def spread_by_lot(items: Sequence[_Item], most: int) -> list[_Item]:
    """Return some items in their order, one of each of as many parts of equal length."""
    if len(items) <= most:
        return list(items)
    ends = [len(items) * part // most for part in range(most + 1)]
    return [items[_CHANCE.randrange(first, end)] for first, end in itertools.pairwise(ends)]


def one_of(count: int) -> int:
    """Return a number from 0 to `count` − 1."""
    return _CHANCE.randrange(count)


def shuffled(items: Sequence[_Item]) -> list[_Item]:
    """Return items in any order."""
    return _CHANCE.sample(items, len(items))


class Kept:
    """Some episodes, spread over all that there are: all of a few, else of each so many one by lot.

    Attributes:
        logs: what happened in them.
    """

    def __init__(self) -> None:
        """Begin with none."""
        self.logs: list[EpisodeLog] = []
        self._one_in = 1
        self._next = 0  # counted from the next episode
        self._left = 1  # episodes of the part in which that is

    def wants(self, count: int) -> list[int]:
        """Return which of the next `count` episodes are to be added."""
        found, at = [], 0
        while at < count:
            here = min(self._left, count - at)
            if 0 <= self._next < here:
                found.append(at + self._next)
            self._next, self._left, at = self._next - here, self._left - here, at + here
            if not self._left:
                self._next, self._left = one_of(self._one_in), self._one_in
        return found

    def add(self, logs: Iterable[EpisodeLog]) -> None:
        """Keep what happened; of so many that it takes much room, one of each two."""
        self.logs.extend(logs)
        while len(self.logs) > _MOST:
            self.logs, self._one_in = spread_by_lot(self.logs, len(self.logs) // 2), 2 * self._one_in


class SampledRunner:
    """A runner of whose episodes some are kept.

    Attributes:
        kept: some of all.
    """

    def __init__(self, runner: EpisodeRunner) -> None:
        """Let `runner` do the work."""
        self._runner = runner
        self.kept = Kept()

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        """Run all of `episodes`; see `EpisodeRunner`."""
        for log in self._runner.run(episodes):
            self.kept.add([log] * len(self.kept.wants(1)))
            yield log
