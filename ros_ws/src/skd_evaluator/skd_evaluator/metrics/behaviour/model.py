"""A behaviour model: a table of parameters, each with its source, for one kind of road user, read from a YAML file.

Everything that differs from one crossing to the next is drawn from standard normals that have names (`walking`). A
scale s multiplies all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean, is_there
from skd_sim.inputs.model import Finite, Frozen, OneOf, read_model
from skd_sim.inputs.yaml_file import read_yaml, to_yaml
from skd_sim.scenario.road_user import ROAD_USERS

from skd_evaluator.metrics.behaviour import NO_BEHAVIOUR, WALKERS

FILE_NAME: Final = "behaviour.yaml"
_SHIPPED: Final = {WALKERS: Path(__file__).with_name("walkers.yaml")}


@dataclass(frozen=True)
class Meaning:
    """What a parameter is.

    Attributes:
        text: what it is the size of.
        unit: of its value; empty: none.
        low: least value allowed.
        high: greatest value allowed.
        fitted: whether tracks of people tell it; else it is assumed.
        by_logarithm: whether it is fitted by its logarithm: what cannot be 0.
        by_square: whether it is fitted by its square: what may be 0, and adds to what varies besides by its square.
    """

    text: str
    unit: str
    low: float
    high: float
    fitted: bool = True
    by_logarithm: bool = False
    by_square: bool = False


MEANINGS: Final = {
    "start_delay": Meaning("standard deviation of when somebody sets off", "s", 0.0, 5.0, fitted=False),
    "pace": Meaning("standard deviation of the logarithm of a person's pace", "", 0.0, 1.0, by_square=True),
    "heading": Meaning("standard deviation of a person's direction", "rad", 0.0, 1.0, by_square=True),
    "unrest": Meaning("standard deviation of the logarithm of how restless a person is", "", 0.0, 1.5, by_square=True),
    "pace_noise": Meaning("standard deviation of the logarithm of the pace on the way", "", 0.0, 2.0, by_square=True),
    "pace_time": Meaning("correlation time of the pace on the way", "s", 0.05, 20.0,
                         fitted=False),
    "turn": Meaning("standard deviation of the direction on the way", "rad", 0.0, 1.5),
    "turn_time": Meaning("correlation time of the direction on the way", "s", 0.05, 20.0, by_logarithm=True),
    "hesitation": Meaning("standard deviations of a person's doubt from which the person slows down", "", -1.0, 6.0),
    "hesitation_depth": Meaning("share of the pace that is lost for each standard deviation beyond it", "", 0.0, 10.0,
                                fitted=False),
    "hesitation_time": Meaning("correlation time of the doubt", "s", 0.05, 20.0, by_logarithm=True),
    "sway": Meaning("standard deviation of the place from tick to tick, along and across", "m", 0.0, 0.3),
}  # fmt: skip
"""The parameters of a behaviour model, in the order in which kernels take them."""
NAMES: Final = tuple(MEANINGS)


@dataclass(frozen=True)
class Parameter(Frozen):
    """A number of a behaviour model.

    Attributes:
        value: of it.
        source: where it is from.
        interval_95: 95 % interval of it; None: not known.
    """

    value: Finite
    source: str
    interval_95: tuple[Finite, Finite] | None = None

    def __post_init__(self) -> None:
        """Refuse a number that comes from nowhere, or is not in its interval."""
        if not self.source.strip():
            raise UsageError("source must say where the value is from")
        if self.interval_95 is not None and not self.interval_95[0] <= self.value <= self.interval_95[1]:
            low, high = self.interval_95
            raise UsageError(
                f"interval_95 must hold the value {self.value:g}, got [{low:g}, {high:g}]: whoever changes the one "
                "changes the other, or removes it"
            )


@dataclass(frozen=True)
class Behaviour(Frozen):
    """How road users of a kind deviate from the way that they intend.

    Attributes:
        name: what it is called in results.
        kind: of road user, as `adversary.kind` of a scenario.
        description: whom it is of.
        parameters: by name, all of `MEANINGS`.
    """

    name: str
    kind: str
    description: str
    parameters: dict[Annotated[str, OneOf(NAMES)], Parameter]

    def __post_init__(self) -> None:
        """Refuse a kind of road user that there is none of, and a model without all parameters."""
        ROAD_USERS.target(self.kind)
        if missing := [name for name in NAMES if name not in self.parameters]:
            raise UsageError(f"missing key parameters.{missing[0]}")

    @property
    def values(self) -> FloatArray:
        """The numbers, in the order of `MEANINGS`."""
        return np.array([self.parameters[name].value for name in NAMES])

    def as_dict(self) -> dict[str, Any]:
        """Return the content of its file."""
        rows = {}
        for name in NAMES:
            one = self.parameters[name]
            rows[name] = {"value": one.value, "source": one.source}
            if one.interval_95 is not None:
                rows[name]["interval_95"] = list(one.interval_95)
        return {"name": self.name, "kind": self.kind, "description": self.description, "parameters": rows}


def file_of(name: str | Path) -> Path:
    """Return the file of a behaviour model, by its name, or by the path of that file or of the folder that holds it."""
    path = _SHIPPED.get(str(name), Path(name).expanduser())
    return path / FILE_NAME if path.is_dir() else path


def load_behaviour(name: str | Path) -> Behaviour:
    """Return the behaviour model of a name, or of a file or the folder that holds it.

    Raises:
        UsageError: there is none, or the file is no behaviour model; says which key, and what would be right.
    """
    path = file_of(name)
    if not is_there(path):
        near = did_you_mean(str(name), tuple(_SHIPPED))
        raise UsageError(
            f"behaviour {str(name)!r}: cannot be read; give {WALKERS}, {NO_BEHAVIOUR}, or a file that skd behaviour "
            f"fit has written{near}"
        )
    return behaviour_from(read_yaml(path), str(path))


def behaviour_from(data: Any, where: str) -> Behaviour:
    """Return the behaviour model that plain data say.

    Args:
        data: content of a file.
        where: the file, for error lines.

    Raises:
        UsageError: they are none; says which key, and what would be right.
    """
    found = read_model(Behaviour, data, where)
    for name, one in found.parameters.items():
        meaning = MEANINGS[name]
        if not meaning.low <= one.value <= meaning.high:
            unit = f" {meaning.unit}" if meaning.unit else ""
            raise UsageError(
                f"{where}: parameters.{name}.value must be a number from {meaning.low:g} to {meaning.high:g}{unit}, "
                f"got {one.value:g}"
            )
    return found


def write_behaviour(path: Path, behaviour: Behaviour) -> None:
    """Write a behaviour model as `load_behaviour` reads it."""
    path.write_text(to_yaml(behaviour.as_dict()), encoding="utf-8")
