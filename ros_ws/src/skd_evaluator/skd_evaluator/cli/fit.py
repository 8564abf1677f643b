"""`skd fit`: the predictive model of a car from recorded episodes."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rich.table import Table
from skd_adversary.car_models import SeenAndPredicted, learn_car, observe
from skd_adversary.car_models.car_model_file import FILE_NAME, FittedCar, car_model_data, write_car_model
from skd_adversary.car_models.prediction import NEAR
from skd_adversary.car_models.speed_change import LARGEST_NOISE

from skd_evaluator.bags.car_logs import read_recordings
from skd_evaluator.bags.checks import Damage
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import print_json
from skd_evaluator.report.terminal import narrow_table, print_table, say_damage
from skd_evaluator.version import version

_SHOWN_FAMILIES = 8
PICTURE = "prediction.png"
CONTRADICTED = 0.001
"""p-value of the held-out check below which a warning is given, and no digits."""
FAIR, FAIR_NEAR = 0.03, 0.05
"""Kolmogorov-Smirnov distances of held-out ticks, over all and near the car, up to which a forest predicts well."""


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    begin = time.perf_counter()
    out = result_folder(arguments)
    damage = Damage(skip=arguments.skip_damaged)
    recordings = read_recordings(arguments.paths, damage)
    say_damage("fit", damage)
    car, ticks = learn_car(observe(recordings), version=version())
    problem = out.save(partial(_fill, car, ticks))
    if problem:
        print(f"skd fit: {problem}", file=sys.stderr)
    data = {**car_model_data(car), "forest": car.forest is not None}
    for warning in warnings_of(data):
        print(f"skd fit: warning: {warning}", file=sys.stderr)
    if arguments.json:
        print_json(data)
        return 1 if problem else 0
    print(f"{data['logs']} logs, {data['ticks']} ticks, {data['braking_ticks']} of them braking")
    print_table(parameter_table(data))
    for line in reasons(data):
        print(line)
    if data["families"]:
        print_table(family_table(data))
    if data["predictions"]:
        print_table(prediction_table(data))
        by = "a forest of recorded ticks" if data["forest"] else "the law above"
        print(f"The adversary predicts the car by {by}; predicted against seen: {PICTURE}")
    calibration = data["calibration"]
    if calibration:
        p_value = calibration["p_value"]
        chance = f"p = {p_value:.3f}" if p_value >= CONTRADICTED else f"p < {CONTRADICTED:g}"
        print(
            f"Held-out ticks against their prediction: {calibration['ticks']} ticks,\n"
            f"Kolmogorov-Smirnov distance {calibration['statistic']:.3f}, {chance}"
        )
    seconds = f"{time.perf_counter() - begin:.1f} s"
    print(seconds if problem else f"{seconds}; model in {out.path / FILE_NAME}")
    return 1 if problem else 0


def _fill(car: FittedCar, ticks: SeenAndPredicted | None, folder: Path) -> None:
    write_car_model(folder / FILE_NAME, car)
    if ticks is not None and ticks.seen.size:
        from skd_evaluator.report.fit_picture import save_prediction  # slow to import, and needed only now

        save_prediction(folder / PICTURE, ticks)


def prediction_table(data: Mapping[str, Any]) -> Table:
    """Return the table of how well held-out ticks are predicted, from the content of a car model's file."""
    table = narrow_table(
        f"Held-out ticks, and those with the adversary within {NEAR[0]:g} m ahead and {NEAR[1]:g} m aside"
    )
    for name in ("", "ticks", "KS\ndistance", "near:\nticks", "near: KS\ndistance", "near: score\n(m/s)"):
        table.add_column(name, justify="right" if name else "left")
    for row in data["predictions"]:
        chosen = (row["model"] == "forest") == data["forest"]
        table.add_row(
            f"[bold]{row['model']}[/]" if chosen else row["model"],
            str(row["ticks"]),
            f"{row['statistic']:.3f}",
            str(row["near_ticks"]),
            f"{row['near_statistic']:.3f}",
            f"{row['score']:.3f}",
        )
    return table


def warnings_of(data: Mapping[str, Any]) -> list[str]:
    """Return what a reader should know before believing a car model's intervals, from the content of its file."""
    found = []
    calibration, noise = data["calibration"], data["parameters"].get("deceleration_noise", {})
    predictions = {one["model"]: one for one in data.get("predictions", ())}
    used = predictions.get("forest") if data.get("forest") else None
    if used is not None:
        limits = (("over all", used["statistic"], FAIR), ("near the car", used["near_statistic"], FAIR_NEAR))
        found += [
            f"held-out ticks {where} are {distance:.3f} from their prediction (Kolmogorov-Smirnov), more than "
            f"{limit:g}: what kamikazes plan with this model rests on a picture of the car that is not right"
            for where, distance, limit in limits
            if distance > limit
        ]
    if calibration and calibration["p_value"] < CONTRADICTED:
        found.append(
            "held-out ticks contradict the model: it is the best of its kind, but the intervals take it to be right "
            "and are too narrow"
        )
    if noise.get("identifiable") and noise["estimate"] > 0.99 * LARGEST_NOISE:
        found.append(
            f"deceleration_noise is at the end of its range, {LARGEST_NOISE:g}: this car does not brake with one "
            "deceleration"
        )
    return found


def parameter_table(data: Mapping[str, Any]) -> Table:
    """Return the table of a car model's parameters, from the content of its file."""
    law = data["family"]["name"] or "none found"
    table = Table(title=f"Car model; brakes by: {law}", title_justify="left")
    for name in ("", "estimate", "standard\nerror", "95 %\ninterval"):
        table.add_column(name, justify="left" if not name else "right")
    for name, one in data["parameters"].items():
        label = f"{name} ({one['unit']})"
        if one["identifiable"]:
            low, high = one["interval_95"]
            error = one["standard_error"]
            error = 0.0 if error < 1e-12 * abs(one["estimate"]) else error  # rounding of the mean of equal numbers
            table.add_row(label, f"{one['estimate']:.4g}", f"{error:.2g}", f"[{low:.4g}, {high:.4g}]")
        else:
            prior = one["prior"]
            table.add_row(label, "—", "—", f"prior [{prior['low']:.3g}, {prior['high']:.3g}]")
    return table


def reasons(data: Mapping[str, Any]) -> list[str]:
    """Return why parameters of a car model are not identifiable, one line per reason."""
    names: dict[str, list[str]] = {}
    for name, one in data["parameters"].items():
        if not one["identifiable"]:
            names.setdefault(one["reason"], []).append(name)
    return [f"{', '.join(some)}: {why}" for why, some in names.items()]


def family_table(data: Mapping[str, Any]) -> Table:
    """Return the comparison of families, the best few, from the content of a car model's file.

    The trigger is in m where the law compares a distance, in s where it compares a time.
    """
    table = narrow_table("Families of braking laws, by held-out log-likelihood")
    for name in ("", "trigger\n(m or s)", "para-\nmeters", "held\nout", "AIC", "BIC"):
        table.add_column(name, justify="right" if name else "left")
    for row in data["families"][:_SHOWN_FAMILIES]:
        name = f"[bold]{row['name']}[/]" if row["name"] == data["family"]["name"] else row["name"]
        figures = ("—" if row[key] is None else f"{row[key]:.1f}" for key in ("held_out", "aic", "bic"))
        table.add_row(name, f"{row['trigger']:.3f}", str(row["parameters"]), *figures)
    return table
