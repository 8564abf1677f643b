"""How well a fitted behaviour predicts people it has not seen: their speeds, and how far constant velocity is off."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from skd_sim.arrays import FloatArray

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skd_evaluator.report.drawing import save_picture

_COLOURS = ("#1b6ca8", "#d1662b", "#3a3a3a")


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
