"""Tables of a campaign: what its cells are, and what they came to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from skd_evaluator.report.formats import interval, number, percent
from skd_evaluator.report.terminal import narrow_table


def plan_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of what is asked for, a row a cell."""
    table = narrow_table("Cells")
    for name in ("cell", "scenario", "safe"):
        table.add_column(name)
    for name in ("episodes", "at most"):
        table.add_column(name, justify="right")
    for row in rows:
        texts = (escape(str(row[key])) for key in ("name", "scenario", "safe"))
        table.add_row(*texts, str(row["episodes"]), str(row["most"]))
    return table


def campaign_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of what cells came to, from the content of campaign.json; red: a margin had not converged."""
    table = narrow_table("What the cells came to")
    table.add_column("cell")
    columns = ("margin\n(m)", "95 %,\nby φ", "equiv.\nC", "hit\nalong φ", "planned\n(m)", "knowl-\nedge", "SKD\n(m)")
    for name in columns:
        table.add_column(name, justify="right")
    for row in rows:
        name = escape(str(row["name"]))
        if not row["sha256"]:
            table.add_row(name, f"[red]{row['state']}[/]", *[""] * (len(columns) - 1))
            continue
        table.add_row(
            name,
            f"[red]{number(row['margin'])}[/]" if row["margin_converged"] is False else number(row["margin"]),
            interval(row["margin_ci95"]),
            number(row["equivalent_multiplier"]),
            percent(row["hit_rate"]),
            number(row["deformation"]),
            str(row["knowledge"]),
            number(row["skd"]),
        )
    return table
