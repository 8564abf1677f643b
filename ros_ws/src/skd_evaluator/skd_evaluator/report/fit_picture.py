"""How well what was fitted predicts what it has not seen: a car, and people who walk.

Of a car it is shown what it did and what was expected, by where the road user was; of people their speeds, and how far
constant velocity is off.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from skd_adversary.car_models import SeenAndPredicted
from skd_sim.arrays import FloatArray

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skd_evaluator.report.drawing import save_picture

_GAPS = np.arange(-6.0, 26.0, 2.0)  # m
_ASIDE = np.arange(-5.0, 5.5, 1.0)  # m
_FEW = 5  # ticks: a mean over fewer is not shown
_COLOURS = ("#1b6ca8", "#d1662b", "#3a3a3a")


def mean_by_place(ticks: SeenAndPredicted, values: FloatArray) -> FloatArray:
    """Return the mean of a value of ticks in cells of gap (rows) and lateral place (columns); nan where few are."""
    rows, columns = np.digitize(ticks.gap, _GAPS) - 1, np.digitize(ticks.lateral, _ASIDE) - 1
    shape = (len(_GAPS) - 1, len(_ASIDE) - 1)
    inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    cell = rows[inside] * shape[1] + columns[inside]
    count = np.bincount(cell, minlength=shape[0] * shape[1])
    total = np.bincount(cell, values[inside], minlength=shape[0] * shape[1])
    return np.asarray(np.where(count >= _FEW, total / np.maximum(count, 1), np.nan).reshape(shape))


def save_prediction(path: Path, ticks: SeenAndPredicted) -> None:
    """Draw the car's mean acceleration in ticks that were held out: as seen, as predicted, and the difference."""
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    panels = figure.subplots(1, 3, sharex=True, sharey=True)
    seen, predicted = (mean_by_place(ticks, values) for values in (ticks.seen, ticks.predicted))
    most = float(np.nanmax(np.abs([seen, predicted]))) if np.isfinite(seen).any() else 1.0
    titles = ("seen", "predicted", "predicted − seen")
    for axes, title, values in zip(panels, titles, (seen, predicted, predicted - seen), strict=True):
        drawn = axes.pcolormesh(_ASIDE, _GAPS, values, cmap="RdBu", vmin=-most, vmax=most)
        axes.set_title(title)
        axes.set_xlabel("adversary right of the car's centre line (m)")
    panels[0].set_ylabel("adversary ahead of the front bumper (m)")
    figure.colorbar(drawn, ax=panels, label="mean acceleration of the car (m/s²)")
    figure.suptitle(f"{ticks.seen.size} ticks that the model has not seen; white: fewer than {_FEW}", fontsize=9)
    save_picture(figure, path)


def save_behaviour(
    path: Path,
    recorded: Sequence[FloatArray],
    simulated: FloatArray,
    horizons: Sequence[float],
    quantiles: Sequence[float],
    tables: tuple[FloatArray, FloatArray],
) -> None:
    """Draw recorded and simulated ways by their speed, and quantiles of the residual, held out and predicted.

    Args:
        path: of the picture.
        recorded: ways of people at ticks, m.
        simulated: as many and more, padded with nan, m.
        horizons: s.
        quantiles: of the residual.
        tables: of the recorded and the predicted residual, horizons × quantiles, m.
    """
    figure = Figure(figsize=(10.0, 3.8), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    _speeds(left, recorded, "recorded")
    _speeds(middle, [way[np.isfinite(way[:, 0])] for way in simulated[: len(recorded)]], "simulated")
    most = max(left.get_ylim()[1], middle.get_ylim()[1])
    for axes in (left, middle):
        axes.set_ylim(-0.1, most)
    for column, (quantile, colour) in enumerate(zip(quantiles, _COLOURS, strict=False)):
        right.plot(horizons, tables[0][:, column], "o", color=colour, label=f"{100.0 * quantile:g} %")
        right.plot(horizons, tables[1][:, column], "-", color=colour)
    right.set_xlabel("horizon (s)")
    right.set_ylabel("residual of constant velocity (m)")
    right.set_title("held out (dots), predicted (lines)", fontsize=9)
    right.legend(fontsize=8, frameon=False)
    save_picture(figure, path)


def _speeds(axes: Axes, ways: Sequence[FloatArray], title: str, time_step: float = 0.3) -> None:
    for way in ways:
        speeds = np.hypot(*np.diff(way, axis=0).T) / time_step
        axes.plot(np.arange(len(speeds)) * time_step, speeds, color=_COLOURS[0], alpha=0.35, linewidth=0.8)
    axes.set_title(title, fontsize=9)
    axes.set_xlabel("time (s)")
    axes.set_ylabel("speed (m/s)")
