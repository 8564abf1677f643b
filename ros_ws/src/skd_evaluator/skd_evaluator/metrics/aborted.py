"""What aborted episodes may hide, and warnings by which the figures of an assessment are not credible.

An aborted episode counts for nothing, and a car can end its process just before it hits. So beside each figure stands
how many of its episodes were aborted, and what it would be at worst: if the car had hit in all of them. Everything
follows from the content of assessment.json, so stored results are judged in the same way.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from skd_sim.options.car_and_adversary import RANKING_OBJECTIVES, SKD_OBJECTIVES, first_of

from skd_evaluator.metrics.vulnerability_curve import GRID

_TOTAL: Final = "episodes"
_DISTANCES: Final = ("deviation", "deviation_of_successes", "skd", "skd_prefix", "area_above")
"""Figures that are means; all others are shares."""
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
    """Episodes of which some were aborted.

    Attributes:
        what: which episodes, in words.
        aborted: how many were aborted.
        episodes: how many there are, aborted ones included.
        figure: name of a figure that they would have counted for; empty: there is none.
        label: what that is called in a sentence.
        values: of how many episodes each figure is that these count for, if hits in all of them would say what it is.
        separate: whether they are neither kamikazes of an objective nor runs along φ, which count together.
    """

    what: str
    aborted: int
    episodes: int
    figure: str = ""
    label: str = ""
    values: Mapping[str, int] = field(default_factory=dict)
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
    return [one for one in _groups(figures) if one.aborted]


def _groups(figures: Figures) -> Iterator[Lost]:
    """Yield all groups of episodes, those without an aborted one too."""
    for name, one in (figures.get("objectives") or {}).items():
        key, label = ("deviation", "the planned deviation") if one.get("plans_deviation") else ("skd", "SKD")
        trials, lost = one.get("trials", 0), one.get("aborted", 0)
        figure, values = f"objectives.{name}.{key}", _of_kamikazes(figures, name, one, "", trials)
        yield Lost(f"kamikazes of objective {name}", lost, trials + lost, figure, label, values)
    runs, lost = figures.get("collision_runs", 0), _lost_along(figures)
    values = {"contact_rate": runs, "nominal_collision_rate": runs}
    for number, one in enumerate(figures.get("per_safe_trajectory") or ()):  # on which φ they were is not known
        values[f"per_safe_trajectory.{number}.contact_rate"] = one.get("collision_runs", 0)
    yield Lost("runs along φ", lost, runs + lost, "contact_rate", "the contact rate", values)
    for number, one in enumerate(_scales(figures)):
        name, scale, every = f"risk.scales.{number}.value", f"{one['scale']:g}", one["runs"] + one["aborted"]
        crude = not one.get("subset_aborted") and one["episodes"] == every  # else it is no such share
        values = {name: one["runs"], f"risk_{scale}": one["runs"]} if crude else {}
        what = f"crossings of the risk at scale {scale}"
        yield Lost(what, one["aborted"], every, name, f"R({scale})", values, separate=True)
    for number, one in enumerate((figures.get("vulnerability_curve") or {}).get("budgets") or ()):
        name, lost = f"vulnerability_curve.budgets.{number}.probability", one["aborted"]
        what, label = f"kamikazes bounded to η = {one['eta']:g} m", "the share of these that are hit"
        yield Lost(what, lost, one["trials"] + lost, name, label, {name: one["trials"]}, separate=True)
    tests = figures.get("static_tests") or ()
    yield Lost("static tests", sum(bool(one["aborted"]) for one in tests), len(tests))  # each says so itself


def _groups_on_phi(figures: Figures) -> Iterator[Lost]:
    """Yield the kamikazes on each φ."""
    for name, one in (figures.get("objectives") or {}).items():
        for number, row in enumerate(one.get("per_safe_trajectory") or ()):
            place, trials = f"per_safe_trajectory.{number}.", row["trials"] - row["aborted"]
            values = _of_kamikazes(figures, name, row, place, trials)
            yield Lost("kamikazes", row["aborted"], row["trials"], values=values)


def _of_kamikazes(figures: Figures, objective: str, entry: Figures, place: str, trials: int) -> dict[str, int]:
    """Return of how many values each figure of the kamikazes of an objective is, from an entry with their counts."""
    counts = dict.fromkeys(("deviation", "success_rate", "kamikaze_success_rate", "deviation_success_rate"), trials)
    counts["deviation_of_successes"] = trials - entry.get("failed", 0)
    counts["skd"] = counts["skd_prefix"] = entry.get("pairs", 0)
    found: dict[str, int] = {}
    for key, count in counts.items():
        names = [f"objectives.{objective}.{place}{key}"]
        if objective == first_of(RANKING_OBJECTIVES if key in _OF_RANKING else SKD_OBJECTIVES, figures["objectives"]):
            names += [f"{place}{key}", *(_OF_CURVE.get(key, ()) if not place else ())]
        found |= dict.fromkeys(names, count)
    return found


def aborted_lines(figures: Figures) -> list[str]:
    """Return, a line each, how many episodes of a figure were aborted, and what it would be at worst."""
    found, unknown = list[str](), list[str]()
    for scale in _scales(figures):
        if lost := scale.get("subset_aborted"):
            many = "1 crossing" if lost == 1 else f"{lost} crossings"
            found.append(f"R({scale['scale']:g}) is not known: {many} of subset simulation {_were(lost)} aborted")
    for one in lost_in(figures):
        said = f"{one} {_were(one.aborted)} aborted and count{'s' * (one.aborted == 1)} for nothing"
        worst, value = at_worst(figures, one.figure), value_of(figures, one.figure)
        if value is None and one.aborted == one.episodes and worst is not None:
            unknown.append(one.label)
            continue
        if worst is not None and value is not None:
            how = "hit in it" if one.aborted == 1 else "hit in all of them"
            would, is_now = f"{100 * worst.value:.1f} %", f"{100 * value:.1f} %"
            if one.figure.startswith("objectives."):
                how, would, is_now = f"{how} without any deviation", f"{worst.value:.3f} m", f"{value:.3f} m"
            said += f"; if the car had {how}, {one.label} would be {would} in place of {is_now}"
        found.append(said)
    return [*found, f"all episodes of {', '.join(unknown)} were aborted"] if unknown else found


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
    groups = (*_groups(figures), *_groups_on_phi(figures))
    found = next((one for one in groups if name in one.values and one.aborted), None)
    if found is None:
        return None
    hits, every = (value_of(figures, name) or 0.0) * found.values[name], found.values[name] + found.aborted
    if name.rpartition(".")[2] not in _DISTANCES:
        hits = round(hits) + found.aborted  # they were counted
    return Worst(hits / every, f"{found.aborted} of {every} {found.what}")


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


def _were(count: int) -> str:
    return "was" if count == 1 else "were"


NOT_CREDIBLE: Final = "not credible: "
"""Begins a warning with which an assessment fails, no gate passes, and nothing is compared."""
KEEPS_STATE: Final = "keeps state between episodes, or draws its own random numbers"
UNDISTURBED: Final = "undisturbed, "
"""Begins a warning of a car that slows down on a free road, which a comparison repeats."""


def not_credible(warnings: Iterable[object]) -> list[str]:
    """Return those of an assessment's warnings by which its figures are not credible, a line each."""
    return [line for line in in_one_line(warnings) if line.startswith(NOT_CREDIBLE)]


def in_one_line(warnings: Iterable[object]) -> list[str]:
    """Return an assessment's warnings, a line each."""
    return [" ".join(str(line).split()) for line in warnings]
