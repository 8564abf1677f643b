"""Figures as a notebook shows them: a small table in HTML."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

from skd_evaluator.assessment.judge.figure_table import Figure, shown_in


def figures_html(figures: Mapping[str, Any], warnings: Sequence[str] = ()) -> str:
    """Return the figures that are looked at first, with their intervals, as a table.

    Args:
        figures: content of assessment.json.
        warnings: why they are not credible, a line each.
    """
    known = [one for one in shown_in("summary") if isinstance(figures.get(one.key), (int, float))]
    rows = "".join(_row(one, figures) for one in known)
    what = f"{figures['controller']} in {figures['scenario']['name']}"
    head = "<tr><th></th><th>value</th><th>95 % interval</th></tr>"
    said = "".join(f"<br>{html.escape(line)}" for line in warnings)
    return f"<table><caption>{html.escape(what)}{said}</caption>{head}{rows}</table>"


def _row(one: Figure, figures: Mapping[str, Any]) -> str:
    value, interval = figures[one.key], figures.get(f"{one.key}_ci95")
    label = f"{one.label} ({one.kind.unit})" if one.kind.unit else one.label
    ends = "" if interval is None or None in interval else f"[{_shown(one, interval[0])}, {_shown(one, interval[1])}]"
    return f"<tr><td>{html.escape(label)}</td><td>{_shown(one, value)}</td><td>{ends}</td></tr>"


def _shown(one: Figure, value: float) -> str:
    return f"{one.kind.scale * value:.{one.kind.digits}f}"
