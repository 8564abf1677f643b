"""Why an episode can be aborted: the kinds, and how a reason begins with its kind, on the wire, in bags and in reports.

An aborted episode says nothing about the car: it counts in no rate. The reason says which process caused it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from enum import StrEnum


class AbortKind(StrEnum):
    """Kind of fault. A reason is a kind, a colon and what is known of it."""

    NO_ANSWER = "no answer"  # who has to answer was silent for too long
    LOST = "messages lost"  # on the way; nobody in particular is to blame
    NOT_STARTED = "not started"  # nobody was ever there
    ENDED = "process ended"  # by itself, or killed
    NOT_FINITE = "not a finite number"
    WRONG_STAMP = "wrong stamp"  # an answer to another tick
    SECOND_SENDER = "second sender"  # more than one answer, or more than one who answers
    REFUTED = "refuted"  # by where car and adversary were
    SLIPPED = "pacing slipped"  # the simulator did not keep real time
    FAILED = "failed"  # it said so itself
    OTHER = "other"


def abort_reason(kind: AbortKind, what: str) -> str:
    """Return the reason of an aborted episode, in one line."""
    return f"{kind}: {' '.join(what.split())}"


def kind_of(reason: str) -> AbortKind:
    """Return the kind of a reason; `OTHER` if it names none."""
    head = reason.partition(":")[0]
    return AbortKind(head) if head in frozenset(AbortKind) else AbortKind.OTHER


def counted_reasons(reasons: Iterable[str]) -> dict[str, dict[str, int | str]]:
    """Return kind → how often, and the first reason of that kind; the most frequent first."""
    all_reasons = list(reasons)
    counts = Counter(map(kind_of, all_reasons))
    first = {kind_of(reason): reason for reason in reversed(all_reasons)}
    return {str(kind): {"count": count, "first": first[kind]} for kind, count in counts.most_common()}


def counts_in_words(reasons: Iterable[str]) -> str:
    """Return in a few words how many reasons there are of each kind, the most frequent first."""
    return ", ".join(f"{one['count']} {kind}" for kind, one in counted_reasons(reasons).items())
