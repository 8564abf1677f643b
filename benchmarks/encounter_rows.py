"""Rows of encounter_table.py as Markdown: the table, the order of cars of known order, closeness to the margin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from statistics import fmean
from typing import Any

_COLUMNS = (
    "planned deformation (m)",
    "success",
    "hits along φ",
    "impact speed (m/s)",
    "closeness",
    "beyond limits",
    "graph",
    "simulations",
    "seconds",
)
ORDERS = {"C": ("C=0.75", "C=1", "C=1.25"), "trigger": ("late", "middle", "early")}
"""Cars that come the later in their order, the sooner they brake."""
MOST = 1.4
"""Closeness that is wanted on average."""


def table_head() -> str:
    """Return the first two lines of the table."""
    return f"| encounter | car | {' | '.join(_COLUMNS)} |\n|{'---|' * (len(_COLUMNS) + 2)}"


def line(name: str, car: str, row: Mapping[str, Any]) -> str:
    """Return a row of the table."""
    if "refused" in row:
        return f"| {name} | {car} | – ({row['refused']}) |" + " |" * (len(_COLUMNS) - 1)
    speeds, (low, high) = row["impact speeds"], row["ci95"] or (row["deformation"],) * 2
    cells = (
        f"{row['deformation']:.2f} [{low:.2f}, {high:.2f}]",
        f"{row['success']:.0%}",
        f"{row['hits along φ']:.0%}",
        "–" if speeds is None else f"{speeds['mean']:.1f} ({speeds['low']:.1f} to {speeds['high']:.1f})",
        _closeness(row),
        f"{row['beyond limits']} of {row['attempts']}",
        row.get("graph", ""),
        f"{row['simulations']:,}",
        f"{row['seconds']:.0f}",
    )
    return f"| {name} | {car} | {' | '.join(cells)} |"


def _ratio(row: Mapping[str, Any]) -> float | None:
    """Return the planned deformation over the margin; None where there is no margin, or it is next to nothing or η_max.

    Where nobody can be hit both are η_max, and their ratio of 1 says nothing of a kamikaze.
    """
    margin = row.get("margin")
    return row["planned in them"] / margin if margin and 0.01 <= margin < row.get("eta_max", 5.0) - 1e-6 else None


def _closeness(row: Mapping[str, Any]) -> str:
    ratio = _ratio(row)
    if ratio is None:
        return "–"
    return f"{ratio:.2f}{'' if row['margin exact'] else '' if row['margin converged'] else '*'}"


def _told(cars: Sequence[str], rows: Mapping[str, Any]) -> str:
    """Return in words how cars of known order come out."""
    found = [rows[car] for car in cars]
    if all(row["deformation"] == found[0]["deformation"] for row in found):
        return "all alike"
    gaps = [later["ci95"][0] - sooner["ci95"][1] for sooner, later in pairwise(found)]
    if all(gap > 0.0 for gap in gaps):
        return "yes"
    means = [row["deformation"] for row in found]
    return "order kept, intervals overlap" if means == sorted(means) else "no"


def order_lines(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the table of whether cars of known order come out in it, with intervals that do not overlap."""
    told = ["| encounter | cars | deformation (m), later to earlier | in order, intervals apart |", "|---|---|---|---|"]
    for name, cars in rows.items():
        for order in ORDERS.values():
            if all("deformation" in cars.get(car, {}) for car in order):
                means = ", ".join(f"{cars[car]['deformation']:.2f}" for car in order)
                told.append(f"| {name} | {', '.join(order)} | {means} | {_told(order, cars)} |")
    return told


def closeness_lines(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the table of mean closeness in each encounter: of basic cars, whose C kamikazes know, and of all cars."""
    told = [f"| encounter | basic cars | all cars | at most {MOST} |", "|---|---|---|---|"]
    for name, cars in rows.items():
        ratios = {car: _ratio(row) for car, row in cars.items() if "refused" not in row}
        known = [ratio for ratio in ratios.values() if ratio is not None]
        basic = [ratio for car, ratio in ratios.items() if ratio is not None and car in ORDERS["C"]]
        if known:
            of_basic = f"{fmean(basic):.2f}" if basic else "–"
            told.append(f"| {name} | {of_basic} | {fmean(known):.2f} | {_at_most(basic, known)} |")
    return told


def _at_most(basic: Sequence[float], known: Sequence[float]) -> str:
    if fmean(known) <= MOST:
        return "yes"
    return "basic cars" if basic and fmean(basic) <= MOST else "no"
