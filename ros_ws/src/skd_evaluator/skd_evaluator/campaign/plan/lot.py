"""What is looked at again, drawn by lot: who knew it beforehand could be honest in that alone.

No figure depends on it, so it follows from no seed: a car may know that.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Sequence
from typing import TypeVar

_Item = TypeVar("_Item")
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
