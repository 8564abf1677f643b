"""The options of an episode, each in one place, and what a table of options is.

A field of `EpisodeOptions` that `option` makes is an option: by its entry here it is on the command line, a parameter
of the evaluator's node with a description, a launch argument, in messages and bags, and in results. Light: every
command begins with it.
"""

# ruff: noqa: RUF009 - `option` makes a field, as `dataclasses.field` does
from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, cast

from skd_sim.choices.car_under_test import DEFAULT, CarUnderTest
from skd_sim.choices.knowledge import Knowledge, implied_knowledge
from skd_sim.choices.objective import BOTH, DEFAULT_SIMULATIONS, OBJECTIVES, Objective
from skd_sim.choices.registry import Registry
from skd_sim.choices.simulators import SIMULATORS, WORLD
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import parse_json
from skd_sim.inputs.suggestion import did_you_mean

COMMANDS: Final = ("assess", "sweep", "episode")
"""Those that run kamikazes."""
GRAPH_COMMANDS: Final = ("assess", "episode", "probe", "drive")
"""Those that can run their episodes through the node graph."""
LAUNCHES: Final = ("assessment", "episode")


class Names:
    """Names that may be chosen: some fixed ones and those of a registry, which is asked only for a name it may know."""

    def __init__(self, fixed: tuple[str, ...], registry: Registry | None = None) -> None:
        """Allow some names, and those of a registry if there is one."""
        self._fixed, self._registry = fixed, registry

    @property
    def own(self) -> tuple[str, ...]:
        """Those that are known without looking at installed packages."""
        return (*self._fixed, *(() if self._registry is None else self._registry.own))

    def __contains__(self, name: object) -> bool:
        return name in self._fixed or (self._registry is not None and name in self._registry)

    def __iter__(self) -> Iterator[str]:
        return iter((*self._fixed, *(() if self._registry is None else self._registry.names())))


class Lists(Names):
    """Lists of names, with commas in between and each at most once."""

    def __contains__(self, text: object) -> bool:
        parts = str(text).split(",")
        return len(set(parts)) == len(parts) and all(super(Lists, self).__contains__(part) for part in parts)


@dataclass(frozen=True)
class Option:
    """An option: what it means, what it may be, and where it can be given.

    Attributes:
        text: what it means, with its unit; it stands in every --help and description.
        low: least number allowed.
        high: greatest number allowed.
        choices: the texts that are allowed; any by default.
        metavar: name of its value on the command line.
        flag: its name on the command line; by default made from its name.
        group: title of the group of options to which it belongs on the command line.
        commands: names of the commands that take it.
        launches: names of the launch files that take it.
        asked: its default for an assessment, where that differs from the default of a single episode.
        absent: what a parameter, a launch argument or a message says for None, which then is the default.
        implied: the value for which None stands in an episode, by its other options; messages leave out an implied
            value.
        unset: what None, or an empty text, means.
        make: turns plain data into its value.
        field: whether the message `Episode`, and results, have a field of this name; otherwise it is in their field
            `options`.
        planning: whether it matters only where somebody plans.
        graph_only: whether it has no effect on episodes that run in process.
        external_only: whether it is about a controller that is a node of somebody else.
        many: whether it can be given several times; then its value is a tuple.
        name: filled in from the field, as are the next two.
        kind: type of its plain data: bool, int, float or str.
        default: its value where no other is given.
    """

    text: str
    low: float | None = None
    high: float | None = None
    choices: Names | None = None
    metavar: str | None = None
    flag: str | None = None
    group: str = "campaign"
    commands: tuple[str, ...] = COMMANDS
    launches: tuple[str, ...] = LAUNCHES
    asked: Any = None
    absent: Any = None
    implied: Callable[[Any], Any] | None = None
    unset: str = ""
    make: Callable[[Any], Any] | None = None
    field: bool = False
    planning: bool = False
    graph_only: bool = False
    external_only: bool = False
    many: bool = False
    name: str = ""
    kind: type[Any] = str
    default: Any = None

    @property
    def unsaid(self) -> Any:
        """Its value on the command line where it is not given."""
        return self.default if self.asked is None else self.asked

    @property
    def plain_default(self) -> Any:
        """What a parameter or a launch argument is by default, as plain data."""
        return self.plain(self.default) if self.asked is None else self.asked

    @property
    def texts(self) -> tuple[str, ...]:
        """The texts that a parameter or a launch argument may have, if there are only a few; else empty."""
        if self.choices is None:
            return ()
        return (*self.choices, *(() if self.absent is None else (str(self.absent),)))

    def plain(self, value: Any) -> Any:
        """Return a value as plain data, for messages, parameters and results."""
        return self.absent if value is None else self.kind(value)

    def value(self, plain: Any) -> Any:
        """Return the value that plain data stand for, the inverse of `plain`; None: the default."""
        if plain is None or (self.absent is not None and plain == self.absent):
            return self.default
        if self.many:
            return tuple(map(self.kind, plain))
        return self.kind(plain) if self.make is None else self.make(self.kind(plain))

    def read(self, plain: Any, where: str) -> Any:
        """Return the value of plain data that somebody else has written.

        Raises:
            UsageError: it is of another type, out of range, or none of the choices.
        """
        self.check(plain, f"{where}: {self.name}")
        return self.value(plain)

    def check(self, plain: Any, what: str) -> None:
        """Refuse plain data that somebody else has written.

        Args:
            plain: the plain data.
            what: name of the data, for the error line.

        Raises:
            UsageError: they are of another type, out of range, or none of the choices.
        """
        numbers = (int, float) if self.kind is float else self.kind
        if self.absent is not None and plain == self.absent and isinstance(plain, numbers):
            return
        if not isinstance(plain, numbers) or (isinstance(plain, bool) and self.kind is not bool):
            raise UsageError(f"{what} must be of type {self.kind.__name__}, got {plain!r:.60}")
        if self.kind in (int, float) and not self._in_range(plain):
            raise UsageError(f"{what} must be a number from {self.low} to {self.high}, got {plain!r:.60}")
        if self.choices is not None and plain not in self.choices:
            near = did_you_mean(str(plain), self.choices)
            raise UsageError(f"{what} must be one of {', '.join(self.choices)}; got {plain!r:.60}{near}")

    def _in_range(self, number: float) -> bool:
        low = -math.inf if self.low is None else self.low
        high = math.inf if self.high is None else self.high
        return low <= number <= high and abs(number) < math.inf  # unlike isfinite, of whatever whole number


def option(default: Any, text: str, kind: type[Any] | None = None, **more: Any) -> Any:
    """Return a field of a dataclass that is an option.

    Args:
        default: its value where no other is given.
        text: what it means, with its unit.
        kind: bool, int, float or str; by default that of the default.
        more: further attributes of `Option`.
    """
    entry = Option(text, kind=kind or type(default), default=default, **more)
    return field(default=default, metadata={"option": entry})


@functools.cache
def options_of(table: Callable[..., Any]) -> tuple[Option, ...]:
    """Return the options of a dataclass, in the order of its fields."""
    return tuple(
        dataclasses.replace(one.metadata["option"], name=one.name)
        for one in dataclasses.fields(cast(type[Any], table))
        if "option" in one.metadata
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class EpisodeOptions:
    """The table of an episode's options, which are also those of a campaign; each is described where it stands."""

    controller: str = option(
        DEFAULT,
        "the car under test: basic (the paper's simple car), cal (the paper's machine-learning controller), carla (the "
        "driving rules of CARLA 0.8), metadrive_expert (MetaDrive's own trained driver; in simulator metadrive only), "
        "a name that an installed package has registered, package.module:Class (a Python class of your own), or "
        "external (a ROS node of your own, which needs the node graph)",
        metavar="NAME",
        group="car and test",
        commands=("assess", "episode", "probe", "ncap", "drive"),
        field=True,
    )
    multiplier: float = option(
        1.0,
        "C of the basic controller: it brakes when the adversary is ahead of it by at most C times the distance in "
        "which it can stop",
        low=0.0,
        high=100.0,
        metavar="C",
        group="car and test",
        commands=("assess", "episode", "probe", "ncap", "drive"),
        field=True,
    )
    simulator: str = option(
        WORLD,
        "what moves car and adversary: world (SKD's own simulator), metadrive (MetaDrive, which has to be installed: "
        "extra metadrive), or a simulator that an installed package has registered",
        choices=Names((), SIMULATORS),
        group="car and test",
        commands=("assess", "episode", "probe"),
    )
    car_model: str = option(
        "",
        "the model of the car with which the adversary plans: a file car_model.yaml that skd fit has written, or the "
        "folder that holds it",
        metavar="FILE",
        group="car and test",
        unset="none",
        field=True,
    )
    knowledge: Knowledge | None = option(
        None,
        "what the adversary knows about the car: nothing (it takes every car for a basic one), learned (it plans "
        "with the "
        "model in --car-model; where none is given, one is learned from test drives of the car and kept for the next "
        "time), known (it knows C of the basic controller)",
        str,
        choices=Names(tuple(map(str, Knowledge))),
        metavar="{" + ",".join(Knowledge) + "}",
        group="car and test",
        commands=("assess", "episode"),
        absent="",
        implied=lambda source: implied_knowledge(source.car, source.car_model),
        unset="known for basic, learned for any other car",
        make=Knowledge,
        planning=True,
    )
    simulations: int = option(
        DEFAULT_SIMULATIONS,
        "how many futures the planner simulates before each decision of a kamikaze",
        low=1,
        high=100_000,
        metavar="N",
        commands=(*COMMANDS, "ncap"),
        field=True,
        planning=True,
    )
    objective: Objective = option(
        Objective.PAPER,
        "what kamikazes are rewarded for: deformation (bending the safe trajectory φ as little as possible: this one "
        "ranks cars), paper (colliding as soon as possible), frechet (a small Fréchet distance to φ), or both "
        "(deformation and then paper; where only a single episode is run, paper)",
        str,
        choices=Names((BOTH,), OBJECTIVES),
        asked=BOTH,
        make=Objective,
        field=True,
    )
    particles: int | None = option(
        None,
        "how many particles (guesses of the car's state) make up what the adversary believes about the car",
        int,
        low=0,
        high=1_000_000,
        metavar="N",
        absent=0,
        unset="the number for which the objective was tuned",
        planning=True,
    )
    maximum_distance: float | None = option(
        None,
        "leave out each kamikaze that ends up further than this many metres from its safe trajectory, and report how "
        "many were left out",
        float,
        low=0.0,
        high=1e6,
        metavar="M",
        flag="--max-distance",
        launches=("assessment",),
        absent=0.0,
        unset="none is left out",
        field=True,
    )

    @property
    def car(self) -> CarUnderTest:
        """The car under test."""
        return CarUnderTest(self.controller, self.multiplier)

    @property
    def knows(self) -> Knowledge:
        """What the adversary plans with: `knowledge`, or what is implied where that says nothing."""
        return self.knowledge or implied_knowledge(self.car, self.car_model)


def values_of(table: Callable[..., Any], plain: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a table by name, from plain data; other names are ignored, and missing ones left out.

    Args:
        table: the dataclass whose fields are the options.
        plain: values by name, as the command line or a node's parameters have them.
    """
    return {one.name: one.value(plain[one.name]) for one in options_of(table) if one.name in plain}


def shared_options(source: EpisodeOptions) -> dict[str, Any]:
    """Return the options of an episode or a campaign by name, for the making of another."""
    return {one.name: getattr(source, one.name) for one in options_of(EpisodeOptions)}


def further_options(source: EpisodeOptions) -> dict[str, Any]:
    """Return, as plain data, the options that messages and results have no field for and that are not as by default."""
    chosen = {one.name: (getattr(source, one.name), one) for one in options_of(EpisodeOptions) if not one.field}
    return {
        name: one.plain(value)
        for name, (value, one) in chosen.items()
        if value != one.default and (one.implied is None or value != one.implied(source))
    }


def options_to_text(source: EpisodeOptions) -> str:
    """Return `further_options` as a message carries them: JSON, empty where there are none."""
    found = further_options(source)
    return json.dumps(found, ensure_ascii=False) if found else ""


def options_from_text(text: str, where: str) -> dict[str, Any]:
    """Return the options in a message's JSON by name; the inverse of `options_to_text`.

    Raises:
        UsageError: it is no JSON of options that this version knows.
    """
    if not text:
        return {}
    data = parse_json(text, where)
    known = {one.name: one for one in options_of(EpisodeOptions) if not one.field}
    if not isinstance(data, Mapping) or set(data) - set(known):
        unknown = ", ".join(sorted(set(data) - set(known))) if isinstance(data, Mapping) else "no mapping"
        raise UsageError(f"{where}: unknown option {unknown:.60}: of another version of SKD?")
    return {name: known[name].read(plain, where) for name, plain in data.items()}
