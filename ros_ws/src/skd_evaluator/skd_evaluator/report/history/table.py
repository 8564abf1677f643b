"""Tables of many assessments: what there is, and how a car has changed."""

from __future__ import annotations

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

from skd_evaluator.campaign.judge.figure_table import Kind
from skd_evaluator.report.formats import TERMINAL
from skd_evaluator.report.history.runs import Run
from skd_evaluator.report.history.trend import Trend
from skd_evaluator.report.terminal import narrow_table

_number, _interval = TERMINAL.number, TERMINAL.interval


def runs_table(runs: Sequence[Run]) -> Table:
    """Return the table of assessments, a row each."""
    table = narrow_table("Assessments, as they are written")
    table.add_column("folder", overflow="fold")
    table.add_column("car", overflow="fold")
    table.add_column("encounter")
    for name in ("margin\n(m)", "95 %,\nby φ", "hit\nalong φ", "φ"):
        table.add_column(name, justify="right")
    table.add_column("code of\nthe car")
    table.add_column("date (UTC)")
    for run in runs:
        if not run.figures:
            table.add_row(escape(str(run.folder)), f"[red]{escape(run.remark)}[/]")
            continue
        mark = f" [red]({escape(run.remark)})[/]" if run.remark else ""
        table.add_row(
            f"{escape(str(run.folder))}{mark}",
            escape(run.car),
            escape(run.encounter),
            _number(run.figures["margin"]),
            _interval(run.figures["margin_ci95"], 2),
            TERMINAL.share(run.figures["hit_rate"]),
            str(len(run.figures["per_safe_trajectory"])),
            run.revision,
            day(run.date),
        )
    return table


def scaled(interval: Sequence[float] | None, scale: float) -> list[float] | None:
    """Return an interval in the unit in which it is shown."""
    return None if interval is None else [scale * end for end in interval]


def day(date: str) -> str:
    """Return a date to the minute, as a table has it."""
    return date[:16].replace("T", " ")


def trend_table(trend: Trend, kind: Kind) -> Table:
    """Return the table of how a car has changed, the earliest result first."""
    together = f"{100.0 * trend.confidence:.3g} %"
    unit, scale = kind.unit, kind.scale
    table = narrow_table(f"{escape(trend.car)} in {escape(trend.encounter)}: {trend.label}")
    table.add_column("date (UTC)")
    table.add_column("code of\nthe car")
    for name in (f"{trend.label}\n({unit})" if unit else trend.label, "95 %,\nby φ"):
        table.add_column(name, justify="right")
    table.add_column("beside the\none before")
    for name in ("by so\nmuch", f"{together},\nby φ"):
        table.add_column(name, justify="right")
    table.add_column("folder", overflow="fold")
    for step in trend.steps:
        change = ("", "")
        if step.difference is not None:
            change = f"{scale * step.difference:+.3f}", _interval(scaled(step.difference_interval, scale))
        table.add_row(
            day(step.run.date),
            step.run.revision,
            _number(None if step.value is None else scale * step.value),
            _interval(scaled(step.interval, scale), 2),
            f"[bold]{step.verdict}[/]",
            *change,
            escape(str(step.run.folder)),
        )
    return table
