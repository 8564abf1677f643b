"""`car_model.yaml`: a fitted car on disk, for people and for the POMDPs."""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from skd_sim.encounter.scenario import Scenario
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import parse_json, read_bytes
from skd_sim.inputs.yaml_file import name_of_key, parse_yaml, read_text, short, to_yaml

from skd_adversary.car_forest import CarForest
from skd_adversary.fitted_car import (
    LARGEST,
    LONGEST_DELAY,
    OPTIONAL,
    PARAMETERS,
    Calibration,
    FamilyRow,
    FittedCar,
    Parameter,
    Prediction,
    Prior,
)

FILE_NAME = "car_model.yaml"
FOREST_SUFFIX = ".forest"
LARGEST_FOREST = 16 * 2**20
"""Bytes; one has about a hundred thousand."""
_CHOICES = {
    "measure": ("distance", "time"),
    "gate": ("none", "position", "predicted"),
    "spread": ("sharp", "encounter", "tick"),
}
_NAMES = {"point": ("value",), "uniform": ("low", "high"), "normal": ("mean", "standard_deviation")}
_Row = TypeVar("_Row")
_HEAD = "# Predictive model of a car, fitted from logs by skd fit. SI units; half-widths of noise are relative.\n"


def car_model_data(car: FittedCar) -> dict[str, Any]:
    """Return a fitted car as plain data, a forest in base64; `car_model_from` is the inverse."""
    return {
        "version": car.version,
        "logs": car.logs,
        "ticks": car.ticks,
        "braking_ticks": car.braking_ticks,
        "time_step": car.time_step,
        "footprint": {"front": car.front, "rear": car.rear} if car.front is not None else None,
        "family": {
            "name": car.chosen,
            "measure": car.measure,
            "gate": car.gate,
            "spread": car.spread,
            "lapse": car.lapse,
        },
        "parameters": {name: _parameter_data(car, name) for name in PARAMETERS if name in car.parameters},
        "families": [dataclasses.asdict(row) for row in car.families],
        "calibration": dataclasses.asdict(car.calibration) if car.calibration else None,
        "predictions": [dataclasses.asdict(one) for one in car.predictions],
        "waiting_reward": car.waiting_reward,
        "forest": None if car.forest is None else base64.b64encode(car.forest.packed).decode("ascii"),
    }


def _parameter_data(car: FittedCar, name: str) -> dict[str, Any]:
    one = car.parameters[name]
    numbers = zip(_NAMES[one.prior.distribution], (one.prior.first, one.prior.second), strict=False)
    data: dict[str, Any] = {
        "unit": car.unit(name),
        "identifiable": one.identifiable,
        "estimate": one.estimate,
        "standard_error": one.standard_error,
        "interval_95": list(one.interval) if one.interval is not None else None,
        "prior": {"distribution": one.prior.distribution, **dict(numbers)},
    }
    if one.reason:
        data["reason"] = one.reason
    return data


def write_car_model(path: Path, car: FittedCar) -> None:
    """Write a fitted car as YAML; its forest, if it has one, goes into a file beside it, which the YAML names."""
    data = car_model_data(car)
    if car.forest is not None:
        beside = path.with_suffix(FOREST_SUFFIX)
        beside.write_bytes(car.forest.packed)
        data["forest"] = {"file": beside.name, "sha256": hashlib.sha256(car.forest.packed).hexdigest()}
    text = to_yaml(data)
    path.write_text(_HEAD + text, encoding="utf-8")


def _with_forest(data: Any, path: Path) -> Any:
    """Return the content of a file with the forest that it names, in base64.

    Raises:
        UsageError: that file is not there, or is another one.
    """
    named = data.get("forest") if isinstance(data, Mapping) else None
    if not isinstance(named, Mapping):
        return data
    file = named.get("file")
    if not isinstance(file, str) or Path(file).name != file or not file:
        raise UsageError(f"{path}: forest.file must be the name of a file beside it, got {short(file)}")
    try:
        packed = read_bytes(path.parent / file, LARGEST_FOREST + 1)
    except UsageError as error:
        raise UsageError(f"{path}: forest {error}") from error
    if hashlib.sha256(packed).hexdigest() != named.get("sha256"):
        raise UsageError(f"{path}: {file} is not the forest that was written with it: its SHA-256 differs")
    return {**data, "forest": base64.b64encode(packed).decode("ascii")}


def file_of(source: Path) -> Path:
    """Return the file of a car model, by its path or that of the folder that `skd fit` wrote."""
    return source / FILE_NAME if source.is_dir() else source


def read_car_model(source: Path) -> FittedCar:
    """Return the fitted car in a file, or in a folder that `skd fit` wrote.

    Raises:
        UsageError: it cannot be read, or is no car model.
    """
    path = file_of(source)
    try:
        text = read_text(path)
    except OSError as error:
        raise UsageError(f"car model {path}: cannot be read ({error.strerror}); skd fit writes one") from error
    return car_model_from(_with_forest(parse_yaml(text, str(path)), path), str(path))


def car_model_from(data: Any, where: str = "car model") -> FittedCar:
    """Build and check a fitted car from plain data.

    Args:
        data: plain data, as `car_model_data` returns them.
        where: file or other origin, for messages.

    Raises:
        UsageError: a key is missing or has no valid value.
    """
    top = _mapping(data, where, "the file")
    family = _mapping(top.get("family"), where, "family")
    chosen = {}
    for key, allowed in _CHOICES.items():
        if family.get(key) not in allowed:
            raise UsageError(f"{where}: family.{key} must be one of {', '.join(allowed)}, got {short(family.get(key))}")
        chosen[key] = str(family[key])
    time_step = _number(top.get("time_step"), where, "time_step")
    parameters = _parameters(top.get("parameters"), where, chosen, time_step)
    footprint = top.get("footprint")
    size: dict[str, float] = {}
    if footprint is not None:  # files of earlier versions have none
        footprint = _mapping(footprint, where, "footprint")
        size = {key: _number(footprint.get(key), where, f"footprint.{key}") for key in ("front", "rear")}
    lapse = _number(family.get("lapse"), where, "family.lapse")
    if not 0.0 <= lapse <= 1.0:
        raise UsageError(f"{where}: family.lapse must be from 0 to 1, got {lapse:g}")
    try:
        calibration = top.get("calibration")
        return FittedCar(
            measure=chosen["measure"],
            gate=chosen["gate"],
            spread=chosen["spread"],
            lapse=lapse,
            parameters=parameters,
            families=tuple(_row(FamilyRow, row, where, "families") for row in top.get("families") or ()),
            chosen=str(family.get("name", "")),
            calibration=_row(Calibration, calibration, where, "calibration") if calibration else None,
            logs=int(top.get("logs", 0)),
            ticks=int(top.get("ticks", 0)),
            braking_ticks=int(top.get("braking_ticks", 0)),
            time_step=time_step,
            version=str(top.get("version", "unknown")),
            front=size.get("front"),
            rear=size.get("rear"),
            forest=_forest(top.get("forest"), where),
            predictions=tuple(_row(Prediction, row, where, "predictions") for row in top.get("predictions") or ()),
            waiting_reward=_waiting_reward(top.get("waiting_reward"), where),
        )
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, UsageError):
            raise
        raise UsageError(f"{where}: is no car model as skd fit writes it ({' '.join(str(error).split())})") from error


def car_model_text(car: FittedCar) -> str:
    """Return what a specification of an episode carries: JSON, without the comparison of families."""
    return json.dumps({**car_model_data(car), "families": []}, ensure_ascii=False, allow_nan=False)


def check_scenario(car: FittedCar, scenario: Scenario, where: str) -> None:
    """Refuse a car model that was fitted to logs of another scenario's ticks or of a car of another size.

    Its noise is that of one tick, its delay a number of them, and its distances begin at the bumper.

    Args:
        car: the fitted car.
        scenario: scenario in which the adversary is to plan with it.
        where: file or other origin, for the message.

    Raises:
        UsageError: time step, front or rear differ.
    """
    pairs = (
        ("time_step", "s", car.time_step, scenario.time_step),
        ("footprint.front", "m", car.front, scenario.car.front),
        ("footprint.rear", "m", car.rear, scenario.car.rear),
    )
    for key, unit, one, other in pairs:
        if one is not None and not math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-12):
            raise UsageError(
                f"{where}: {key} is {one:g} {unit}, that of scenario {scenario.name} {other:g} {unit}; fit the car "
                "anew: skd probe --scenario, then skd fit"
            )


def car_model_for_scenario(source: Path, scenario: Scenario) -> str:
    """Return the car model in a file or folder, as an episode of the scenario carries it.

    Raises:
        UsageError: it cannot be read, is no car model, or does not go with the scenario.
    """
    car = read_car_model(source)
    check_scenario(car, scenario, str(source))
    return car_model_text(car)


@functools.cache
def fitted_car(text: str) -> FittedCar:
    """Return the fitted car that `car_model_text` wrote; the same text is read once.

    Raises:
        UsageError: it is none.
    """
    where = "car model of the episode"
    return car_model_from(parse_json(text, where), where)


def _forest(value: Any, where: str) -> CarForest | None:
    """Return the forest in base64, looked through; None where there is none."""
    if value is None:
        return None
    if not isinstance(value, str):
        raise UsageError(f"{where}: forest must be text (base64), got {type(value).__name__}")
    try:
        forest = CarForest(base64.b64decode(value, validate=True))
    except ValueError as error:
        raise UsageError(f"{where}: forest is not base64") from error
    try:
        assert forest.trees
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from error
    return forest


def _waiting_reward(value: Any, where: str) -> float | None:
    if value is None:  # as in files of earlier versions
        return None
    reward = _number(value, where, "waiting_reward")
    if reward > 0.0:
        raise UsageError(f"{where}: waiting_reward must be at most 0 (m a step), got {reward:g}")
    return reward


def _mapping(value: Any, where: str, key: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise UsageError(f"{where}: {key} must be a mapping, got {type(value).__name__}")
    return value


def _number(value: Any, where: str, key: str) -> float:
    number = math.nan
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):  # whole numbers have no end
            number = float(value)
    if not math.isfinite(number):
        raise UsageError(f"{where}: {key} must be a finite number, got {short(value)}")
    return number


def _row(kind: Callable[..., _Row], value: Any, where: str, key: str) -> _Row:
    """Return what stands beside the law: texts, finite numbers, and nothing where nothing was found out."""
    row = _mapping(value, where, key)
    for name, one in row.items():
        if one is not None and not isinstance(one, str):
            _number(one, where, f"{key}.{name_of_key(name)}")
    return kind(**row)


def _parameters(value: Any, where: str, family: Mapping[str, str], time_step: float) -> dict[str, Parameter]:
    """Return the parameters of a law, with what the family needs, each in its unit."""
    given = _mapping(value, where, "parameters")
    for name in given:
        if name not in PARAMETERS:
            raise UsageError(f"{where}: unknown key parameters.{name_of_key(name)}; allowed: {', '.join(PARAMETERS)}")
    units = {**PARAMETERS, **(dict.fromkeys(("trigger", "trigger_spread"), "s") if family["measure"] == "time" else {})}
    found: dict[str, Parameter] = {}
    for name in PARAMETERS:
        needed = name not in OPTIONAL or (name == "path_half_width" and family["gate"] != "none")
        if needed and name not in given:
            raise UsageError(f"{where}: missing key parameters.{name}")
    for name, one in given.items():
        found[name] = _parameter(one, where, name)
        if (unit := one.get("unit", units[name])) != units[name]:
            raise UsageError(
                f"{where}: parameters.{name}.unit must be {units[name]} where family.measure is {family['measure']}, "
                f"got {short(unit)}"
            )
    if (found["reaction_delay"].estimate or 0.0) > (LONGEST_DELAY + 1e-9) * time_step:
        raise UsageError(
            f"{where}: parameters.reaction_delay.estimate must be at most {LONGEST_DELAY} ticks of {time_step:g} s, "
            f"with which the adversary can plan, got {found['reaction_delay'].estimate:g} s"
        )
    return found


def _parameter(value: Any, where: str, name: str) -> Parameter:
    key = f"parameters.{name}"
    data = _mapping(value, where, key)
    prior = _mapping(data.get("prior"), where, f"{key}.prior")
    distribution = prior.get("distribution")
    if not isinstance(distribution, str) or distribution not in _NAMES:
        raise UsageError(
            f"{where}: {key}.prior.distribution must be one of {', '.join(_NAMES)}, got {short(distribution)}"
        )
    numbers = {one: _number(prior.get(one), where, f"{key}.prior.{one}") for one in _NAMES[distribution]}
    most = math.inf if data.get("reason") else LARGEST.get(name, math.inf)
    for one, number in numbers.items():
        _check_within(number, most, where, f"{key}.prior.{one}", PARAMETERS[name])
    try:
        thought = Prior(distribution, *numbers.values())
    except UsageError as error:
        raise UsageError(f"{where}: {key}.prior: {error}") from error
    if data.get("reason"):
        return Parameter(thought, reason=str(data["reason"]))
    interval = data.get("interval_95")
    if not isinstance(interval, list) or len(interval) != 2:
        raise UsageError(f"{where}: {key}.interval_95 must be a list of two numbers, got {short(interval)}")
    low, high = (_number(end, where, f"{key}.interval_95") for end in interval)
    estimate = _number(data.get("estimate"), where, f"{key}.estimate")
    error_of_it = _number(data.get("standard_error"), where, f"{key}.standard_error")
    _check_within(estimate, most, where, f"{key}.estimate", PARAMETERS[name])
    if error_of_it < 0.0:
        raise UsageError(f"{where}: {key}.standard_error must be ≥ 0, got {error_of_it:g}")
    _check_agree(estimate, (low, high), thought, where, key, planned=name != "trigger_spread")
    return Parameter(thought, estimate, error_of_it, (low, high))


def _check_within(number: float, most: float, where: str, key: str, unit: str) -> None:
    """See that a number of a parameter can be one, a value, an end, a mean or a deviation; no parameter is negative."""
    if not 0.0 <= number <= most:
        wanted = "≥ 0" if math.isinf(most) else f"from 0 to {most:g}"
        raise UsageError(f"{where}: {key} must be {wanted} ({unit}), got {number:g}")


def _check_agree(
    estimate: float, interval: tuple[float, float], prior: Prior, where: str, key: str, *, planned: bool
) -> None:
    """See that what is said of a parameter is what the adversary plans with.

    Args:
        estimate: its value.
        interval: of 95 %.
        prior: what is planned with.
        where: file or other origin.
        key: of the parameter.
        planned: whether it is; that of the spread of a sharp law is not.

    Raises:
        UsageError: they contradict each other.
    """
    low, high = interval
    slack = 1e-9 * max(1.0, abs(estimate))
    if not low - slack <= estimate <= high + slack:
        raise UsageError(f"{where}: {key}.interval_95 must hold the estimate {estimate:g}, got [{low:g}, {high:g}]")
    first, last = (prior.first, prior.second) if prior.distribution == "uniform" else (prior.first, prior.first)
    if planned and not first - slack <= estimate <= last + slack:
        raise UsageError(
            f"{where}: {key}.prior, which the adversary plans with, contradicts its estimate {estimate:g}: whoever "
            "changes the one changes the other"
        )
