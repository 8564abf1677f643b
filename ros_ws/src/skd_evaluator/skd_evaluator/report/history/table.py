"""Tables of many assessments: what there is, and how a car has changed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from skd_evaluator.assessment.judge.figure_table import Kind
from skd_evaluator.report.formats import TERMINAL
from skd_evaluator.report.history.runs import Run
from skd_evaluator.report.history.trend import Trend
from skd_evaluator.report.terminal import bounded_cell, narrow_table

_UNKNOWN = "unknown"
"""Commit of code that is in no checkout."""
_number, _interval = TERMINAL.number, TERMINAL.interval


def runs_table(runs: Sequence[Run]) -> Table:
    """Return the table of assessments that could be read, a row each; those with a remark are marked."""
    parent = common_parent(runs)
    table = narrow_table(f"Assessments in {escape(str(parent))}, as they are written")
    table.add_column("folder", overflow="fold")
    table.add_column("car", overflow="fold")
    table.add_column("scenario", overflow="fold")
    for name in ("margin\n(m)", "95 %,\nby φ", "nominal\ncollisions", "φ"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("code of\nthe car", no_wrap=True)
    table.add_column("date\n(UTC)")
    for run in runs:
        table.add_row(
            f"{escape(os.path.relpath(run.folder, parent))}{'[red]*[/]' if run.remark or run.warnings else ''}",
            escape(run.car),
            escape(run.scenario),
            bounded_cell(run.figures, _number(run.figures["margin"])),
            _interval(run.figures["margin_ci95"], 2),
            TERMINAL.share(run.figures["nominal_collision_rate"]),
            str(len(run.figures["per_safe_trajectory"])),
            run.revision or _UNKNOWN,
            day(run.date),
        )
    return table


def common_parent(runs: Sequence[Run]) -> Path:
    """Return the folder that holds those of all assessments: what is left of their names tells them apart."""
    parents = [run.folder.parent for run in runs]
    if len({parent.is_absolute() for parent in parents}) > 1:
        parents = [parent.absolute() for parent in parents]
    return Path(os.path.commonpath(parents) or ".")


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
    parent = common_parent([step.run for step in trend.steps])
    table = narrow_table(f"{escape(trend.car)} in {escape(trend.scenario)}: {trend.label}; in {escape(str(parent))}")
    table.add_column("date\n(UTC)")
    table.add_column("code of\nthe car", no_wrap=True)
    table.add_column(f"{trend.label}\n({unit})" if unit else trend.label, justify="right")
    table.add_column("95 %,\nby φ", justify="right", no_wrap=True)
    table.add_column("beside the\none before")
    for name in ("by so\nmuch", f"{together},\nby φ"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("folder", overflow="fold")
    for step in trend.steps:
        change = ("", "")
        if step.difference is not None:
            change = f"{scale * step.difference:+.3f}", _interval(scaled(step.difference_interval, scale))
        table.add_row(
            day(step.run.date),
            step.run.revision or _UNKNOWN,
            bounded_cell(
                step.run.figures if trend.figure == "margin" else {},
                _number(None if step.value is None else scale * step.value),
            ),
            _interval(scaled(step.interval, scale), 2),
            f"[bold]{step.verdict}[/]{'[red] not credible[/]' if step.run.not_credible else ''}",
            *change,
            escape(os.path.relpath(step.run.folder, parent)),
        )
    return table
