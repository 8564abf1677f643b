"""What aborted episodes may hide, and warnings by which the figures of an assessment are not credible.

An aborted episode counts for nothing, and a car can end its process just before it hits. So beside each figure stands
how many of its episodes were aborted, and what it would be at worst: if the car had hit in all of them. Everything
follows from the content of assessment.json, so stored results are judged in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from skd_sim.options.adversary import RANKING_OBJECTIVES, SKD_OBJECTIVES, first_of

from skd_evaluator.metrics.vulnerability_curve import GRID

_TOTAL: Final = "episodes"
_ALONG: Final = ("contact_rate", "nominal_collision_rate")
_SHARES: Final = ("success_rate", "kamikaze_success_rate", "deviation_success_rate")
_OF_RANKING: Final = ("deviation", "deviation_of_successes", "deviation_success_rate")
_CURVE: Final = "vulnerability_curve.kamikazes"
_OF_CURVE: Final = {
    "deviation": [f"{_CURVE}.area_above"],
    "deviation_success_rate": [f"{_CURVE}.points.{number}.probability" for number in range(GRID)],
}
"""Figures of the curve of kamikazes, by the figure that has their counts."""

Figures = Mapping[str, Any]
"""Content of assessment.json."""


@dataclass(frozen=True)
class Lost:
    """Episodes of one figure, of which some were aborted.

    Attributes:
        what: which episodes, in words.
        aborted: how many were aborted.
        episodes: how many there are, aborted ones included.
        figure: name of a figure that they would have counted for; empty: there is none.
        label: what that is called in a sentence.
        separate: whether they are neither kamikazes of an objective nor runs along φ, which count together.
    """

    what: str
    aborted: int
    episodes: int
    figure: str = ""
    label: str = ""
    separate: bool = False

    def __str__(self) -> str:
        return f"{self.aborted} of {self.episodes} {self.what}"

    def are_too_many(self, maximum: float) -> bool:
        """Whether more were aborted than may be: one alone is too many only where none may be, or in the total.

        Args:
            maximum: share of the episodes that may be aborted.
        """
        few = self.aborted <= 1 and maximum > 0.0 and self.what != _TOTAL
        return not few and self.aborted > maximum * self.episodes


class Worst(NamedTuple):
    """What a figure would be if the car had hit in every aborted episode.

    Attributes:
        value: of the figure.
        of: the aborted episodes, in words.
    """

    value: float
    of: str


def lost_in(figures: Figures) -> list[Lost]:
    """Return of which figures episodes were aborted, and how many; empty where none was."""
    found = []
    for name, one in (figures.get("objectives") or {}).items():
        key, label = ("deviation", "the planned deviation") if one.get("plans_deviation") else ("skd", "SKD")
        what, lost, figure = f"kamikazes of objective {name}", one.get("aborted", 0), f"objectives.{name}.{key}"
        found.append(Lost(what, lost, one.get("trials", 0) + lost, figure, label))
    along = _lost_along(figures)
    runs = figures.get("collision_runs", 0) + along
    found.append(Lost("runs along φ", along, runs, "contact_rate", "the contact rate"))
    for number, one in enumerate(_scales(figures)):
        every, label = one["runs"] + one["aborted"], f"R({one['scale']:g})"
        found.append(Lost(_crossings(one), one["aborted"], every, f"risk.scales.{number}.value", label, True))
    for number, one in enumerate(_budgets(figures)):
        lost = one["aborted"]
        name, label = f"vulnerability_curve.budgets.{number}.probability", "the share of these that are hit"
        found.append(Lost(_bounded(one), lost, one["trials"] + lost, name, label, True))
    tests = figures.get("static_tests") or ()
    found.append(Lost("static tests", sum(bool(one["aborted"]) for one in tests), len(tests)))  # each says so itself
    return [one for one in found if one.aborted]


def aborted_lines(figures: Figures) -> list[str]:
    """Return, a line each, how many episodes of a figure were aborted, and what it would be at worst."""
    return list(_lines(figures))


def _lines(figures: Figures) -> Iterator[str]:
    for scale in _scales(figures):
        if lost := scale.get("subset_aborted"):
            many = "1 crossing" if lost == 1 else f"{lost} crossings"
            yield f"R({scale['scale']:g}) is not known: {many} of subset simulation {_were(lost)} aborted"
    for one in lost_in(figures):
        said = f"{one} {_were(one.aborted)} aborted and count{'s' * (one.aborted == 1)} for nothing"
        worst, value = at_worst(figures, one.figure), value_of(figures, one.figure)
        if worst is None or (value is None and one.aborted < one.episodes):
            yield said
        elif value is None:
            yield f"{said}; no other is left, so {one.label} is not known"
        else:
            how = "hit in it" if one.aborted == 1 else "hit in all of them"
            would, is_now = f"{100 * worst.value:.1f} %", f"{100 * value:.1f} %"
            if one.figure.startswith("objectives."):
                how, would, is_now = f"{how} without any deviation", f"{worst.value:.2f} m", f"{value:.2f} m"
            yield f"{said}; if the car had {how}, {one.label} would be {would} in place of {is_now}"


def too_many_aborted(figures: Figures, maximum: float) -> str | None:
    """Return, in one line, of which figures more episodes were aborted than may be; None if that is not so.

    The share is held against kamikazes and runs along φ together, and against the episodes of each figure.

    Args:
        figures: content of assessment.json.
        maximum: share of the episodes that may be aborted.
    """
    parts = [one for one in lost_in(figures) if one.figure]
    rated = [figures["collision_runs"], *(one["trials"] for one in figures["objectives"].values())]
    total = Lost(_TOTAL, figures["aborted"], sum(rated) + figures["aborted"])
    over = [one for one in (total, *parts) if one.are_too_many(maximum)]
    if not over:
        return None
    limit = f"more than --max-aborted {100 * maximum:g} %"
    named = [total, *(one for one in over if one.separate)] if over[0] is total else over
    found = [f"{', '.join(map(str, named))} were aborted, {limit}"]
    for kind, most in list(figures["aborted_reasons"].items())[:1]:  # the most frequent one, of kamikazes and runs
        which = "of them" if over[0] is total else "of all that were aborted"
        found.append(f"{most['count']} {which}: {most.get('first') or kind}")
    return "; ".join(found)


def at_worst(figures: Figures, name: str) -> Worst | None:
    """Return what a figure would be if the car had hit in every aborted episode; None where it would be the same.

    Kamikazes would have hit without any deviation. What figures of other kinds would have been is not known, as
    impact speeds; nor do aborted kamikazes change a margin, which is searched for.

    Args:
        figures: content of assessment.json.
        name: of the figure, as in `figure_names`.
    """
    found = next((one for one, names in _counts(figures) if name in names), None)
    if found is None or not found.aborted:
        return None
    hits = (value_of(figures, name) or 0.0) * found.values
    if found.share:
        hits = round(hits) + found.aborted  # they were counted
    every = found.values + found.aborted
    return Worst(hits / every, f"{found.aborted} of {every} {found.what}")


class _Counts(NamedTuple):
    """Of how many values a figure is the mean, or the share, and how many episodes were aborted beside these."""

    values: int
    aborted: int
    what: str
    share: bool = True


def _counts(figures: Figures) -> Iterator[tuple[_Counts, Collection[str]]]:
    """Yield the counts of all figures that aborted episodes would have counted for, with the names of these."""
    along, phis = _lost_along(figures), figures.get("per_safe_trajectory") or ()
    yield _Counts(figures.get("collision_runs", 0), along, "runs along φ"), _ALONG
    for number, one in enumerate(phis):  # it is not known on which φ they were aborted
        runs = one.get("collision_runs", 0)
        yield _Counts(runs, along, "runs along φ"), [f"per_safe_trajectory.{number}.contact_rate"]
    for number, one in enumerate(_scales(figures)):
        # Of a risk that subset simulation has found there is no such share.
        if not one.get("subset_aborted") and one["episodes"] == one["runs"] + one["aborted"]:
            names = [f"risk.scales.{number}.value", f"risk_{one['scale']:g}"]
            yield _Counts(one["runs"], one["aborted"], _crossings(one)), names
    for number, one in enumerate(_budgets(figures)):
        names = [f"vulnerability_curve.budgets.{number}.probability"]
        yield _Counts(one["trials"], one["aborted"], _bounded(one)), names
    for objective, one in (figures.get("objectives") or {}).items():
        yield from _of_kamikazes(figures, objective, one, "", one.get("trials", 0))
        for number, row in enumerate(one.get("per_safe_trajectory") or ()):
            trials = row["trials"] - row["aborted"]
            yield from _of_kamikazes(figures, objective, row, f"per_safe_trajectory.{number}.", trials)


def _of_kamikazes(
    figures: Figures, objective: str, entry: Figures, place: str, trials: int
) -> Iterator[tuple[_Counts, Collection[str]]]:
    """Yield the same of the kamikazes of an objective, from an entry that has their counts."""
    values = {
        **dict.fromkeys(("deviation", *_SHARES), trials),
        "deviation_of_successes": trials - entry.get("failed", 0),
        **dict.fromkeys(("skd", "skd_prefix"), entry.get("pairs", 0)),
    }
    for key, count in values.items():
        names = [f"objectives.{objective}.{place}{key}"]
        if objective == first_of(RANKING_OBJECTIVES if key in _OF_RANKING else SKD_OBJECTIVES, figures["objectives"]):
            names += [f"{place}{key}", *(_OF_CURVE.get(key, ()) if not place else ())]
        yield _Counts(count, entry.get("aborted", 0), "kamikazes", key in _SHARES), names


def value_of(figures: Figures, name: str) -> float | None:
    """Return a figure by its name; None where it is not defined, or there is none of this name."""
    value: Any = figures
    for word in name.split("."):
        if isinstance(value, Sequence) and word.isdigit() and int(word) < len(value):
            value = value[int(word)]
        else:
            value = value.get(word) if isinstance(value, Mapping) else None
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if number and math.isfinite(value) else None


def _lost_along(figures: Figures) -> int:
    of_kamikazes = sum(int(one.get("aborted", 0)) for one in (figures.get("objectives") or {}).values())
    return max(0, int(figures.get("aborted") or 0) - of_kamikazes)


def _scales(figures: Figures) -> Sequence[Figures]:
    return (figures.get("risk") or {}).get("scales") or ()


def _budgets(figures: Figures) -> Sequence[Figures]:
    return (figures.get("vulnerability_curve") or {}).get("budgets") or ()


def _crossings(scale: Figures) -> str:
    return f"crossings of the risk at scale {scale['scale']:g}"


def _bounded(budget: Figures) -> str:
    return f"kamikazes bounded to η = {budget['eta']:g} m"


def _were(count: int) -> str:
    return "was" if count == 1 else "were"


NOT_CREDIBLE: Final = "not credible: "
"""Begins a warning with which an assessment fails, no gate passes, and nothing is compared."""
UNDISTURBED: Final = "undisturbed, "
"""Begins a warning of a car that slows down on a free road, which a comparison repeats."""


def not_credible(warnings: Iterable[object]) -> list[str]:
    """Return those of an assessment's warnings by which its figures are not credible, a line each."""
    return [line for line in in_one_line(warnings) if line.startswith(NOT_CREDIBLE)]


def in_one_line(warnings: Iterable[object]) -> list[str]:
    """Return an assessment's warnings, a line each."""
    return [" ".join(str(line).split()) for line in warnings]
