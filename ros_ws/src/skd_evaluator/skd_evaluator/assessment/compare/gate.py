"""The gate: what an assessment has to reach, or must not fall behind, for a change of a car's software to pass."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from skd_evaluator.assessment.compare.comparison import (
    INCONCLUSIVE,
    LESS_SAFE,
    MARGIN,
    NOT_COMPARED,
    RISKS,
    SAME,
    Comparison,
    compare,
)
from skd_evaluator.assessment.files.assessment_json import figure, form_of
from skd_evaluator.assessment.files.results import StoredResult
from skd_evaluator.metrics.aborted import at_worst
from skd_evaluator.metrics.margins import UPPER_BOUNDS, longer_search, stopped_at


@dataclass(frozen=True)
class Limit:
    """A limit that a figure may not fall below, or not exceed.

    Attributes:
        name: name of the figure, as in `figure_names`.
        value: the limit, which the figure may just reach.
        is_least: whether the figure must not be below the limit; otherwise it must not be above it.
    """

    name: str
    value: float
    is_least: bool = True

    def is_kept_by(self, value: float) -> bool:
        """Whether a figure of this value keeps the limit."""
        return value >= self.value if self.is_least else value <= self.value

    def __str__(self) -> str:
        return f"{self.name} {'≥' if self.is_least else '≤'} {self.value:g}"


@dataclass(frozen=True)
class Check:
    """What became of one condition.

    Attributes:
        name: what is asked for, as the report of the gate calls it.
        text: what was found, in one line.
        failed: whether the car does not meet the condition.
        error: whether nothing can be said of the car, because the condition could not be checked.
        remarks: what a reader should know beside that, a line each.
    """

    name: str
    text: str
    failed: bool = False
    error: bool = False
    remarks: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether all is well."""
        return not (self.failed or self.error)

    @property
    def state(self) -> str:
        """`passed`, `failed` or `error`."""
        return "error" if self.error else "failed" if self.failed else "passed"


def check_limits(result: Mapping[str, Any], limits: Iterable[Limit]) -> list[Check]:
    """Check an assessment against limits.

    A figure that is not defined is an error, and so is one that would be judged otherwise had the car hit in every
    episode that was aborted.

    Args:
        result: content of assessment.json.
        limits: the limits that figures of the assessment have to keep.
    """
    return [_at_worst(result, limit, _check_limit(result, limit)) for limit in limits]


class Bound(NamedTuple):
    """Where a figure may be in truth that the search for the margin has but bounded.

    Attributes:
        beyond: the furthest that it may be.
        why: that it is a bound, in words.
    """

    beyond: float
    why: str


def bound_of(result: Mapping[str, Any], name: str) -> Bound | None:
    """Return where a figure may be, as the search for the margin has not converged; None where it is no bound."""
    of_curve = name.startswith("vulnerability_curve.margins.")
    less = name in UPPER_BOUNDS or (of_curve and name.endswith(".area_above"))
    more = name == "optimality_gap" or (of_curve and ".probability" in name)
    if result.get("margin_converged") is not False or not (less or more):
        return None
    what = "an upper bound" if less else "a lower bound"
    return Bound(
        0.0 if less else math.inf,
        f"the search for the margin {stopped_at(result)}, so this is {what}: {longer_search(result)}",
    )


def _check_limit(result: Mapping[str, Any], limit: Limit) -> Check:
    name, value, bound = str(limit), figure(result, limit.name), bound_of(result, limit.name)
    if value is None:
        return Check(name, f"{limit.name} is not defined, so it cannot be held against {limit.value:g}", error=True)
    beyond = not limit.is_kept_by(value)
    side = "below" if value < limit.value else "above" if value > limit.value else "at"
    shown = f"{value:{form_of(limit.name)}}"
    shown = shown if float(shown) != limit.value else f"{value:.6g}"
    text = f"{limit.name} is {shown}, {side} {limit.value:g}"
    if bound is not None and not beyond and not limit.is_kept_by(bound.beyond):
        return Check(name, f"not judged: {text}, but only a bound", error=True, remarks=(bound.why,))
    return Check(name, text, failed=beyond)


def _at_worst(result: Mapping[str, Any], limit: Limit, check: Check) -> Check:
    """Return a check as an error where the car may have hit in aborted episodes, and would be judged otherwise then."""
    worst = None if check.error else at_worst(result, limit.name)
    if worst is None or limit.is_kept_by(worst.value) == check.passed:
        return check
    lost = f"it would be {worst.value:.6g} if the car had hit in the {worst.of} that were aborted"
    return replace(check, text=f"not judged: {check.text}, and {lost}", failed=False, error=True)


def not_worse(mine: StoredResult, earlier: StoredResult, remarks: Iterable[str] = ()) -> Check:
    """Compare an assessment with an earlier one: it fails if a figure is surely worse, and none is surely better.

    A verdict that the car is less safe waits until no estimate points the other way; a gate does not. A car
    that would fall behind had it hit in every episode of its own that was aborted is an error.

    Args:
        mine: the assessment.
        earlier: the earlier result, behind which the car must not fall.
        remarks: what a reader should know of both beside that, a line each.
    """
    name = f"not worse than {earlier.folder}"
    found = compare(earlier, mine)
    judge, failed = found.behind_by or found.decided_by, found.behind_by is not None
    lines = tuple(dict.fromkeys((*earlier.remarks, *remarks, *found.refusals, *found.warnings)))
    if judge is None:
        few = "" if found.design == NOT_COMPARED else ": there are too few φ for an interval"
        return Check(name, f"{NOT_COMPARED}{few}", error=True, remarks=lines)
    if not mine.worst and found.is_same:
        return Check(name, f"no difference: {SAME}", remarks=lines)
    held = found.differences[judge]
    assert held.interval is not None
    low, high = held.interval
    by_how_much = f"{held.value:+.3f}" if judge in RISKS else f"{held.value:+.3f} m"
    said = f"{found.verdict} ({found.reason})" if found.reason else found.verdict
    said = said.replace(INCONCLUSIVE, "no clear difference")
    said = said if not failed or said.startswith(LESS_SAFE) else "worse"
    text = f"{said}: {judge} {by_how_much}, 95 % [{low:+.3f}, {high:+.3f}], {found.design}"
    if not failed and (why := _at_most(found) or _may_be_behind(earlier, mine)):
        return Check(name, f"not judged: {why}", error=True, remarks=(text, *lines))
    return Check(name, text, failed=failed, remarks=lines)


def _at_most(found: Comparison) -> str:
    """Return why a car may be behind by its margin, or an earlier result by its own; empty where that is known.

    An earlier margin that is an upper bound matters where it is the greater one.
    """
    margin = found.differences.get(MARGIN)
    earlier, mine = found.is_bound
    if mine or (earlier and margin is not None and margin.direction < 0):
        longer = longer_search((found.second if mine else found.first).figures)
        return f"the {'' if mine else 'earlier '}margin is an upper bound, so it is not known which is less; {longer}"
    return ""


def _may_be_behind(earlier: StoredResult, mine: StoredResult) -> str:
    """Return why a car may be behind an earlier result by its aborted episodes; empty where it is not."""
    scales = (mine.figures.get("risk") or {}).get("scales") or ()
    if unknown := [f"R({one['scale']:g})" for one in scales if one.get("subset_aborted")]:
        return f"{', '.join(unknown)} is not known, for crossings of subset simulation were aborted"
    at_worst = compare(earlier, replace(mine, groups={**mine.groups, **mine.worst})) if mine.worst else None
    if at_worst is None or at_worst.behind_by is None:
        return ""
    return f"it would be less safe by {at_worst.behind_by} if it had hit in all of its aborted episodes"
