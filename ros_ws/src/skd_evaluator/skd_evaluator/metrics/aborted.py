"""What aborted episodes may hide, and warnings by which the figures of an assessment are not credible.

An aborted episode counts for nothing, and a car can end its process just before it hits. So beside each figure stands
how many of its episodes were aborted, and what it would be at worst: if the car had hit in all of them. Everything
follows from the content of assessment.json, so stored results are judged in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from skd_sim.options.adversary import RANKING_OBJECTIVES, SKD_OBJECTIVES, first_of

_TOTAL: Final = "episodes"
_ALONG: Final = ("contact_rate", "nominal_collision_rate")
_SHARES: Final = ("success_rate", "kamikaze_success_rate", "deviation_success_rate")
_OF_RANKING: Final = ("deviation", "deviation_of_successes", "deviation_success_rate")

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
        found.append(Lost(_held(one), lost, one["trials"] + lost, name, label, True))
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
        worst, value = at_worst(figures, one.figure), _value(figures, one.figure.split("."))
        if worst is None or (value is None and one.aborted < one.episodes):
            yield said
        elif value is None:
            yield f"{said}; no other is left, so {one.label} is not known"
        else:
            shown = _metres if one.figure.startswith("objectives.") else _percent
            how = "hit in it" if one.aborted == 1 else "hit in all of them"
            where = " without any deviation" if shown is _metres else ""
            yield (
                f"{said}; if the car had {how}{where}, {one.label} would be {shown(worst.value)} in place of "
                f"{shown(value)}"
            )


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

    Kamikazes would have hit without any deviation. Nobody knows what figures of other kinds would have been, as
    impact speeds; nor do aborted kamikazes change a margin, which is searched for.

    Args:
        figures: content of assessment.json.
        name: of the figure, as in `figure_names`.
    """
    words = name.split(".")
    value, found = _value(figures, words), _counts(figures, words)
    if found is None or not found.aborted:
        return None
    hits = 0.0 if value is None else value * found.values
    if found.share:
        hits = round(hits) + found.aborted  # they were counted
    return Worst(
        hits / (found.values + found.aborted), f"{found.aborted} of {found.values + found.aborted} {found.what}"
    )


class _Counts(NamedTuple):
    """Of how many values a figure is the mean, or the share, and how many episodes were aborted beside these."""

    values: int
    aborted: int
    what: str
    share: bool


def _counts(figures: Figures, words: Sequence[str]) -> _Counts | None:
    match words:
        case [key] if key in _ALONG:
            return _Counts(figures.get("collision_runs", 0), _lost_along(figures), "runs along φ", True)
        case ["per_safe_trajectory", number, "contact_rate"]:  # nobody says on which φ they were aborted
            runs = _entry(figures, "per_safe_trajectory", number).get("collision_runs", 0)
            return _Counts(runs, _lost_along(figures), "runs along φ", True)
        case ["per_safe_trajectory", number, key]:
            return _counts(figures, ["objectives", _objective(figures, key), "per_safe_trajectory", number, key])
        case ["objectives", name, "per_safe_trajectory", number, key]:
            row = _entry(figures, "objectives", name, "per_safe_trajectory", number)
            return _of_kamikazes(row, row.get("trials", 0) - row.get("aborted", 0), key)
        case ["objectives", name, key]:
            one = _entry(figures, "objectives", name)
            return _of_kamikazes(one, one.get("trials", 0), key)
        case ["risk", "scales", number, "value"]:
            return _of_crossings(_entry(figures, "risk", "scales", number))
        case [key] if key.startswith("risk_"):
            return next((_of_crossings(one) for one in _scales(figures) if f"risk_{one['scale']:g}" == key), None)
        case ["vulnerability_curve", "budgets", number, "probability"]:
            one = _entry(figures, "vulnerability_curve", "budgets", number)
            return _Counts(one.get("trials", 0), one.get("aborted", 0), f"kamikazes held to η = {one['eta']:g} m", True)
        case ["vulnerability_curve", "kamikazes", "points", _, "probability"]:
            return _counts(figures, ["deviation_success_rate"])
        case ["vulnerability_curve", "kamikazes", "area_above"]:
            return _counts(figures, ["deviation"])
        case [key]:
            return _counts(figures, ["objectives", _objective(figures, key), key])
    return None


def _of_kamikazes(entry: Figures, trials: int, key: str) -> _Counts | None:
    """Return the same of a figure of kamikazes, from an entry that has their counts."""
    counts = {
        **dict.fromkeys(("deviation", *_SHARES), trials),
        "deviation_of_successes": trials - entry.get("failed", 0),
        **dict.fromkeys(("skd", "skd_prefix"), entry.get("pairs", 0)),
    }
    return _Counts(counts[key], entry.get("aborted", 0), "kamikazes", key in _SHARES) if key in counts else None


def _of_crossings(one: Figures) -> _Counts | None:
    """Return the same of a risk that is a share of crude crossings; None of one that subset simulation has found."""
    if not one or one.get("subset_aborted") or one["episodes"] != one["runs"] + one["aborted"]:
        return None
    return _Counts(one["runs"], one["aborted"], _crossings(one), True)


def _objective(figures: Figures, key: str) -> str:
    """Return the objective of which a figure at the top is."""
    ran = figures.get("objectives")
    return str(first_of(RANKING_OBJECTIVES if key in _OF_RANKING else SKD_OBJECTIVES, ran)) if ran else ""


def _value(figures: Figures, words: Sequence[str]) -> float | None:
    value = _inside(figures, words)
    return float(value) if isinstance(value, (int, float)) and math.isfinite(value) else None


def _entry(figures: Figures, *words: str) -> Figures:
    found = _inside(figures, words)
    return found if isinstance(found, Mapping) else {}


def _inside(figures: Figures, words: Sequence[str]) -> Any:
    value: Any = figures
    for word in words:
        if isinstance(value, Sequence) and word.isdigit() and int(word) < len(value):
            value = value[int(word)]
        else:
            value = value.get(word) if isinstance(value, Mapping) else None
    return value


def _lost_along(figures: Figures) -> int:
    of_kamikazes = sum(int(one.get("aborted", 0)) for one in (figures.get("objectives") or {}).values())
    return max(0, int(figures.get("aborted") or 0) - of_kamikazes)


def _scales(figures: Figures) -> Sequence[Figures]:
    return (figures.get("risk") or {}).get("scales") or ()


def _budgets(figures: Figures) -> Sequence[Figures]:
    return (figures.get("vulnerability_curve") or {}).get("budgets") or ()


def _crossings(scale: Figures) -> str:
    return f"crossings of the risk at scale {scale['scale']:g}"


def _held(budget: Figures) -> str:
    return f"kamikazes held to η = {budget['eta']:g} m"


def _were(count: int) -> str:
    return "was" if count == 1 else "were"


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def _metres(value: float) -> str:
    return f"{value:.2f} m"


NOT_CREDIBLE: Final = "not credible: "
"""Begins a warning with which an assessment fails, no gate passes, and nothing is compared."""
UNDISTURBED: Final = "with nobody near, "
"""Begins a warning of a car that slows down for nobody, which a comparison repeats."""


def not_credible(warnings: Iterable[object]) -> list[str]:
    """Return those of an assessment's warnings by which its figures are not credible, a line each."""
    return [line for line in in_one_line(warnings) if line.startswith(NOT_CREDIBLE)]


def in_one_line(warnings: Iterable[object]) -> list[str]:
    """Return an assessment's warnings, a line each."""
    return [" ".join(str(line).split()) for line in warnings]
