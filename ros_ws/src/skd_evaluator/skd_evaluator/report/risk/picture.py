"""The rating picture: margin against risk at each scale, cars with both intervals, basic cars as a curve behind."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skd_evaluator import palette
from skd_evaluator.metrics.risks import SCALES
from skd_evaluator.report.risk.rating import RatedCar, basic_cars, floor_of, labelled
from skd_evaluator.saved_picture import PAGE, TYPE, save_picture


def save_rating(path: Path, cars: Sequence[RatedCar]) -> None:
    """Save the picture.

    Args:
        path: file to which the picture is written.
        cars: cars in it, those that are there for the curve alone included.
    """
    figure = Figure(figsize=(PAGE, 3.6), layout="constrained")
    panels = figure.subplots(1, len(SCALES), sharey=True)
    floor = min(floor_of(cars, place) for place in range(len(SCALES)))
    for place, axes in enumerate(panels):
        _draw(axes, cars, place, floor)
    panels[0].set_ylabel("risk: hit by the front of the moving car", fontsize=9)
    hollow = any(risk[0] < floor for one in cars if not one.behind for risk in one.risks)
    figure.suptitle(
        "Margin against risk; bars: 95 % intervals by φ. Safer cars lie to the right and below"
        + ("\nhollow, at the edge: nobody was hit" if hollow else ""),
        x=0.02, ha="left", fontsize=9,
    )  # fmt: skip
    handles, labels = panels[0].get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=TYPE)
    for text in legend.get_texts():
        text.set_parse_math(False)  # a name may be anything
    save_picture(figure, path)


def _draw(axes: Axes, cars: Sequence[RatedCar], place: int, floor: float) -> None:
    curve = basic_cars(cars)
    if curve:
        x, y = [one.margin for one in curve], [max(floor, one.risks[place][0]) for one in curve]
        axes.plot(x, y, "-", color=palette.BEHIND, lw=1.3, marker=".", ms=5, zorder=2, label="basic cars, by C")
        for text, across, up in zip(labelled(curve, place, floor), x, y, strict=True):
            axes.annotate(
                text, (across, up), xytext=(3, 3), textcoords="offset points", fontsize=TYPE, color=palette.BEHIND
            )
    for number, one in enumerate(one for one in cars if not one.behind):
        colour, marker = palette.SERIES[number % len(palette.SERIES)], palette.MARKERS[number % len(palette.MARKERS)]
        value, (low, high) = one.risks[place]
        at = max(floor, value)
        reach = [[max(0.0, one.margin - one.margin_ci95[0])], [max(0.0, one.margin_ci95[1] - one.margin)]]
        rise = [[max(0.0, at - max(floor, low))], [max(0.0, high - at)]]
        axes.errorbar(
            [one.margin], [at], yerr=rise, xerr=reach, fmt=marker, ms=6.5, color=colour, capsize=2.5, lw=1.3, zorder=4,
            label=one.label, mfc="white" if value < floor else colour, clip_on=False,
        )  # fmt: skip
    axes.margins(x=0.14)  # the last name stands beside its point
    axes.set_yscale("log")
    axes.set_ylim(floor, 1.0)
    axes.set_title(f"R({SCALES[place]:g})", loc="left", fontsize=10)
    axes.set_xlabel("margin (m)", fontsize=9)
    axes.grid(alpha=0.3)
