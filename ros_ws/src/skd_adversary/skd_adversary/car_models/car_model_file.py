"""The predictive model of a car that was learned from logs, and `car_model.yaml`, its file for people and POMDPs."""

from __future__ import annotations

import base64
import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from skd_sim.errors import UsageError
from skd_sim.inputs.files import is_there, parse_json, read_bytes
from skd_sim.inputs.model import Count, Finite, Frozen, OneOf, YesNo, limits, read_model
from skd_sim.inputs.yaml_file import read_yaml, short, to_yaml
from skd_sim.scenario.scenario import Scenario

from skd_adversary.car_models.forest import CarForest

DISTRIBUTIONS = ("point", "uniform", "normal")

PARAMETERS = {
    "trigger": "m",  # s where the measure is time
    "trigger_spread": "m",
    "path_half_width": "m",
    "deceleration": "m/s²",
    "deceleration_noise": "relative",
    "reaction_delay": "s",
    "cruise_speed": "m/s",
    "cruise_gain": "1/s",
    "cruise_acceleration": "m/s²",
    "speed_noise": "relative",
}
"""Every parameter and its unit; half-widths of uniform noise are relative to the quantity that they perturb."""

LARGEST = {
    "trigger": 60.0,
    "trigger_spread": 60.0,
    "path_half_width": 20.0,
    "deceleration": 30.0,
    "deceleration_noise": 1.0,
    "reaction_delay": 10.0,
}
"""The most that each can be where logs determine it, in its unit: more than recordings may show, and a fit looks for.

A number in another unit, such as mm, is beyond it. What others come to (a speed to which a car that speeds up is on its
way, say) has no end.
"""

LONGEST_DELAY = 3
"""Ticks between what the car sees and what it does, at most, that are looked for in logs and planned with."""

OPTIONAL = ("path_half_width", "cruise_acceleration")
"""Of them, those that a car may not have: no path that it looks at, no limit to how it speeds up."""


@dataclass(frozen=True)
class ParameterPrior:
    """What is believed of a parameter: a point, uniform(first, second) or normal(first, second = deviation)."""

    distribution: str
    first: float
    second: float = 0.0

    def __post_init__(self) -> None:
        if self.distribution not in DISTRIBUTIONS:
            raise UsageError(f"distribution must be one of {', '.join(DISTRIBUTIONS)}, got {self.distribution!r}")
        if not (math.isfinite(self.first) and math.isfinite(self.second)):
            raise UsageError(f"a {self.distribution} prior needs finite numbers, got {self.first}, {self.second}")
        if self.distribution == "uniform" and self.second < self.first:
            raise UsageError(f"a uniform prior needs low ≤ high, got {self.first:g}, {self.second:g}")
        if self.distribution == "normal" and self.second < 0.0:
            raise UsageError(f"a normal prior needs a deviation ≥ 0, got {self.second:g}")


@dataclass(frozen=True)
class CarParameter:
    """One parameter as the logs show it.

    Attributes:
        prior: what the adversary believes of the parameter.
        estimate: likeliest value; none where it is not identifiable.
        standard_error: standard error of the estimate; None where it is not identifiable.
        interval: 95 % interval; None where it is not identifiable.
        reason: why it is not identifiable, beginning with "not identifiable: "; empty if it is.
    """

    prior: ParameterPrior
    estimate: float | None = None
    standard_error: float | None = None
    interval: tuple[float, float] | None = None
    reason: str = ""

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


@dataclass(frozen=True)
class FittedCar:
    """The predictive model of a car, from logs.

    Attributes:
        measure: what the trigger is compared with: `distance` (m) or `time` (s to contact).
        gate: whether the adversary has to be in the path: `none`, `position` or `predicted`.
        spread: how the trigger varies: `sharp` (not at all), `episode` (from one episode to the next) or `tick`
            (from tick to tick).
        lapse: share of ticks that go against the law.
        parameters: all of `PARAMETERS`, by name, except for `OPTIONAL` ones that the car does not have.
        families: comparison of all families, the best held-out likelihood first.
        chosen: name of the chosen family.
        calibration: how well the chosen family is calibrated; None where there are too few logs.
        logs: number of episodes.
        ticks: number of ticks.
        braking_ticks: number of ticks in which the car braked.
        time_step: duration of a tick, s.
        version: version of SKD that fitted it.
        front: front bumper of the car in the logs ahead of its reference point, m; none where it was not written down.
        rear: rear bumper behind the reference point, m; None where it was not written down.
        forest: forest that predicts the car, where no law does it as well; None: the law does.
        predictions: how well law and forest predict held-out ticks, if there are enough logs to compare them.
        waiting_reward: m of deviation, at most 0, that each step after φ's end costs who waits for this car, by what
            kamikazes came to with it; none: nobody has tried, and the kind of model says it.
    """

    measure: str
    gate: str
    spread: str
    lapse: float
    parameters: dict[str, CarParameter]
    families: tuple[FamilyRow, ...]
    chosen: str
    calibration: LawCalibration | None
    logs: int
    ticks: int
    braking_ticks: int
    time_step: float
    version: str = "unknown"
    front: float | None = None
    rear: float | None = None
    forest: CarForest | None = None
    predictions: tuple[Prediction, ...] = ()
    waiting_reward: float | None = None

    def unit(self, name: str) -> str:
        """Return the unit of a parameter."""
        return "s" if self.measure == "time" and name in ("trigger", "trigger_spread") else PARAMETERS[name]


FILE_NAME = "car_model.yaml"
FOREST_SUFFIX = ".forest"
LARGEST_FOREST = 16 * 2**20
"""Bytes; one has about a hundred thousand."""
_NAMES = {"point": ("value",), "uniform": ("low", "high"), "normal": ("mean", "standard_deviation")}
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
    if not is_there(path):
        raise UsageError(f"car model {path}: cannot be read (No such file or directory); skd fit writes one")
    return car_model_from(_with_forest(read_yaml(path), path), str(path))


@dataclass(frozen=True)
class _Prior(Frozen):
    distribution: Annotated[str, OneOf(_NAMES)]
    value: Finite | None = None
    low: Finite | None = None
    high: Finite | None = None
    mean: Finite | None = None
    standard_deviation: Finite | None = None

    def __post_init__(self) -> None:
        needed = _NAMES[self.distribution]
        if any(getattr(self, name) is None for name in needed):
            raise UsageError(f"a {self.distribution} prior needs {' and '.join(needed)}")
        ParameterPrior(self.distribution, *self.numbers.values())

    @property
    def numbers(self) -> dict[str, float]:
        return {name: getattr(self, name) for name in _NAMES[self.distribution]}


@dataclass(frozen=True)
class _Parameter(Frozen):
    prior: _Prior
    unit: str | None = None
    identifiable: YesNo = True
    estimate: Finite | None = None
    standard_error: Annotated[float, limits(0.0)] | None = None
    interval_95: tuple[Finite, Finite] | None = None
    reason: str = ""

    def __post_init__(self) -> None:
        if self.reason:
            return
        if self.estimate is None or self.standard_error is None or self.interval_95 is None:
            raise UsageError("needs estimate, standard_error and interval_95, or the reason for none")

    @property
    def parameter(self) -> CarParameter:
        prior = ParameterPrior(self.prior.distribution, *self.prior.numbers.values())
        if self.reason or self.interval_95 is None:
            return CarParameter(prior, reason=self.reason)
        return CarParameter(prior, self.estimate, self.standard_error, self.interval_95)


@dataclass(frozen=True)
class _Family(Frozen):
    measure: Annotated[str, OneOf(("distance", "time"))]
    gate: Annotated[str, OneOf(("none", "position", "predicted"))]
    spread: Annotated[str, OneOf(("sharp", "episode", "tick"))]
    lapse: Annotated[float, limits(0.0, 1.0, "share of ticks")]
    name: str = ""


@dataclass(frozen=True)
class _Footprint(Frozen):
    front: Finite
    rear: Finite


@dataclass(frozen=True)
class _CarModelFile(Frozen):
    """The content of a car model's file; its forest is in base64."""

    time_step: Annotated[float, limits(0.001, 10.0, "s")]
    family: _Family
    parameters: dict[Annotated[str, OneOf(PARAMETERS)], _Parameter]
    footprint: _Footprint | None = None
    families: tuple[FamilyRow, ...] = ()
    calibration: LawCalibration | None = None
    predictions: tuple[Prediction, ...] = ()
    logs: Count = 0
    ticks: Count = 0
    braking_ticks: Count = 0
    version: str = "unknown"
    waiting_reward: Annotated[float, limits(-1000.0, 0.0, "m a step")] | None = None
    forest: str | None = None

    def __post_init__(self) -> None:
        """Refuse a law that lacks a parameter, or one that is beyond what it can be or contradicts its prior."""
        units = dict(PARAMETERS)
        if self.family.measure == "time":
            units |= dict.fromkeys(("trigger", "trigger_spread"), "s")
        for name, unit in units.items():
            needed = name not in OPTIONAL or (name == "path_half_width" and self.family.gate != "none")
            if name in self.parameters:
                self._check(name, unit, self.parameters[name])
            elif needed:
                raise UsageError(f"missing key parameters.{name}")
        delay = self.parameters["reaction_delay"].estimate or 0.0
        if delay > (LONGEST_DELAY + 1e-9) * self.time_step:
            raise UsageError(
                f"parameters.reaction_delay.estimate must be at most {LONGEST_DELAY} ticks of {self.time_step:g} s, "
                f"with which the adversary can plan, got {delay:g} s"
            )

    def _check(self, name: str, unit: str, one: _Parameter) -> None:
        key, numbers = f"parameters.{name}", one.prior.numbers
        if one.unit not in (None, unit):
            raise UsageError(
                f"{key}.unit must be {unit} where family.measure is {self.family.measure}, got {short(one.unit)}"
            )
        most = math.inf if one.reason else LARGEST.get(name, math.inf)
        within = {f"prior.{which}": number for which, number in numbers.items()}
        if not one.reason and one.estimate is not None:
            within["estimate"] = one.estimate
        for which, number in within.items():
            if not 0.0 <= number <= most:
                right = "≥ 0" if math.isinf(most) else f"from 0 to {most:g}"
                raise UsageError(f"{key}.{which} must be {right} ({unit}), got {number:g}")


def car_model_from(data: Any, where: str = "car model") -> FittedCar:
    """Build and check a fitted car from plain data.

    Args:
        data: plain data, as `car_model_data` returns them.
        where: file or other origin, for messages.

    Raises:
        UsageError: a key is missing or has no valid value.
    """
    file = read_model(_CarModelFile, data, where)
    family, size = file.family, file.footprint
    shared = ("families", "calibration", "logs", "ticks", "braking_ticks", "time_step", "version", "predictions")
    return FittedCar(
        measure=family.measure,
        gate=family.gate,
        spread=family.spread,
        lapse=family.lapse,
        parameters={name: one.parameter for name, one in file.parameters.items()},
        chosen=family.name,
        front=None if size is None else size.front,
        rear=None if size is None else size.rear,
        forest=None if file.forest is None else _forest(file.forest, where),
        waiting_reward=file.waiting_reward,
        **{name: getattr(file, name) for name in shared},
    )


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


def _forest(text: str, where: str) -> CarForest:
    """Return the forest in base64, looked through."""
    try:
        forest = CarForest(base64.b64decode(text, validate=True))
    except ValueError as error:
        raise UsageError(f"{where}: forest is not base64") from error
    try:
        assert forest.trees
    except UsageError as error:
        raise UsageError(f"{where}: {error}") from error
    return forest
