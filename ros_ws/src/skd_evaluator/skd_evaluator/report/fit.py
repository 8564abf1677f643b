"""What a fit is shown as: a car model's tables and warnings, and how well a behaviour predicts people held out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from rich.table import Table
from skd_adversary.car_models.car_model_file import FittedCar
from skd_adversary.car_models.fit import NEAR
from skd_adversary.car_models.speed_change import LARGEST_NOISE
from skd_sim.world.state import FloatArray

from skd_evaluator.metrics.behaviour.model import MEANINGS, Behaviour
from skd_evaluator.report.terminal import narrow_table

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skd_evaluator.report.pictures import save_picture

_SHOWN_FAMILIES = 8
CONTRADICTED = 0.001
"""p-value of the held-out check below which a warning is given, and no digits."""
FAIR, FAIR_NEAR = 0.03, 0.05
"""Kolmogorov-Smirnov distances of held-out ticks, over all and near the car, up to which a forest predicts well."""


def car_model_warnings(data: Mapping[str, Any]) -> list[str]:
    """Return what a reader should know before believing a car model's intervals, from the content of its file."""
    found = []
    calibration, noise = data["calibration"], data["parameters"].get("deceleration_noise", {})
    predictions = {one["model"]: one for one in data.get("predictions", ())}
    used = predictions.get("forest") if data.get("forest") else None
    if used is not None:
        limits = (("over all", used["statistic"], FAIR), ("near the car", used["near_statistic"], FAIR_NEAR))
        found += [
            f"held-out ticks {where} are {distance:.3f} from their prediction (Kolmogorov-Smirnov), more than "
            f"{limit:g}: kamikazes that plan with this model expect another car"
            for where, distance, limit in limits
            if distance > limit
        ]
    if calibration and calibration["p_value"] < CONTRADICTED:
        found.append("held-out ticks contradict the model: its intervals take it to be right and are too narrow")
    if noise.get("estimate") is not None and noise["estimate"] > 0.99 * LARGEST_NOISE:
        found.append(f"deceleration_noise is {LARGEST_NOISE:g}, the end of its range: the car brakes in several ways")
    return found


def car_table(car: FittedCar, data: Mapping[str, Any]) -> Table:
    """Return the parameters of a car model, those that are not identifiable with their prior."""
    law = data["chosen"] or "none found"
    rows = []
    for name, one in data["parameters"].items():
        cells = ["—", "—"]
        if not one["reason"]:
            low, high = one["interval"]
            error = one["standard_error"]
            error = 0.0 if error < 1e-12 * abs(one["estimate"]) else error  # rounding of the mean of equal numbers
            cells = [f"{one['estimate']:.4g}", f"{error:.2g}", f"[{low:.4g}, {high:.4g}]"]
        else:
            cells.append(f"prior [{one['prior']['first']:.3g}, {one['prior']['second']:.3g}]")
        rows.append([f"{name} ({car.unit(name)})", *cells])
    heads = ("", "estimate", "standard\nerror", "95 %\ninterval")
    return narrow_table(f"Car model; brakes by: {law}", heads, rows)


def unidentified(data: Mapping[str, Any]) -> list[str]:
    """Return why parameters of a car model are not identifiable, one line per reason."""
    names: dict[str, list[str]] = {}
    for name, one in data["parameters"].items():
        if one["reason"]:
            names.setdefault(one["reason"], []).append(name)
    return [f"{', '.join(some)}: {why}" for why, some in names.items()]


def family_table(data: Mapping[str, Any]) -> Table:
    """Return the best few families; the trigger is in m where the law compares a distance, in s where a time."""
    rows = []
    for row in data["families"][:_SHOWN_FAMILIES]:
        name = f"[bold]{row['name']}[/]" if row["name"] == data["chosen"] else row["name"]
        figures = ("—" if row[key] is None else f"{row[key]:.1f}" for key in ("held_out", "aic", "bic"))
        rows.append([name, f"{row['trigger']:.3f}", str(row["parameters"]), *figures])
    heads = ("", "trigger\n(m or s)", "para-\nmeters", "held\nout", "AIC", "BIC")
    return narrow_table("Families of braking laws, by held-out log-likelihood", heads, rows)


def prediction_table(data: Mapping[str, Any]) -> Table:
    """Return how well held-out ticks are predicted; the model that is used in bold."""
    rows = []
    for row in data["predictions"]:
        used = (row["model"] == "forest") == data["forest"]
        near = (str(row["near_ticks"]), f"{row['near_statistic']:.3f}", f"{row['score']:.3f}")
        name = f"[bold]{row['model']}[/]" if used else row["model"]
        rows.append([name, str(row["ticks"]), f"{row['statistic']:.3f}", *near])
    title = f"Held-out ticks, and those with the adversary within {NEAR[0]:g} m ahead and {NEAR[1]:g} m aside"
    return narrow_table(
        title, ("", "ticks", "KS\ndistance", "near:\nticks", "near: KS\ndistance", "near: score\n(m/s)"), rows
    )


def behaviour_table(behaviour: Behaviour) -> Table:
    """Return the parameters of a behaviour model with their intervals and sources."""
    rows = []
    for name, one in behaviour.parameters.items():
        unit = f" ({MEANINGS[name].unit})" if MEANINGS[name].unit else ""
        interval = "—" if one.interval_95 is None else "[{:.3g}, {:.3g}]".format(*one.interval_95)
        rows.append([f"{name}{unit}", f"{one.value:.3g}", interval, one.source])
    title = f"Behaviour model {behaviour.name} ({behaviour.kind})"
    return narrow_table(title, ("", "value", "95 % interval", "source"), rows)


def validation_table(validation: Mapping[str, Any], within: float) -> Table:
    """Return how well people who were held out are predicted; red: further off than `within`."""
    rows = []
    for row in validation["residuals"]:
        ratio = row["predicted"] / row["recorded"]
        shown = f"{ratio:.2f}" if abs(ratio - 1.0) <= within else f"[red]{ratio:.2f}[/]"
        quantile = f"{100.0 * row['quantile']:g} %"
        rows.append([f"{row['horizon']:g}", quantile, f"{row['recorded']:.3f}", f"{row['predicted']:.3f}", shown])
    parts = f"by {validation['held_out_by']}, {validation['folds']} parts in turn"
    title = f"Residual of constant velocity (m) of people held out, {parts}"
    return narrow_table(title, ("horizon (s)", "quantile", "recorded", "predicted", "ratio"), rows)


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
