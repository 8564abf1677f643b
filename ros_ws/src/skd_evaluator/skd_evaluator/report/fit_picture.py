"""How well a car is predicted, seen from the car: what it did and what was expected, by where the road user was."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from skd_adversary.car_fit import SeenAndPredicted
from skd_sim.arrays import FloatArray

mpl.use("Agg")

from matplotlib.figure import Figure

_GAPS = np.arange(-6.0, 26.0, 2.0)  # m
_ASIDE = np.arange(-5.0, 5.5, 1.0)  # m
_FEW = 5  # ticks: a mean over fewer is not shown
_DPI = 150


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
    figure.savefig(path, dpi=_DPI)
