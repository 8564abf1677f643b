"""Which action is best, by hindsight over a few futures and a pool of ways that are tried in them.

Two estimates bracket what an action costs. The mean over futures of the least cost of any way that begins with it is
too low: it is the cost for somebody who knows, from the next tick on, which future it is. The least mean cost of one
way over all futures is too high: it is the cost for somebody who never looks again. Weighed together they say what to
do now; in the next tick the adversary looks again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from skd_adversary.itself.costs import Cost
from skd_adversary.itself.future import Course, Draws, Node

Way = tuple[int, ...]
"""Actions from now on; after their end one walks towards the car."""
FORESIGHT: Final = 40
"""Ticks that are looked ahead."""
_STANDING: Final = 2  # ticks that one walks towards a car that stands
_TIE: Final = 1e-9
_MUTATED: Final = 0.75  # of the ways that are tried, how many are changes of good ones
_HOPELESS: Final = 3.0  # times what is worth a look: of an action that is so much worse nothing more is to be known
_TRUSTED: Final = 3  # ways of before that are tried in all futures, whatever comes of them in one
_REMEMBERED: Final = 12  # ways that the next decision begins with, beside the best of each future


@dataclass(frozen=True)
class Size:
    """How many futures and ways a decision tries.

    Attributes:
        futures: number of futures in which ways are tried.
        ways: greatest number of ways.
        open_loop: weight of the least mean cost, w.
    """

    futures: int
    ways: int
    open_loop: float


class Decision(NamedTuple):
    """What a decision has found.

    Attributes:
        action: number of the action to take now.
        values: cost of each action; infinity where it was not tried.
        ways: the best ways, best first.
        waits: for how many ticks, from now on, all of the best ways go as φ.
    """

    action: int
    values: tuple[float, ...]
    ways: tuple[Way, ...]
    waits: int


class _Future:
    """One future: its draws, and the tree of what was tried in it."""

    __slots__ = ("best", "draws", "first", "root")

    def __init__(self, root: Node, draws: Draws) -> None:
        self.root, self.draws, self.first = root, draws, root.tick
        self.best: tuple[float, Way] | None = None


class Chance:
    """Uniform numbers, drawn a block at a time."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draw from `rng`."""
        self._numbers = self._drawn(rng)

    @staticmethod
    def _drawn(rng: np.random.Generator) -> Iterator[float]:
        while True:
            yield from rng.random(512).tolist()

    def share(self) -> float:
        """Return a number from [0, 1)."""
        return next(self._numbers)

    def below(self, count: int) -> int:
        """Return one of 0 … count − 1."""
        return int(next(self._numbers) * count)


def decide(
    course: Course,
    cost: Cost,
    moments: Sequence[tuple[Node, Draws]],
    remembered: Sequence[Way],
    size: Size,
    calls: int,
    as_phi: int,
    rng: np.random.Generator,
) -> Decision:
    """Return what to do now.

    Args:
        course: leads nodes of the episode on.
        cost: the cost of ways.
        moments: the present of each future, as it may be, and its random draws.
        remembered: ways that were good in the last decision.
        size: how much to try.
        calls: how many calls of controllers may be made; what has begun is finished.
        as_phi: the action that goes as φ.
        rng: generator of the ways that are tried.
    """
    search = _Search(course, cost, moments, size, course.calls + calls, as_phi, Chance(rng))
    search.begin(remembered)
    search.run()
    return search.decision()


class _Search:
    def __init__(
        self,
        course: Course,
        cost: Cost,
        moments: Sequence[tuple[Node, Draws]],
        size: Size,
        limit: int,
        as_phi: int,
        chance: Chance,
    ) -> None:
        self._course, self._cost, self._size, self._limit = course, cost, size, limit
        self._as_phi, self._chance = as_phi, chance
        self._futures = [_Future(root, draws) for root, draws in moments]
        self._actions = as_phi + 1
        self._least = [[math.inf] * len(moments) for _ in range(self._actions)]
        self._mean = [math.inf] * self._actions
        self._mean_way: list[Way] = [()] * self._actions
        self._ranked: list[tuple[float, Way]] = []
        self._known: set[Way] = set()
        self._room = 1  # ticks within which ways leave φ

    def _goes_on(self) -> bool:
        return self._course.calls < self._limit and len(self._known) < self._size.ways

    def begin(self, remembered: Sequence[Way]) -> None:
        """Try φ, every action alone, and what was good before."""
        phi = (self._as_phi,) * FORESIGHT
        self._try(phi, everywhere=True)
        self._room = max(self._length(future, phi) for future in self._futures)
        for action in range(self._actions):
            self._try((action,), everywhere=True)
        for number, way in enumerate(remembered):
            if self._course.calls >= self._limit:
                return
            self._try(way, at=number % len(self._futures), everywhere=number < _TRUSTED)

    def _length(self, future: _Future, way: Way) -> int:
        """Return for how many ticks a way that was tried lasted."""
        node: Node | None = future.root
        for count, action in enumerate(way):
            node = node.after[action] if node is not None and node.velocities else None
            if node is None or node.cost is not None:
                return count + 1
        return len(way)

    def run(self) -> None:
        """Try new ways until there are enough."""
        turn = idle = 0
        while self._goes_on() and idle < 50:
            future = turn % len(self._futures)
            turn += 1
            way = self._changed(future) if self._chance.share() < _MUTATED else self._drawn()
            if not way or way in self._known:
                idle += 1
                continue
            idle = 0
            self._try(way, at=future)

    def _drawn(self) -> Way:
        """Return: as φ until some tick, then an action for some ticks, perhaps another one, perhaps as φ again."""
        chance = self._chance
        way = [self._as_phi] * chance.below(self._room)
        way += [chance.below(self._actions)] * (1 + chance.below(4))
        if chance.share() < 0.5:
            way += [chance.below(self._actions)] * (1 + chance.below(4))
        if chance.share() < 0.3:
            way += [self._as_phi] * (1 + chance.below(self._room))
        return tuple(way)

    def _changed(self, future: int) -> Way:
        """Return a change of a way that is good in a future, or in all."""
        chance = self._chance
        best = self._futures[future].best
        ranked = self._ranked
        source = ranked[chance.below(min(len(ranked), 4))][1] if ranked and chance.share() < 0.4 else None
        if source is None:
            if best is None:
                return self._drawn()
            source = best[1]
        way = list(source[: self._room + 6])
        at = chance.below(len(way))
        kind = chance.below(8)
        if kind == 0 and len(way) > 1:
            del way[at]
        elif kind == 1:
            way.insert(at, chance.below(self._actions))
        elif kind == 2:
            way.insert(0, self._as_phi)
        elif kind == 3:
            way = way[: at + 1]
        elif kind == 4 and ranked:
            other = ranked[chance.below(len(ranked))][1]
            way = [*way[:at], *other[at:]]
        elif kind == 5:
            to = chance.below(len(way))
            way[at], way[to] = way[to], way[at]
        else:
            for tick in range(at, min(len(way), at + 1 + chance.below(3))):
                way[tick] = chance.below(self._actions)
        return tuple(way)

    def _try(self, way: Way, *, at: int = 0, everywhere: bool = False) -> None:
        """Find out what a way costs: in one future, and if it is good there for its first action, in all of them."""
        self._known.add(way)
        first, count, worth = way[0], len(self._futures), self._cost.worth
        # Who is as good everywhere need not be the best anywhere, so what counts is the mean, not each future's least.
        mean = self._mean[first]
        enough = math.inf if everywhere else min(mean, min(self._mean) + _HOPELESS * worth) + worth
        found = self._follow(at, way, enough)
        if found >= enough:
            return
        room = math.inf if everywhere else count * (mean + worth)
        total = found
        rest = sum(self._least[first]) - self._least[first][at]
        for further in range(1, count):
            future = (at + further) % count
            rest -= self._least[first][future]
            if total + rest >= room:
                return
            total += self._follow(future, way, math.inf)
        mean = total / count
        if mean <= self._mean[first]:
            self._mean[first], self._mean_way[first] = mean, way
        self._ranked.append((mean, way))
        self._ranked.sort(key=lambda one: one[0])
        del self._ranked[_REMEMBERED:]

    def _follow(self, index: int, way: Way, enough: float) -> float:
        """Return what a way costs in a future; infinity where that is at least `enough`."""
        future, course, cost = self._futures[index], self._course, self._cost
        node = future.root
        draws, first = future.draws, future.first
        walked: list[int] = []
        for action in way:
            walked.append(action)
            after = node.after[action]
            node = course.lead_on(node, action, draws, first) if after is None else after
            if node.cost is not None:
                break
            if cost.least(node.so_far, node.tick) >= enough:
                return math.inf
        while node.cost is None:
            if node.stood > _STANDING or len(walked) >= FORESIGHT:
                value = cost.missed(node.so_far)
                break
            action = course.towards(node)
            walked.append(action)
            node = course.lead_on(node, action, draws, first)
            if node.cost is None and cost.least(node.so_far, node.tick) >= enough:
                return math.inf
        else:
            value = node.cost
        taken = way[0]
        if value < self._least[taken][index]:
            self._least[taken][index] = value
        if future.best is None or value <= future.best[0]:  # an equal one, too: there are many, and some lead on
            future.best = (value, tuple(walked))
        return value

    def decision(self) -> Decision:
        """Weigh both estimates of each action."""
        share = self._size.open_loop
        values = [
            (1.0 - share) * float(np.mean(least)) + share * mean if mean < math.inf else math.inf
            for least, mean in zip(self._least, self._mean, strict=True)
        ]
        chosen = int(np.argmin(values))
        if values[self._as_phi] <= values[chosen] + _TIE:
            chosen = self._as_phi
        best = [future.best[1] for future in self._futures if future.best is not None]
        ways = (*(way for _, way in self._ranked), *best)
        leading = [*best, self._mean_way[chosen]]
        waits = min(self._departure(way) for way in leading) if leading else 1
        return Decision(chosen, tuple(values), tuple(dict.fromkeys(ways)), waits)

    def _departure(self, way: Way) -> int:
        """Return how many ticks a way goes as φ at first."""
        for count, action in enumerate(way):
            if action != self._as_phi:
                return count
        return len(way)
