"""The picture of how cars have changed: the figure of each assessment with its interval, in their order."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

from matplotlib.figure import Figure

from skd_evaluator import palette
from skd_evaluator.assessment.judge.figure_table import Kind
from skd_evaluator.report.history.table import day, scaled
from skd_evaluator.report.history.trend import Trend
from skd_evaluator.saved_picture import PAGE, TYPE, save_picture

_MOST_LABELS = 24


def save_trends(path: Path, trends: Sequence[Trend], kind: Kind) -> None:
    """Save one picture with a panel for each car and scenario."""
    unit, scale = kind.unit, kind.scale
    figure = Figure(figsize=(PAGE, 0.8 + 3.0 * len(trends)), layout="constrained")
    panels = figure.subplots(len(trends), 1, squeeze=False)[:, 0]
    for axes, trend in zip(panels, trends, strict=True):
        known = [(place, step) for place, step in enumerate(trend.steps) if step.value is not None]
        places = [place for place, _ in known]
        values = [scale * float(step.value or 0.0) for _, step in known]
        ends = [scaled(step.interval, scale) or (value, value) for (_, step), value in zip(known, values, strict=True)]
        below = [max(0.0, value - low) for value, (low, _) in zip(values, ends, strict=True)]
        above = [max(0.0, high - value) for value, (_, high) in zip(values, ends, strict=True)]
        axes.errorbar(
            places, values, yerr=[below, above], fmt="-o", color=palette.BLUE, ms=5, lw=1.2, capsize=3,
            label=f"{trend.label}, with its 95 % interval by φ",
        )  # fmt: skip
        for verdict, colour, marker in (("less safe", palette.VERMILLION, "v"), ("safer", palette.GREEN, "^")):
            told = [(place, scale * float(step.value or 0.0)) for place, step in known if step.verdict == verdict]
            if told:
                label = f"{verdict} than the one before"
                axes.plot(*zip(*told, strict=True), marker, color=colour, ms=10, ls="", zorder=3, label=label)
        every = -(-len(trend.steps) // _MOST_LABELS)
        shown = range(0, len(trend.steps), every)
        texts = [trend.steps[place].run.revision or day(trend.steps[place].run.date) or "?" for place in shown]
        axes.set_xticks(list(shown), texts, rotation=45, ha="right", fontsize=TYPE)
        for text in axes.get_xticklabels():
            text.set_parse_math(False)
        axes.tick_params(axis="y", labelsize=TYPE)
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel(f"{trend.label} ({unit})" if unit else trend.label, fontsize=TYPE)
        axes.set_title(f"{trend.car}, {trend.scenario}", loc="left", fontsize=10).set_parse_math(False)
        axes.grid(axis="y", color="#dddddd", lw=0.6)
        axes.legend(frameon=False, fontsize=TYPE, loc="best")
    save_picture(figure, path)
