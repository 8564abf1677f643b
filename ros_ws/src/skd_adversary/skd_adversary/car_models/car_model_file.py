"""The predictive model of a car that was learned from logs, and `car_model.yaml`, its file for people and POMDPs."""

from __future__ import annotations

import base64
import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from skd_sim.errors import UsageError
from skd_sim.inputs.files import parse_json, read_bytes
from skd_sim.inputs.model import Count, Finite, Frozen, OneOf, limits, read_model
from skd_sim.inputs.yaml_file import read_yaml, short, to_yaml
from skd_sim.scenario.scenario import Scenario

from skd_adversary.car_models.forest import CarForest

PARAMETERS = {
    "trigger": ("m", 60.0),  # s where the measure is time
    "trigger_spread": ("m", 60.0),
    "path_half_width": ("m", 20.0),
    "deceleration": ("m/s²", 30.0),
    "deceleration_noise": ("relative", 1.0),
    "reaction_delay": ("s", 10.0),
    "cruise_speed": ("m/s", math.inf),
    "cruise_gain": ("1/s", math.inf),
    "cruise_acceleration": ("m/s²", math.inf),
    "speed_noise": ("relative", math.inf),
}
"""Every parameter: its unit, and the most that it can be where logs determine it; one in mm would be beyond that.

Half-widths of uniform noise are relative to the quantity that they perturb.
"""

LONGEST_DELAY = 3
"""Ticks between what the car sees and what it does, at most, that are looked for in logs and planned with."""

OPTIONAL = ("path_half_width", "cruise_acceleration")
"""Of them, those that a car may not have: no path that it looks at, no limit to how it speeds up."""

Positive = Annotated[float, limits(0.0)]


@dataclass(frozen=True)
class ParameterPrior(Frozen):
    """What is believed of a parameter: a point (first), uniform(first, second) or normal(first, second = deviation)."""

    distribution: Annotated[str, OneOf(("point", "uniform", "normal"))]
    first: Positive
    second: Positive = 0.0

    def __post_init__(self) -> None:
        """Refuse a uniform prior whose ends stand the wrong way round."""
        if self.distribution == "uniform" and self.second < self.first:
            raise UsageError(f"a uniform prior needs first ≤ second, got {self.first:g}, {self.second:g}")


@dataclass(frozen=True)
class CarParameter(Frozen):
    """One parameter as the logs show it.

    Attributes:
        prior: what the adversary believes of the parameter.
        estimate: likeliest value; none where it is not identifiable.
        standard_error: standard error of the estimate; None where it is not identifiable.
        interval: 95 % interval; None where it is not identifiable.
        reason: why it is not identifiable, beginning with "not identifiable: "; empty if it is.
    """

    prior: ParameterPrior
    estimate: Finite | None = None
    standard_error: Positive | None = None
    interval: tuple[Finite, Finite] | None = None
    reason: str = ""

    def __post_init__(self) -> None:
        """Refuse one without its numbers and without a reason for that."""
        if not self.reason and None in (self.estimate, self.standard_error, self.interval):
            raise UsageError("needs estimate, standard_error and interval, or the reason for none")

    @property
    def identifiable(self) -> bool:
        """Whether the logs determine it."""
        return not self.reason


@dataclass(frozen=True)
class FamilyRow(Frozen):
    """One line of the comparison of families; log-likelihoods in nats.

    `held_out` is over all folds; none for a family that is far behind in AIC.
    """

    name: str
    parameters: Count
    log_likelihood: Finite
    aic: Finite
    bic: Finite
    held_out: Finite | None
    trigger: Finite


@dataclass(frozen=True)
class LawCalibration(Frozen):
    """Probability integral transform of held-out ticks against the uniform distribution (Kolmogorov-Smirnov)."""

    ticks: Count
    statistic: Finite
    p_value: Finite


@dataclass(frozen=True)
class Prediction(Frozen):
    """How well held-out ticks are predicted, by one way to predict them.

    Attributes:
        model: `law` or `forest`.
        ticks: number of held-out ticks.
        statistic: Kolmogorov-Smirnov distance of their probability integral transform from the uniform distribution.
        near_ticks: how many of them were near the road user.
        near_statistic: the same statistic of the ticks near the road user.
        score: mean continuous ranked probability score of the change of speed in those, m/s; less is better.
    """

    model: str
    ticks: Count
    statistic: Finite
    near_ticks: Count
    near_statistic: Finite
    score: Finite


@dataclass(frozen=True, kw_only=True)
class FittedCar(Frozen):
    """The predictive model of a car, from logs: the content of its file.

    Attributes:
        measure: what the trigger is compared with: `distance` (m) or `time` (s to contact).
        gate: whether the adversary has to be in the path: `none`, `position` or `predicted`.
        spread: how the trigger varies: `sharp` (not at all), `episode` (from one episode to the next) or `tick`
            (from tick to tick).
        lapse: share of ticks that go against the law.
        chosen: name of the chosen family.
        parameters: all of `PARAMETERS`, by name, except for `OPTIONAL` ones that the car does not have.
        families: comparison of all families, the best held-out likelihood first.
        calibration: how well the chosen family is calibrated; None where there are too few logs.
        predictions: how well law and forest predict held-out ticks, if there are enough logs to compare them.
        logs: number of episodes.
        ticks: number of ticks.
        braking_ticks: number of ticks in which the car braked.
        time_step: duration of a tick, s.
        version: version of SKD that fitted it.
        front: front bumper of the car in the logs ahead of its reference point, m; none where it was not written down.
        rear: rear bumper behind the reference point, m; None where it was not written down.
        waiting_reward: m of deviation, at most 0, that each step after φ's end costs who waits for this car, by what
            kamikazes came to with it; none: it was not tried, and the kind of model says it.
        forest: forest that predicts the car, where no law does it as well; None: the law does.
    """

    measure: Annotated[str, OneOf(("distance", "time"))]
    gate: Annotated[str, OneOf(("none", "position", "predicted"))]
    spread: Annotated[str, OneOf(("sharp", "episode", "tick"))]
    lapse: Annotated[float, limits(0.0, 1.0, "share of ticks")]
    chosen: str = ""
    parameters: dict[Annotated[str, OneOf(PARAMETERS)], CarParameter]
    families: tuple[FamilyRow, ...] = ()
    calibration: LawCalibration | None = None
    predictions: tuple[Prediction, ...] = ()
    logs: Count = 0
    ticks: Count = 0
    braking_ticks: Count = 0
    time_step: Annotated[float, limits(0.001, 10.0, "s")]
    version: str = "unknown"
    front: Finite | None = None
    rear: Finite | None = None
    waiting_reward: Annotated[float, limits(-1000.0, 0.0, "m a step")] | None = None
    forest: CarForest | None = None

    def unit(self, name: str) -> str:
        """Return the unit of a parameter."""
        return "s" if self.measure == "time" and name in ("trigger", "trigger_spread") else PARAMETERS[name][0]


FILE_NAME = "car_model.yaml"
FOREST_SUFFIX = ".forest"
LARGEST_FOREST = 16 * 2**20
"""Bytes; one has about a hundred thousand."""
_HEAD = (
    "# Predictive model of a car, fitted from logs by skd fit. SI units; half-widths of noise are relative.\n"
    "# Priors: point (first), uniform (first to second), normal (mean first, standard deviation second).\n"
)


def car_model_data(car: FittedCar) -> dict[str, Any]:
    """Return a fitted car as plain data, a forest in base64; `car_model_from` is the inverse."""
    forest = None if car.forest is None else base64.b64encode(car.forest.packed).decode("ascii")
    return {**dataclasses.asdict(replace(car, forest=None)), "forest": forest}


def write_car_model(path: Path, car: FittedCar) -> None:
    """Write a fitted car as YAML; its forest, if it has one, goes into a file beside it, which the YAML names."""
    data = json.loads(json.dumps(car_model_data(car)))  # lists for tuples
    if car.forest is not None:
        beside = path.with_suffix(FOREST_SUFFIX)
        beside.write_bytes(car.forest.packed)
        data["forest"] = {"file": beside.name, "sha256": hashlib.sha256(car.forest.packed).hexdigest()}
    path.write_text(_HEAD + to_yaml(data), encoding="utf-8")


def file_of(source: Path) -> Path:
    """Return the file of a car model, by its path or that of the folder that `skd fit` wrote."""
    return source / FILE_NAME if source.is_dir() else source


def read_car_model(source: Path) -> FittedCar:
    """Return the fitted car in a file, or in a folder that `skd fit` wrote.

    Raises:
        UsageError: it cannot be read, is no car model, or its forest is not the one that was written with it.
    """
    path = file_of(source)
    data = read_yaml(path)
    named = data.get("forest") if isinstance(data, Mapping) else None
    if isinstance(named, Mapping):
        file = named.get("file")
        if not isinstance(file, str) or Path(file).name != file or not file:
            raise UsageError(f"{path}: forest.file must be the name of a file beside it, got {short(file)}")
        packed = read_bytes(path.parent / file, LARGEST_FOREST)
        if hashlib.sha256(packed).hexdigest() != named.get("sha256"):
            raise UsageError(f"{path}: {file} is not the forest that was written with it: its SHA-256 differs")
        data = {**data, "forest": base64.b64encode(packed).decode("ascii")}
    return car_model_from(data, str(path))


def car_model_from(data: Any, where: str = "car model") -> FittedCar:
    """Build and check a fitted car from plain data.

    Args:
        data: plain data, as `car_model_data` returns them.
        where: file or other origin, for messages.

    Raises:
        UsageError: a key is missing or has no valid value.
    """
    if isinstance(data, Mapping) and isinstance(data.get("forest"), str):
        data = {**data, "forest": _forest(data["forest"], where)}
    car = read_model(FittedCar, data, where)
    try:
        _check(car)
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from error
    return car


def _check(car: FittedCar) -> None:
    """Refuse a law that lacks a parameter, or has one that is beyond what it can be."""
    for name, (_, largest) in PARAMETERS.items():
        needed = name not in OPTIONAL or (name == "path_half_width" and car.gate != "none")
        if name not in car.parameters:
            if needed:
                raise UsageError(f"missing key parameters.{name}")
            continue
        one = car.parameters[name]
        most = math.inf if one.reason else largest
        numbers = {"prior.first": one.prior.first, "prior.second": one.prior.second, "estimate": one.estimate or 0.0}
        for key, number in numbers.items():
            if not 0.0 <= number <= most:
                limit = f"from 0 to {most:g} ({car.unit(name)})"
                raise UsageError(f"parameters.{name}.{key} must be {limit}, got {number:g}")
    delay = car.parameters["reaction_delay"].estimate or 0.0
    if delay > (LONGEST_DELAY + 1e-9) * car.time_step:
        ticks = f"{LONGEST_DELAY} ticks of {car.time_step:g} s"
        raise UsageError(f"parameters.reaction_delay.estimate must be at most {ticks}, got {delay:g} s")


def _forest(text: str, where: str) -> CarForest:
    """Return the forest in base64, looked through."""
    try:
        forest = CarForest(base64.b64decode(text, validate=True))
        assert forest.trees
    except ValueError as error:  # UsageError is one
        raise UsageError(f"{where}: {error}") from error
    return forest


def car_model_text(car: FittedCar) -> str:
    """Return what a specification of an episode carries: JSON, without the comparison of families."""
    return json.dumps({**car_model_data(car), "families": []}, ensure_ascii=False, allow_nan=False)


@functools.cache
def fitted_car(text: str) -> FittedCar:
    """Return the fitted car that `car_model_text` wrote; the same text is read once.

    Raises:
        UsageError: it is none.
    """
    where = "car model of the episode"
    return car_model_from(parse_json(text, where), where)


def car_model_for_scenario(source: Path, scenario: Scenario) -> str:
    """Return the car model in a file or folder, as an episode of the scenario carries it.

    Raises:
        UsageError: it cannot be read, is no car model, or does not go with the scenario.
    """
    car = read_car_model(source)
    check_scenario(car, scenario, str(source))
    return car_model_text(car)


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
        ("front", "m", car.front, scenario.car.front),
        ("rear", "m", car.rear, scenario.car.rear),
    )
    for key, unit, one, other in pairs:
        if one is not None and not math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-12):
            other_one = f"that of scenario {scenario.name} {other:g} {unit}"
            raise UsageError(f"{where}: {key} is {one:g} {unit}, {other_one}; fit the car anew (skd probe, skd fit)")
