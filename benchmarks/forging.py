"""What forgeries of recordings share: a kind of message changed wherever it is sent, an episode drawn."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from bag_forge import EPISODE, RESULT, Sent
from mutators import pick

Forgery = Callable[[list[Sent], np.random.Generator], tuple[list[Sent], str]]
"""Forges a recording: (its messages, draws) → messages, and what was done."""


def each(sent: Sequence[Sent], topics: Sequence[str], edit: Callable[[Any], Any]) -> list[Sent]:
    """Return messages of which those on some topics are edited."""
    return [dataclasses.replace(one, content=edit(one.content)) if one.topic in topics else one for one in sent]


def episode_of(sent: Sequence[Sent], rng: np.random.Generator) -> tuple[int, int]:
    """Return where an episode begins and where its result is; they stand one after the other."""
    first = pick(rng, [place for place, one in enumerate(sent) if one.topic == EPISODE])
    return first, next(place for place in range(first, len(sent)) if sent[place].topic == RESULT)
