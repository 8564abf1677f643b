"""`skd fit`: the predictive model of a car from recorded episodes, or with --people how people walk, from tracks."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table
from skd_adversary.car_models.car_model_file import FILE_NAME, FittedCar, car_model_data, write_car_model
from skd_adversary.car_models.observations import observe
from skd_adversary.car_models.prediction import NEAR, learn_car
from skd_adversary.car_models.speed_change import LARGEST_NOISE
from skd_sim.errors import UsageError
from skd_sim.scenario.road_user import ROAD_USERS

from skd_evaluator.bags.car_logs import read_recordings
from skd_evaluator.bags.checks import Damage
from skd_evaluator.cli.arguments import result_folder
from skd_evaluator.cli.output import print_json
from skd_evaluator.report.progress import progress_bar
from skd_evaluator.report.terminal import narrow_table, print_table, say_damage
from skd_evaluator.version import version

if TYPE_CHECKING:
    from skd_evaluator.metrics.behaviour.model import Behaviour
    from skd_evaluator.risk.behaviour.tracks import Tracked, Validation

_SHOWN_FAMILIES = 8
BEHAVIOUR = "behaviour.png"
CONTRADICTED = 0.001
"""p-value of the held-out check below which a warning is given, and no digits."""
FAIR, FAIR_NEAR = 0.03, 0.05
"""Kolmogorov-Smirnov distances of held-out ticks, over all and near the car, up to which a forest predicts well."""


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    return _fit_people(arguments) if arguments.people else _fit_car(arguments)


def _fit_car(arguments: argparse.Namespace) -> int:
    begin = time.perf_counter()
    out = result_folder(arguments)
    damage = Damage(skip=arguments.skip_damaged)
    recordings = read_recordings(arguments.paths, damage)
    say_damage("fit", damage)
    car = learn_car(observe(recordings), version=version())
    problem = out.save(lambda folder: write_car_model(folder / FILE_NAME, car))
    data = {**car_model_data(car), "forest": car.forest is not None}
    for line in [*([problem] if problem else []), *(f"warning: {one}" for one in warnings_of(data))]:
        print(f"skd fit: {line}", file=sys.stderr)
    if arguments.json:
        print_json(data)
        return 1 if problem else 0
    print(f"{data['logs']} logs, {data['ticks']} ticks, {data['braking_ticks']} of them braking")
    print_table(_car_table(car, data))
    for line in _reasons(data):
        print(line)
    if data["families"]:
        print_table(_family_table(data))
    if data["predictions"]:
        print_table(_prediction_table(data))
        by = "a forest of recorded ticks" if data["forest"] else "the law above"
        print(f"The adversary predicts the car by {by}")
    if calibration := data["calibration"]:
        p_value = calibration["p_value"]
        chance = f"p = {p_value:.3f}" if p_value >= CONTRADICTED else f"p < {CONTRADICTED:g}"
        print(
            f"Held-out ticks against their prediction: {calibration['ticks']} ticks,\n"
            f"Kolmogorov-Smirnov distance {calibration['statistic']:.3f}, {chance}"
        )
    seconds = f"{time.perf_counter() - begin:.1f} s"
    print(seconds if problem else f"{seconds}; model in {out.path / FILE_NAME}")
    return 1 if problem else 0


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
            f"{limit:g}: kamikazes that plan with this model expect another car"
            for where, distance, limit in limits
            if distance > limit
        ]
    if calibration and calibration["p_value"] < CONTRADICTED:
        found.append("held-out ticks contradict the model: its intervals take it to be right and are too narrow")
    if noise.get("estimate") is not None and noise["estimate"] > 0.99 * LARGEST_NOISE:
        found.append(
            f"deceleration_noise is at the end of its range, {LARGEST_NOISE:g}: this car does not brake with one "
            "deceleration"
        )
    return found


def _car_table(car: FittedCar, data: Mapping[str, Any]) -> Table:
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


def _reasons(data: Mapping[str, Any]) -> list[str]:
    """Return why parameters of a car model are not identifiable, one line per reason."""
    names: dict[str, list[str]] = {}
    for name, one in data["parameters"].items():
        if one["reason"]:
            names.setdefault(one["reason"], []).append(name)
    return [f"{', '.join(some)}: {why}" for why, some in names.items()]


def _family_table(data: Mapping[str, Any]) -> Table:
    """Return the best few families; the trigger is in m where the law compares a distance, in s where a time."""
    rows = []
    for row in data["families"][:_SHOWN_FAMILIES]:
        name = f"[bold]{row['name']}[/]" if row["name"] == data["chosen"] else row["name"]
        figures = ("—" if row[key] is None else f"{row[key]:.1f}" for key in ("held_out", "aic", "bic"))
        rows.append([name, f"{row['trigger']:.3f}", str(row["parameters"]), *figures])
    heads = ("", "trigger\n(m or s)", "para-\nmeters", "held\nout", "AIC", "BIC")
    return narrow_table("Families of braking laws, by held-out log-likelihood", heads, rows)


def _prediction_table(data: Mapping[str, Any]) -> Table:
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


def _fit_people(arguments: argparse.Namespace) -> int:
    from skd_evaluator.metrics.behaviour.model import FILE_NAME as BEHAVIOUR_FILE
    from skd_evaluator.risk.behaviour.fit import behaviour_of, fit_behaviour
    from skd_evaluator.risk.behaviour.tracks import TIME_STEP, WITHIN, read_tracks, validate

    begin = time.perf_counter()
    if arguments.kind not in ROAD_USERS:
        raise UsageError(f"--kind must be one of {', '.join(ROAD_USERS.names())}; got {arguments.kind!r:.40}")
    out = result_folder(arguments)
    damage = Damage(skip=arguments.skip_damaged)
    tracks = read_tracks(arguments.paths, damage, arguments.kind)
    say_damage("fit", damage)
    _check_enough(tracks)
    with progress_bar(quiet=arguments.quiet) as progress:
        validation = validate(tracks, lambda done, of: progress("fits without a part", done, of))
        fit = fit_behaviour([one.positions for one in tracks], TIME_STEP)
    recordings = len({one.recording for one in tracks})
    source = f"fitted to {fit.tracks} tracks of {recordings} recordings"
    behaviour = behaviour_of(fit, arguments.name, arguments.kind, source, source)
    problem = out.save(partial(_write_people, behaviour, validation, tracks))
    if problem:
        print(f"skd fit: {problem}", file=sys.stderr)
    if validation.worst > WITHIN:
        print(
            f"skd fit: warning: a quantile of people held out is {100.0 * validation.worst:.0f} % off, more than "
            f"{100.0 * WITHIN:.0f} %: they walk otherwise than the others, or than the model can",
            file=sys.stderr,
        )
    if arguments.json:
        print_json({**behaviour.as_dict(), "validation": validation.as_dict()})
        return 1 if problem else 0
    print(f"{fit.tracks} tracks of {recordings} recordings, {fit.steps} ticks")
    print_table(_behaviour_table(behaviour))
    print_table(_validation_table(validation, WITHIN))
    seconds = f"{time.perf_counter() - begin:.1f} s"
    print(seconds if problem else f"{seconds}; behaviour model in {out.path / BEHAVIOUR_FILE}, picture in {BEHAVIOUR}")
    return 1 if problem else 0


def _check_enough(tracks: Sequence[Tracked]) -> None:
    """Refuse tracks of which too few are left when a part is held out."""
    from skd_evaluator.risk.behaviour.fit import LEAST_TRACKS
    from skd_evaluator.risk.behaviour.tracks import folds_of

    by, folds = folds_of(tracks)
    left = min(len(folds) - folds.count(fold) for fold in set(folds))
    if left < LEAST_TRACKS:
        raise UsageError(
            f"{len(tracks)} tracks, of which {left} are left when those of one {by} are held out; a behaviour model "
            f"needs at least {LEAST_TRACKS}"
        )


def _write_people(behaviour: Behaviour, validation: Validation, tracks: Sequence[Tracked], folder: Path) -> None:
    from skd_evaluator.metrics.behaviour.model import FILE_NAME as BEHAVIOUR_FILE
    from skd_evaluator.metrics.behaviour.model import write_behaviour
    from skd_evaluator.report.fit_picture import save_behaviour  # slow to import, and needed only now
    from skd_evaluator.risk.behaviour.fit import HORIZONS, QUANTILES

    write_behaviour(folder / BEHAVIOUR_FILE, behaviour)
    content = json.dumps(validation.as_dict(), indent=2)
    (folder / "validation.json").write_text(f"{content}\n", encoding="utf-8")
    walked = [one.positions for one in tracks]
    tables = (validation.recorded, validation.predicted)
    save_behaviour(folder / BEHAVIOUR, walked, validation.example, HORIZONS, QUANTILES, tables)


def _behaviour_table(behaviour: Behaviour) -> Table:
    from skd_evaluator.metrics.behaviour.model import MEANINGS

    rows = []
    for name, one in behaviour.parameters.items():
        unit = f" ({MEANINGS[name].unit})" if MEANINGS[name].unit else ""
        interval = "—" if one.interval_95 is None else "[{:.3g}, {:.3g}]".format(*one.interval_95)
        rows.append([f"{name}{unit}", f"{one.value:.3g}", interval, one.source])
    title = f"Behaviour model {behaviour.name} ({behaviour.kind})"
    return narrow_table(title, ("", "value", "95 % interval", "source"), rows)


def _validation_table(validation: Validation, within: float) -> Table:
    """Return how well people who were held out are predicted; red: further off than `within`."""
    rows = []
    for row in validation.as_dict()["residuals"]:
        ratio = row["predicted"] / row["recorded"]
        shown = f"{ratio:.2f}" if abs(ratio - 1.0) <= within else f"[red]{ratio:.2f}[/]"
        quantile = f"{100.0 * row['quantile']:g} %"
        rows.append([f"{row['horizon']:g}", quantile, f"{row['recorded']:.3f}", f"{row['predicted']:.3f}", shown])
    title = (
        f"Residual of constant velocity (m) of people held out, by {validation.by}, {validation.folds} parts in turn"
    )
    return narrow_table(title, ("horizon (s)", "quantile", "recorded", "predicted", "ratio"), rows)
