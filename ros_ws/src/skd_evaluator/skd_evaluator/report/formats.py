"""Numbers and figures as people read them: on the page, on the terminal, and in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from skd_evaluator.assessment.judge.figure_table import CI95, PROBABILITY, SPEEDS, THESE_PHI, Figure
from skd_evaluator.metrics.margins import UPPER_BOUNDS
from skd_evaluator.metrics.surrogate.episode import SURROGATE_MEASURES

NOTHING = "–"


@dataclass(frozen=True)
class Style:
    """How something is written.

    Attributes:
        nothing: text for a number that is not defined.
        around: format of an interval, with a place for each end.
        minus: minus sign.
        percent: text that follows a percentage.
    """

    nothing: str
    around: str
    minus: str = "-"
    percent: str = " %"

    def number(self, value: float | None, digits: int = 3, unit: str = "") -> str:
        """Return a number with so many digits after the point, and its unit."""
        if value is None:
            return self.nothing
        return f"{value:.{digits}f}{unit and ' ' + unit}".replace("-", self.minus)

    def interval(self, ends: Sequence[float] | None, digits: int = 3) -> str:
        """Return an interval."""
        if ends is None:
            return self.nothing
        return self.around.format(*(f"{end:.{digits}f}" for end in ends)).replace("-", self.minus)

    def share(self, value: float | None, digits: int = 1) -> str:
        """Return a share as a percentage."""
        return self.nothing if value is None else f"{100.0 * value:.{digits}f}{self.percent}"

    def share_interval(self, ends: Sequence[float] | None, digits: int = 1) -> str:
        """Return an interval of shares, as percentages."""
        if ends is None:
            return self.nothing
        return self.around.format(*(f"{100.0 * end:.{digits}f}" for end in ends)) + self.percent

    def probability(self, value: float | None, digits: int = 2) -> str:
        """Return a probability, which may be very small, with so many significant digits."""
        return self.nothing if value is None else f"{value:#.{digits}g}"

    def probability_interval(self, ends: Sequence[float] | None, digits: int = 2) -> str:
        """Return an interval of probabilities."""
        return self.nothing if ends is None else self.around.format(*(f"{end:#.{digits}g}" for end in ends))

    def value(self, figure: Figure, result: Mapping[str, Any]) -> str:
        """Return a figure of an assessment; of one that is spoken, its text."""
        found = result.get(figure.key)
        if figure.spoken:
            return bounded(result, str(result[f"{figure.key}_text"] or self.nothing))
        if figure.key in UPPER_BOUNDS and found is not None:
            return bounded(result, self.number(found, figure.kind.digits))
        if figure.kind is SPEEDS:
            return self.number(found and found["mean"], figure.kind.digits)
        if figure.kind is PROBABILITY:
            return self.probability(found, figure.kind.digits)
        return (self.share if figure.kind.unit == "%" else self.number)(found, figure.kind.digits)

    def by_phi(self, figure: Figure, result: Mapping[str, Any]) -> str:
        """Return a figure's interval by φ."""
        return self._around(figure, result, CI95 if figure.by_phi else "")

    def independent(self, figure: Figure, result: Mapping[str, Any]) -> str:
        """Return a figure's interval that takes trials, pairs or runs as independent."""
        return self._around(figure, result, THESE_PHI if figure.spoken else figure.independent)

    def _around(self, figure: Figure, result: Mapping[str, Any], end: str) -> str:
        if figure.spoken:
            return spoken_interval(result, f"{figure.key}_{end or CI95}_text") or self.nothing
        found = result.get(f"{figure.key}_{end}") if end else None
        if figure.kind is PROBABILITY:
            return self.probability_interval(found, figure.kind.digits)
        return (self.share_interval if figure.kind.unit == "%" else self.interval)(found, figure.kind.digits)


PAGE = Style(NOTHING, "{} to {}", "−")
TERMINAL = Style("—", "[{}, {}]")
BARE = Style("—", "[{}, {}]", percent="")
"""Where the unit stands above."""
number, interval, percent, percent_interval = PAGE.number, PAGE.interval, PAGE.share, PAGE.share_interval


def ninety(figure: Figure, result: Mapping[str, Any]) -> str:
    """Return what 90 % of some speeds stay below, in words; of other figures nothing."""
    found = result.get(figure.key) if figure.kind is SPEEDS else None
    return f"90 % below {found['p90']:.{figure.kind.digits}f}" if found else ""


def bounded(result: Mapping[str, Any], text: str) -> str:
    """Return the text of a margin, or of what follows from it, as the bound that it is until the search converges.

    Args:
        result: content of assessment.json.
        text: a number, `above` or `below` one, or that there is none.
    """
    if result.get("margin_converged") is not False:
        return text
    if text.startswith("above"):
        return "not known"
    return f"at most {text}" if text[:1].isdigit() else text


def spoken_interval(result: Mapping[str, Any], key: str) -> str:
    """Return an interval of the equivalent multiplier as its text says; its upper end where the margin is a bound."""
    text = str(result.get(key) or "")
    if not text or result.get("margin_converged") is not False:
        return text
    return bounded(result, text.strip("[]").split(", ")[-1])


def counted(count: int, thing: str) -> str:
    """Return a number with its noun, which takes an s for all but one; thousands apart, φ as it is."""
    plural = thing if count == 1 or thing.endswith("φ") else f"{thing}s"
    return f"{count:,} {plural}"


NO_RATING = "They are no rating: they depend on who walks, and along φ nobody aims at the car."


def surrogate_groups(figures: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """Return who walks, and what the measures come to; nothing where there are none."""
    found = figures.get("surrogate_measures")
    if not found:
        return []
    kamikazes = [(f"kamikazes, {name}", group) for name, group in found["kamikazes"].items()]
    groups = [("along φ", found["along_phi"]), *kamikazes]
    return [(f"{name} ({group['episodes']})", group) for name, group in groups if group["episodes"]]


def surrogate_rows(figures: Mapping[str, Any]) -> list[tuple[str, list[str]]]:
    """Return each measure with its unit, and for each group median, worst and in how many episodes it is defined."""
    groups = [group for _, group in surrogate_groups(figures)]
    rows = []
    for name, measure in SURROGATE_MEASURES.items():
        label = f"{measure.label} ({measure.unit})" if measure.unit else measure.label
        cells = [group.get(name) or {"median": None, "worst": None, "defined": 0} for group in groups]
        texts = [[_surrogate(one["median"]), _surrogate(one["worst"]), str(one["defined"])] for one in cells]
        rows.append((label, [text for one in texts for text in one]))
    return rows


def _surrogate(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}" if 0.0 < abs(value) < 0.1 else f"{value:.2f}"
