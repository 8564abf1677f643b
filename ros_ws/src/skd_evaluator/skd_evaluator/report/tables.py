"""Tables of several cars: a comparison, a sweep."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from skd_evaluator.assessment.compare.comparison import EACH
from skd_evaluator.assessment.figure_table import AT_THE_TOP
from skd_evaluator.metrics.price_of_caution import does_not_get_past
from skd_evaluator.report.formats import BARE, TERMINAL, never_passes
from skd_evaluator.report.terminal import bounded_cell, credibility, narrow_table

_number = TERMINAL.number


def credibility_mark(row: Mapping[str, Any]) -> str:
    """Return what stands behind the name of a car that is not credible, or does not get past people."""
    said = credibility([*(row.get("warnings") or ()), *(row.get("problems") or ())])
    marks = [*([said] if said else []), *(["often stuck"] if does_not_get_past(row) else [])]
    return f", [red]{'; '.join(marks)}[/]" if marks else ""


def comparison_table(rows: Sequence[Mapping[str, Any]], ranked_by: str | None) -> Table:
    """Return the table of several assessments side by side.

    Args:
        rows: rows of the table, as comparison.json has them.
        ranked_by: figure by which cars are in order, the most vulnerable one first; None: in the order given.
    """
    order = f"By {_RANKED[ranked_by]}, the safest car last" if ranked_by else "In the order given"
    if ranked_by and any(map(does_not_get_past, rows)):
        order = f"Cars that are often stuck first, the others by {_RANKED[ranked_by]}, the safest last"
    if ranked_by:  # who does not get past people is never the first
        rows = sorted(rows, key=lambda one: (not does_not_get_past(one), float(one[ranked_by])))
    heads = ["car", "margin\n(m)", "95 %\nby φ", "nominal\ncollisions", "risk\nR(1)", "time\nlost (s)"]
    heads.append("equivalent\nmultiplier")
    cells = [
        [
            f"{escape(row['car'])}{credibility_mark(row)}",
            bounded_cell(row, _number(row["margin"])),
            _number(row["margin_ci95"], 2),
            TERMINAL.share(row["nominal_collision_rate"]),
            TERMINAL.probability(row["risk_1"]),
            "—" if never_passes(row) else _number(row.get("time_lost"), 1),
            bounded_cell(row, row["equivalent_multiplier_text"] or "—"),
        ]
        for row in rows
    ]
    return narrow_table(order, heads, cells)


_RANKED = {key: AT_THE_TOP[key].label for key in ("margin", "deviation")}


def verdict_table(entries: Sequence[Mapping[str, Any]], first: str, confidence: float) -> Table:
    """Return the table of what the other cars are beside the first, from the entries of comparison.json."""
    heads = ["car", "verdict", "by", "difference", f"{100 * confidence:.3g} %\nby φ", "effect\nsize", "p", "how"]
    cells = []
    for entry in entries:
        shown = entry["judged_by"] or next((one for one in _RANKED if one in entry["differences"]), "")
        found = entry["differences"].get(shown)
        figures = ["—"] * 5
        if found is not None:
            figures = [AT_THE_TOP[shown].label, f"{found['difference']:+.3f}", _number(found["interval"])]
            figures.append("—" if found["effect_size"] is None else f"{found['effect_size']:+.2f}")
            figures.append("—" if found["p_value"] is None else f"{found['p_value']:.2g}")
        verdict = f"[bold]{_short(entry)}[/]" + (f" ({entry['reason']})" if entry["reason"] else "")
        cells.append([escape(entry["car"]), verdict, *figures, entry["design"]])
    return narrow_table(f"Compared with {escape(first)}; all intervals together hold with 95 %", heads, cells)


def _short(entry: Mapping[str, Any]) -> str:
    """Return a verdict with its price in few words."""
    verdict = str(entry["verdict"])
    if not verdict.endswith(EACH):
        return verdict
    said = verdict.partition(" at the price")[0].partition(",")[0]
    later = entry["price"]["difference"]
    return f"{said}, {abs(later):.1f} s {'slower' if later > 0.0 else 'quicker'}"


_TELLING = ("margin", "deviation", "skd", "nominal_collision_rate")
"""Figures that two cars do not share to the last digit unless they do the same."""


def equal_remarks(rows: Sequence[Mapping[str, Any]], name: str) -> list[str]:
    """Return a line for results whose figures are the same to the last digit: they are likely of the same car.

    Args:
        rows: figures of each result, under their keys in assessment.json.
        name: key under which a row has the result's name.
    """
    alike: dict[tuple[Any, ...], list[str]] = {}
    for row in rows:
        figures = tuple(row.get(key) for key in _TELLING)
        if figures[0] is not None or figures[1] is not None:
            alike.setdefault(figures, []).append(str(row[name]))
    return [
        f"{', '.join(names[:-1])} and {names[-1]} have the same figures to the last digit: did they run the same car?"
        for names in alike.values()
        if len(names) > 1
    ]


def _plus_minus(value: float | None, interval: Sequence[float] | None, digits: int) -> str:
    """Return a mean with half its normal interval, as the paper writes it."""
    if value is None or interval is None:
        return _number(value, digits)
    return f"{value:.{digits}f} ± {0.5 * (interval[1] - interval[0]):.{digits}f}"


def sweep_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of a sweep: one section per kind of safe trajectories, one row per multiplier; 80 columns wide.

    What follows ± takes pairs as independent, as the paper does.
    """
    heads = ["φ, C", "margin\n(m)", "95 %,\nby φ", "planned\n(m)", "95 %,\nby φ", "coll.\nrate (%)", "SKD (m)\n± 95 %"]
    heads.append("collide\n(%)")
    table = narrow_table("Margin, planned deviation, contact rate and SKD against the multiplier C", heads)
    for kind, some in itertools.groupby(rows, key=lambda row: str(row["kind"])):
        table.add_section()
        table.add_row(f"[bold]{kind}[/]")
        for row in some:
            margin = f"[bold]{_number(row['margin'], 3)}[/]", _number(row["margin_ci95"], 2)
            deviation = _number(row["deviation"], 3), _number(row["deviation_ci95"], 2)
            contact, collide = (BARE.share(row[key]) for key in ("contact_rate", "kamikaze_success_rate"))
            skd = _plus_minus(row["skd"], row["skd_ci95_pairs"], 2)
            table.add_row(f"  {row['multiplier']:.3f}", *margin, *deviation, contact, skd, collide)
    return table
