"""What the page says in words, tables of figures, and the matrix of cars and scenarios."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from skd_evaluator.assessment.compare.comparison import compare
from skd_evaluator.assessment.figure_table import AT_THE_TOP
from skd_evaluator.assessment.files.results import read_result
from skd_evaluator.metrics.aborted import aborted_lines
from skd_evaluator.metrics.price_of_caution import does_not_get_past
from skd_evaluator.report import formats
from skd_evaluator.report import warnings as of_assessments
from skd_evaluator.report.html.subjects import Subject, scenarios_of
from skd_evaluator.report.terminal import credibility, headline

_FEW = 3
"""Most pairs of cars that a sentence names."""


def state_of(subject: Subject) -> str:
    """Return whether a rating can be believed: `failed` (there is none), `doubtful` (read the warnings) or `fine`."""
    figures = subject.figures
    if figures["margin"] is None and figures["deviation"] is None:
        return "failed"
    return "doubtful" if warnings_of(subject) else "fine"


def sentences_of(subject: Subject) -> list[str]:
    """Return what was found about a car: the headline of the terminal, and what planned kamikazes came to beside it."""
    figures, ranking = subject.figures, subject.ranking
    if state_of(subject) == "failed":
        aborted = figures["aborted"]
        why = f"{formats.counted(aborted, 'episode')} were aborted" if aborted else "none was planned"
        return [f"This is no rating: no kamikaze ran to its end ({why}). It says nothing about the car."]
    found = [headline(figures, named=False)]  # the name stands above
    if figures["margin"] is not None and figures["margin_beyond"] < figures["margin_trials"]:
        deviates = f"The {subject.scenario.adversary.kind} may deviate by {_bounded(subject, 'margin')} on average"
        found.append(f"{deviates} before the moving car hits. More is better. Ranges are 95 % intervals.")
    if figures["deviation"] is None:
        return [*found, "No planned kamikaze ran to its end."]
    adversary_model = figures.get("adversary_model")
    known = f" (adversary model: {adversary_model})" if adversary_model else ""
    kamikazes, hit = formats.counted(ranking["trials"], "kamikaze"), ranking["trials"] - ranking["failed"]
    if not hit:
        return [*found, f"None of {kamikazes}{known} was hit."]
    enough = ranking["failed"] and hit == figures["margin_trials"]
    until = f" until {hit} were hit" if enough else f"; {hit} of them were hit"
    planned = f"{kamikazes}{known} were planned{until}"
    counts = f"; one that was not hit counts as {figures['eta_max']:g} m" if ranking["failed"] else ""
    return [*found, f"{planned}. They needed {formats.number(figures['deviation'], 3, 'm')} on average{counts}."]


def warnings_of(subject: Subject) -> list[str]:
    """Return what a reader should know before believing the figures, a line each."""
    figures = subject.figures
    found = [*figures["warnings"], *of_assessments.warnings_of(subject.assessment, result=figures)]
    for kind, reasons in figures["aborted_reasons"].items():
        first = f", the first one so: {reasons['first']}" if reasons.get("first") else ""
        found.append(f"{formats.counted(reasons['count'], 'episode')} aborted ({kind}){first}; they count in no figure")
    found += [f"measure {one['label']} failed: {one['error']}" for one in figures["measures"].values() if one["error"]]
    if far := figures["discarded_by_distance"]:
        found.append(f"{formats.counted(far, 'pair')} discarded, above the maximum distance")
    found += [*(f"left out: {line}" for line in figures["left_out"]), *aborted_lines(figures)]
    return list(dict.fromkeys(map(str, found)))


def ranking_notes(subjects: Sequence[Subject]) -> list[str]:
    """Return who is safer than whom, for each set of φ; where φ differ metres do not compare.

    It is by the margin. Where nobody has one it is by the planned deviation, of one adversary model and one objective
    alone: what was planned with unlike adversary models says who knew more.
    """
    key = "margin" if any(one.figures["margin"] is not None for one in subjects) else "deviation"
    groups: dict[tuple[object, ...], list[Subject]] = {}
    for one in subjects:
        if one.figures[key] is not None:
            of = () if key == "margin" else (one.figures.get("adversary_model"), one.ranking_objective)
            groups.setdefault((one.safe_key, one.figures["eta_max"], *of), []).append(one)
    found = [_ranking(members, key) for members in groups.values() if len(members) > 1]
    if len(subjects) == 2 and found:
        found = [_verdict(*subjects) or found[0]]
    for one in subjects if len(subjects) > 1 else ():  # of a single one that stands in the sentence about it
        if said := credibility(one.figures["warnings"]):
            found.append(f"What is said of {one.label} is {said}: its warnings say why.")
    left = [one.label for one in subjects if one.figures[key] is None]
    if key == "margin" and left:
        named = ", ".join(left) if len(left) <= _FEW else formats.counted(len(left), "car")
        found.append(f"The margin is not known of {named}, which no other figure ranks beside those that have one.")
    if len({one.safe_key for one in subjects}) > 1:
        found.append("Not all assessments are on the same φ: margins compare only where they are.")
    elif len(groups) > 1:
        found.append("η_max, or what the adversary knew or planned for, differ: such figures do not compare.")
    return found


def _verdict(first: Subject, second: Subject) -> str:
    """Return what `skd compare` says of the second of two cars by their results alone; empty if it says nothing."""
    found = compare(read_result(first.folder), read_result(second.folder))
    if found.decided_by is None:
        return ""
    figure, held = AT_THE_TOP[found.decided_by], found.differences[found.decided_by]
    verdict = f"{found.verdict} ({found.reason})" if found.reason else found.verdict
    difference = f"{held.value:+.3f}{figure.kind.unit and ' ' + figure.kind.unit}".replace("-", formats.PAGE.minus)
    sure = f"{100 * held.confidence:.3g} % interval {formats.number(held.interval)}"
    return f"{second.label} compared with {first.label}: {verdict}; {figure.label} {difference}, {sure}."


def _bounded(one: Subject, key: str) -> str:
    text = formats.number(one.figures[key], 3, "m")
    return formats.bounded(one.figures, text) if key == "margin" else text


def _ranking(members: Sequence[Subject], key: str) -> str:
    name = AT_THE_TOP[key].label
    ordered = sorted(members, key=lambda one: float(one.figures[key]))
    passing = [one for one in ordered if not does_not_get_past(one.figures)]
    ranked, which = (passing, " of cars that get past people") if 1 < len(passing) < len(ordered) else (ordered, "")
    last, first = ranked[-1], ranked[0]
    close = [
        f"{low.label} and {high.label}"
        for low, high in itertools.pairwise(ordered)
        if _overlap(low.figures[f"{key}_ci95"], high.figures[f"{key}_ci95"])
    ]
    text = f"Greatest {name}{which}: {last.label}, {_bounded(last, key)}; least: {first.label}, {_bounded(first, key)}."
    if close:
        named = "; ".join(close) if len(close) <= _FEW else f"{len(close)} pairs"
        text += f" Intervals that overlap, or are not known: {named}. skd compare tells more."
    return text


def unranked_notes(subjects: Sequence[Subject]) -> list[str]:
    """Return why cars have no equivalent multiplier, once for all that have it in common."""
    groups: dict[str, list[str]] = {}
    for one in subjects:
        if not one.figures["equivalent_multiplier_text"] and one.figures["equivalent_multiplier_note"]:
            groups.setdefault(str(one.figures["equivalent_multiplier_note"]), []).append(one.label)
    return [
        f"{', '.join(labels) if len(labels) <= _FEW else formats.counted(len(labels), 'car')}: {note}"
        for note, labels in groups.items()
    ]


def _overlap(one: Sequence[float] | None, other: Sequence[float] | None) -> bool:
    return one is None or other is None or (one[0] <= other[1] and other[0] <= one[1])


def same_safe(subject: Subject) -> list[str]:
    """Return the names of φ that are one and the same: assessment.json counts the runs along them together."""
    names = [str(row["name"]) for row in subject.figures["per_safe_trajectory"]]
    groups: dict[bytes, list[str]] = {}
    for name, phi in zip(names, subject.episodes.safe, strict=True):
        groups.setdefault(phi.tobytes(), []).append(name)
    return [" and ".join(group) for group in groups.values() if len(group) > 1]


def matrix_of(subjects: Sequence[Subject]) -> dict[str, Any] | None:
    """Return the names of scenarios, and for each car and scenario its results; None unless both are several."""
    cars, scenarios = list(dict.fromkeys(str(one.figures["car"]) for one in subjects)), scenarios_of(subjects)
    if len(cars) < 2 or len(scenarios) < 2:
        return None
    cells: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for one in subjects:
        cells.setdefault((str(one.figures["car"]), one.scenario.name), []).append(one.figures)
    rows = [(car, [cells.get((car, name), []) for name in scenarios]) for car in cars]
    return {"scenarios": scenarios, "rows": rows}


def by_scenario(subjects: Sequence[Subject]) -> list[int]:
    """Return the places of subjects, those of one scenario together."""
    order = scenarios_of(subjects)
    return sorted(range(len(subjects)), key=lambda place: (order.index(subjects[place].scenario.name), place))
