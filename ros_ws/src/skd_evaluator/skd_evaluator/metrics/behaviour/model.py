"""A behaviour model: a table of parameters, each with its source, for one kind of road user, read from a YAML file.

Everything that differs from one crossing to the next is drawn from standard normals that have names (`walking`). A
scale s multiplies all of them.

Walking a way as people do: from standard normals to places at ticks, compiled.

The normals of a crossing have names. One each for the person: `start` (when the person sets off), `pace` (how fast the
person walks), `heading` (which way, beside the one intended) and `unrest` (how much the pace changes on the way). Then
five for each tick: `pace`, `turn` and `doubt` drive three processes with a memory: the logarithm of the pace and the
direction (Ornstein and Uhlenbeck 1930), and, smoother, the doubt that makes a person slow down, and stop, beyond a
threshold; `along` and `across` are sway. A scale multiplies every normal. What follows is continuous in them, so that
nearby normals are nearby crossings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean, is_there
from skd_sim.inputs.model import Finite, Frozen, OneOf, plain, read_model
from skd_sim.inputs.yaml_file import read_yaml, to_yaml
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.road_user import ROAD_USERS
from skd_sim.world.state import FloatArray

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
    "start_delay": Meaning("standard deviation of when a person sets off", "s", 0.0, 5.0, fitted=False),
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
            raise UsageError(f"interval_95 must hold the value {self.value:g}, got [{low:g}, {high:g}]")


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
        return {**plain(self), "parameters": {name: plain(self.parameters[name]) for name in NAMES}}


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
        known = f"{WALKERS}, {NO_BEHAVIOUR}, or a file of skd fit --people"
        raise UsageError(f"behaviour {str(name)!r}: cannot be read; give {known}{near}")
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
            limits = f"from {meaning.low:g} to {meaning.high:g}{unit}"
            raise UsageError(f"{where}: parameters.{name}.value must be a number {limits}, got {one.value:g}")
    return found


def write_behaviour(path: Path, behaviour: Behaviour) -> None:
    """Write a behaviour model as `load_behaviour` reads it."""
    path.write_text(to_yaml(behaviour.as_dict()), encoding="utf-8")


OF_PERSON: Final = ("start", "pace", "heading", "unrest")
OF_TICK: Final = ("pace", "turn", "doubt", "along", "across")
FASTEST: Final = 12.0
"""m/s; no person has run faster (model/road_user/pedestrian.py)."""
_PERSON, _TICK = len(OF_PERSON), len(OF_TICK)
_STEEPEST = 0.5 * math.pi


def normals_of(ticks: int) -> int:
    """Return how many normals a crossing of so many ticks at most is made of."""
    return _PERSON + _TICK * ticks


@kernel
def _place(path: FloatArray, moment: float) -> tuple[float, float]:
    """Return where a way is at a moment in ticks, linear between its points and at its end after it."""
    last = path.shape[0] - 1
    if moment >= last:
        return path[last, 0], path[last, 1]
    index = int(moment)
    share = moment - index
    return (
        path[index, 0] + share * (path[index + 1, 0] - path[index, 0]),
        path[index, 1] + share * (path[index + 1, 1] - path[index, 1]),
    )


@kernel
def smooth(now: float, past: float, keep: float, normal: float, tick: int) -> float:
    """Return the next value of a stationary process of variance 1 and of second order, both roots alike.

    It has a velocity: a person does not stop at once, as a process of first order would have it.
    """
    if tick == 0:
        return normal
    square = keep * keep
    if tick == 1:
        like = 2.0 * keep / (1.0 + square)
        return like * now + math.sqrt(1.0 - like * like) * normal
    return 2.0 * keep * now - square * past + math.sqrt((1.0 - square) ** 3 / (1.0 + square)) * normal


@kernel
def walk(
    path: FloatArray, values: FloatArray, normals: FloatArray, scale: float, time_step: float, track: FloatArray
) -> int:
    """Walk a way as the normals say.

    Args:
        path: the way that is intended, at ticks, n × 2, m.
        values: parameters of the behaviour model, in the order of `MEANINGS`.
        normals: standard normals, `normals_of(ticks)`.
        scale: by which they are multiplied.
        time_step: duration of a tick, s.
        track: (ticks + 1) × 2, m; is filled with the places at ticks.

    Returns:
        How many places there are: as far as the way's end, or all.
    """
    (start_delay, pace, heading, unrest, pace_noise, pace_time, turn, turn_time, threshold, depth, doubt_time, sway) = (
        values[0], values[1], values[2], values[3], values[4], values[5],
        values[6], values[7], values[8], values[9], values[10], values[11],
    )  # fmt: skip
    ticks: int = track.shape[0] - 1
    last = path.shape[0] - 1.0
    delay = scale * start_delay * normals[0] / time_step
    own_pace = scale * pace * normals[1]
    own_heading = scale * heading * normals[2]
    restless = math.exp(scale * unrest * normals[3])
    keep_pace, keep_turn = math.exp(-time_step / pace_time), math.exp(-time_step / turn_time)
    keep_doubt = math.exp(-time_step / doubt_time)
    new_pace, new_turn = math.sqrt(1.0 - keep_pace * keep_pace), math.sqrt(1.0 - keep_turn * keep_turn)
    moment = min(max(0.0, -delay), last)  # who sets off early is already on the way
    x, y = _place(path, moment)
    on_x, on_y = x, y
    track[0, 0], track[0, 1] = x, y
    now_pace = now_turn = now_doubt = past_doubt = 0.0
    for tick in range(ticks):
        first = _PERSON + _TICK * tick
        if tick == 0:
            now_pace, now_turn = normals[first], normals[first + 1]
        else:
            now_pace = keep_pace * now_pace + new_pace * normals[first]
            now_turn = keep_turn * now_turn + new_turn * normals[first + 1]
        now_doubt, past_doubt = smooth(now_doubt, past_doubt, keep_doubt, normals[first + 2], tick), now_doubt
        off = min(max(tick + 1.0 - delay, 0.0), 1.0)  # share of the tick after the start
        slowed = min(max(1.0 - depth * (scale * restless * now_doubt - threshold), 0.0), 1.0)
        passed = off * slowed * math.exp(own_pace + scale * pace_noise * restless * now_pace)
        # At the pace of the intended way here, so that a long step jumps over none of its turns or stops.
        ahead = min(moment + passed, last)
        next_x, next_y = _place(path, ahead)
        step_x, step_y = next_x - on_x, next_y - on_y
        length, longest = math.sqrt(step_x * step_x + step_y * step_y), FASTEST * time_step
        if length > longest:
            ahead = moment + (ahead - moment) * longest / length
            next_x, next_y = _place(path, ahead)
            step_x, step_y = next_x - on_x, next_y - on_y
        turned = min(max(own_heading + scale * turn * now_turn, -_STEEPEST), _STEEPEST)
        cos, sin = math.cos(turned), math.sin(turned)
        x, y = x + cos * step_x - sin * step_y, y + sin * step_x + cos * step_y
        moment, on_x, on_y = ahead, next_x, next_y
        track[tick + 1, 0] = x + scale * sway * normals[first + 3]
        track[tick + 1, 1] = y + scale * sway * normals[first + 4]
        if moment >= last:
            return tick + 2
    return ticks + 1


@kernel
def walk_many(path: FloatArray, values: FloatArray, normals: FloatArray, time_step: float, tracks: FloatArray) -> None:
    """Walk one way as each row of normals says; ways are m × (ticks + 1) × 2."""
    for row in range(normals.shape[0]):
        count = walk(path, values, normals[row], 1.0, time_step, tracks[row])
        for tick in range(count, tracks.shape[1]):
            tracks[row, tick, 0], tracks[row, tick, 1] = np.nan, np.nan


def walked(path: FloatArray, values: FloatArray, normals: FloatArray, scale: float, time_step: float) -> FloatArray:
    """Return the places at ticks of a person who walks a way; see `walk`."""
    ticks = (len(normals) - _PERSON) // _TICK
    track = np.empty((ticks + 1, 2))
    count: int = walk(np.ascontiguousarray(path), values, normals, scale, time_step, track)
    return track[:count]
