"""The most likely failures of a result in words: kinds with their shares, and those that are kept of each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from skd_evaluator.report.formats import percent


@dataclass(frozen=True)
class KeptFailure:
    """A failure that is kept.

    Attributes:
        kind: what the walker did.
        row: number of the crossing.
        rank: how many of its kind are nearer to how people walk.
        deviation: from φ, in standard deviations of people.
        people: share of people who deviate as much or more.
        scale: by which all deviations were multiplied.
    """

    kind: str
    row: int
    rank: int
    deviation: float
    people: float
    scale: float

    @property
    def text(self) -> str:
        """What somebody did."""
        scaled = f", deviations times {self.scale:g}" if self.scale != 1.0 else ""
        return f"as people walk{scaled}: {self.kind}"

    @property
    def likely(self) -> str:
        """How likely such deviations are, in words."""
        return f"{how_many(self.people)} deviate as much or more"


def how_many(people: float) -> str:
    """Return a share of people in words."""
    if people < 5e-4:
        return f"1 in {1.0 / people:,.0f} people" if people > 1e-9 else "hardly anybody"
    if people > 0.995:
        return "nearly all people"
    return f"{percent(people, 0 if people >= 0.01 else 1)} of people"


def kept_failures(figures: Mapping[str, Any]) -> list[KeptFailure]:
    """Return the failures that are kept, kind by kind, the most frequent kind first; none where there are none."""
    found = failures_in(figures)
    if found is None:
        return []
    phis = len(figures["per_safe_trajectory"])
    return [
        KeptFailure(
            str(group["kind"]),
            one["trial"] * phis + one["safe_trajectory"],
            rank,
            one["deviation"],
            one["people"],
            found["scale"],
        )
        for group in found["kinds"]
        for rank, one in enumerate(group["nearest"])
    ]


def failures_in(figures: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """Return the failures of assessment.json; None where there are none."""
    risk = figures.get("risk")
    found: Mapping[str, Any] | None = risk.get("failures") if risk else None
    return found


def failures_sentence(figures: Mapping[str, Any]) -> str:
    """Return what the failures are of; empty where there are none."""
    found = failures_in(figures)
    if found is None:
        return ""
    scaled = "" if found["scale"] == 1.0 else f" whose deviations are {found['scale']:g} times as large"
    first = "" if found["looked_at"] == found["hits"] else f" (the first {found['looked_at']} are told apart)"
    return f"{found['hits']} of {found['runs']} crossings of people{scaled} ended in a hit by the moving car{first}."
