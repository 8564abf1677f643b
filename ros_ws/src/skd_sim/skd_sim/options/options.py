"""The options of episodes and of the node graph, each in one place, and what a table of options is.

A field of a table that `option` makes is an option: by its entry here it is on the command line, a parameter of the
node that needs it, a launch argument, in messages and bags, and in results. Light: every command begins with it.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, NamedTuple, cast

from skd_sim.errors import UsageError
from skd_sim.inputs.files import parse_json
from skd_sim.options.car_and_adversary import (
    BOTH,
    DEFAULT,
    DEFAULT_SIMULATIONS,
    OBJECTIVES,
    SIMULATORS,
    WORLD,
    AdversaryModel,
    CarUnderTest,
    ControllerName,
    Objective,
    default_adversary_model,
)
from skd_sim.options.registry import Registry

# ruff: noqa: RUF009 - `option` makes a field, as `dataclasses.field` does

COMMANDS: Final = ("assess", "sweep", "episode")
"""Those that run kamikazes."""
FIELDS: Final = {"controller", "multiplier", "car_model", "simulations", "objective", "maximum_distance"}
"""Options for which the message `Episode`, and results, have a field; the others are in their field `options`."""
GRAPH_COMMANDS: Final = ("assess", "episode", "probe", "drive")
"""Those that can run their episodes through the node graph."""
LAUNCHES: Final = ("assessment", "episode")
PLANNING, GRAPH, EXTERNAL, RARE = "planning", "graph", "external", "rare"


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
        kind: type of its value: bool, int, float, str, tuple (of texts: it can be given several times), or a class made
            of a text.
        default: its value where no other is given.
        low: least number allowed.
        high: greatest number allowed.
        choices: the texts that are allowed; any by default.
        metavar: name of its value on the command line.
        group: title of the group of options to which it belongs on the command line.
        commands: names of the commands that take it.
        launches: names of the launch files that take it.
        assessed: its default for an assessment, where that differs from the default of a single episode.
        unset: what None, or an empty text, means.
        marks: PLANNING: it matters only where an adversary plans; GRAPH: it has no effect on episodes that run in
            process; EXTERNAL: it is about a controller that is a node of the user's; RARE: the help leaves it out.
        name: filled in from the field.
    """

    text: str
    kind: type[Any] = str
    default: Any = None
    low: float | None = None
    high: float | None = None
    choices: Names | None = None
    metavar: str | None = None
    group: str = "campaign"
    commands: tuple[str, ...] = COMMANDS
    launches: tuple[str, ...] = LAUNCHES
    assessed: Any = None
    unset: str = ""
    marks: tuple[str, ...] = ()
    name: str = ""

    @property
    def flag(self) -> str:
        """Its name on the command line."""
        return f"--{self.name.replace('_', '-')}"

    @property
    def plain_kind(self) -> type[Any]:
        """Type of its value as plain data: bool, int, float, str or tuple."""
        return next(kind for kind in (bool, int, float, tuple, str) if issubclass(self.kind, kind))

    @property
    def unsaid(self) -> Any:
        """Its value on the command line where it is not given."""
        return self.default if self.assessed is None else self.assessed

    @property
    def absent(self) -> Any:
        """What messages and parameters, which have no None, say for it: 0 or an empty text; None: nothing."""
        return self.plain_kind() if self.default is None and self.kind is not tuple else None

    @property
    def plain_default(self) -> Any:
        """What a parameter or a launch argument is by default, as plain data."""
        return self.plain(self.default) if self.assessed is None else self.assessed

    @property
    def texts(self) -> tuple[str, ...]:
        """The texts that a parameter or a launch argument may have, if there are only a few; else empty."""
        if self.choices is None:
            return ()
        return (*self.choices, *(() if self.absent is None else (self.absent,)))

    def plain(self, value: Any) -> Any:
        """Return a value as plain data, for messages, parameters and results."""
        return self.absent if value is None else self.plain_kind(value)

    def value(self, plain: Any) -> Any:
        """Return the value that plain data stand for, the inverse of `plain`; None: the default."""
        if plain is None or (self.absent is not None and plain == self.absent):
            return self.default
        return self.kind(plain)


def option(
    default: Any,
    text: str,
    kind: type[Any] | None = None,
    within: tuple[float | None, float | None] = (None, None),
    **more: Any,
) -> Any:
    """Return a field of a dataclass that is an option.

    Args:
        default: its value where no other is given.
        text: what it means, with its unit.
        kind: type of its value; by default that of the default.
        within: least and greatest number allowed.
        more: further attributes of `Option`; a whole number is called N on the command line.
    """
    kind = kind or type(default)
    name = {"metavar": "N"} if kind is int else {}
    return field(default=default, metadata={"option": Option(text, kind, default, *within, **{**name, **more})})


@functools.cache
def options_of(table: Callable[..., Any]) -> tuple[Option, ...]:
    """Return the options of a dataclass, in the order of its fields."""
    return tuple(
        dataclasses.replace(one.metadata["option"], name=one.name)
        for one in dataclasses.fields(cast(type[Any], table))
        if "option" in one.metadata
    )


_car_option = partial(option, group="car and test")
_OF_CAR: Final = ("assess", "episode", "probe", "protocol", "log", "drive")


@dataclass(frozen=True, eq=False, kw_only=True)
class EpisodeOptions:
    """The table of an episode's options, which are also those of a campaign; each is described where it stands."""

    controller: str = _car_option(
        DEFAULT,
        "the car under test. SKD has basic (the paper's simple car), cal, carla and metadrive_expert. Published "
        "drivers are cc_driver, reg157, rss, fsm, aeb_berkeley, aeb_honda, aeb_mazda, idm, eidm, krauss, f1tenth, "
        "nav2_monitor, rl and rl_overtrained. Your own is "
        "file.py:Class, package.module:Class, a registered name, or external (a ROS node)",
        ControllerName,
        metavar="NAME",
        commands=_OF_CAR,
    )
    multiplier: float = _car_option(
        1.0,
        "C of the basic car: it brakes for an adversary ahead within C times its stopping distance",
        within=(0.0, 100.0),
        metavar="C",
        commands=_OF_CAR,
    )
    name: str = _car_option(
        "",
        "what your car is called in tables, lists and reports",
        metavar="NAME",
        commands=("assess", "episode"),
        unset="as --controller or the command of its node says",
    )
    simulator: str = _car_option(
        WORLD,
        "what moves car and adversary: world (SKD's own), metadrive (needs the extra metadrive), or a registered "
        "simulator",
        choices=Names((), SIMULATORS),
        commands=("assess", "episode", "probe"),
    )
    car_model: str = _car_option(
        "",
        "the model of the car with which the adversary plans: car_model.yaml of skd fit, or its folder",
        metavar="FILE",
        unset="none",
    )
    adversary_model: AdversaryModel | None = _car_option(
        None,
        "what the adversary knows of the car: generic (a basic one), learned (test drives or --car-model), exact (C)",
        AdversaryModel,
        choices=Names(tuple(map(str, AdversaryModel))),
        metavar="{" + ",".join(AdversaryModel) + "}",
        commands=("assess", "episode"),
        unset="exact if basic, else generic",
        marks=(PLANNING,),
    )
    simulations: int = option(
        DEFAULT_SIMULATIONS,
        "how many futures the planner simulates before each decision of a kamikaze",
        within=(1, 100_000),
        commands=COMMANDS,
        marks=(PLANNING,),
    )
    objective: Objective = option(
        Objective.PAPER,
        "what kamikazes are rewarded for: deviation (a small one), paper (an early collision), frechet (a small "
        "Fréchet distance), or both: deviation, then paper",
        choices=Names((BOTH,), OBJECTIVES),
        assessed=BOTH,
    )
    particles: int | None = option(
        None,
        "how many particles (guesses of the car's state) the adversary's belief has",
        int,
        within=(0, 1_000_000),
        unset="the number for which the objective was tuned",
        commands=("episode",),
        marks=(PLANNING, RARE),
    )
    steers: bool = option(
        False,
        "whether the car leaves the middle of its lane, so that kamikazes go on as far as the road's edge",
        commands=(),
        launches=(),
        marks=(PLANNING, RARE),
    )
    maximum_distance: float | None = option(
        None,
        "leave out each kamikaze that ends further than this many metres from its safe trajectory, and count them",
        float,
        within=(0.0, 1e6),
        metavar="M",
        launches=("assessment",),
        unset="none is left out",
        marks=(RARE,),
    )

    @property
    def car(self) -> CarUnderTest:
        """The car under test."""
        return CarUnderTest(self.controller, self.multiplier, self.name)

    @property
    def resolved_adversary_model(self) -> AdversaryModel:
        """What the adversary plans with: `adversary_model`, or what is implied where that is None."""
        return self.adversary_model or default_adversary_model(self.car, self.car_model)


def values_of(table: Callable[..., Any], plain: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a table by name, from plain data; other names are ignored, and missing ones left out.

    Args:
        table: the dataclass whose fields are the options.
        plain: values by name, as the command line or a node's parameters have them.
    """
    return {one.name: one.value(plain[one.name]) for one in options_of(table) if one.name in plain}


def read_options(
    data: Any, where: str, *tables: Callable[..., Any], path: str = "", listed: bool = False
) -> dict[str, Any]:
    """Return the options in plain data from outside, by name; None is one that is not given.

    Args:
        data: mapping from names of options to plain values.
        where: file or other origin, for messages.
        tables: dataclasses whose fields are the options that there are.
        path: name of the section that the data are, for messages.
        listed: whether there is a list of values of each.

    Raises:
        UsageError: there is no such option, or a value is of another type, out of range, or none of the choices.
    """
    from skd_sim.inputs.model import read_model  # every command begins with this module, and pydantic takes 30 ms

    found: dict[str, Any] = read_model(_model_of(tables, listed), data, where, path).model_dump(exclude_unset=True)
    return found


@functools.cache
def _model_of(tables: tuple[Callable[..., Any], ...], listed: bool) -> Any:
    """Return the model of the plain data of options, or of lists of them."""
    from pydantic import ConfigDict, create_model

    from skd_sim.inputs.model import plain_type

    known = {one.name: one for table in tables for one in options_of(table)}
    several: Any = list
    fields: dict[str, Any] = {}
    for name, one in known.items():
        kind = plain_type(one.plain_kind, one.low, one.high, one.choices)
        fields[name] = (several[kind] if listed else kind | None, None)
    return create_model("Options", __config__=ConfigDict(extra="forbid"), **fields)


def shared_options(source: EpisodeOptions) -> dict[str, Any]:
    """Return the options of an episode or a campaign by name, for the making of another."""
    return {one.name: getattr(source, one.name) for one in options_of(EpisodeOptions)}


def further_options(source: EpisodeOptions) -> dict[str, Any]:
    """Return, as plain data, the options that messages and results have no field for and that are not as by default."""
    known = {one.name: (one, getattr(source, one.name)) for one in options_of(EpisodeOptions) if one.name not in FIELDS}
    if source.adversary_model == default_adversary_model(source.car, source.car_model):
        del known["adversary_model"]
    return {name: one.plain(value) for name, (one, value) in known.items() if value != one.default}


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
    found = read_options(parse_json(text, where), where, EpisodeOptions)
    if strange := set(found) & FIELDS:
        raise UsageError(f"{where}: {min(strange)} has a field of its own")
    return values_of(EpisodeOptions, found)


MAP_FRAME = "map"
"""The world frame: ENU (REP 103), with the crossing point as its origin."""
ADVERSARY_FRAME = "adversary"
"""The adversary's own frame; no transform leads to it, for the car must not know it."""


class Frames(NamedTuple):
    """Frames of the car under test.

    Attributes:
        odom: frame of the odometry. It coincides with `map`, since the odometry is exact and does not drift.
        base: frame of the car's body, at its reference point, on the ground, x ahead.
        laser: frame of the laser scanner.
    """

    odom: str = "odom"
    base: str = "base_link"
    laser: str = "laser"


FRAMES = Frames()
"""What most stacks call them."""


graph_option = partial(option, group="node graph", commands=GRAPH_COMMANDS, marks=(GRAPH, RARE))
_RATED = tuple(name for name in GRAPH_COMMANDS if name != "drive")
"""Commands of what is rated; what one only watches goes by the wall clock."""
_command_option = partial(graph_option, marks=(GRAPH, EXTERNAL, RARE))

LOCKSTEP = "lockstep"
REAL_TIME = "real_time"


@dataclass(frozen=True, kw_only=True)
class CommandOptions:
    """The table of what a car under test publishes, which its subscribers need. See `skd_sim.ros.commands`."""

    command_type: str = _command_option(
        "accel_stamped",
        "message type of the controller's commands: accel_stamped (m/s²), twist_stamped, twist, ackermann (m/s), "
        "or any name such as my_msgs/msg/Command",
        metavar="TYPE",
    )
    command_field: str = _command_option(
        "",
        "which number of a message type of your own is the command, such as longitudinal.acceleration or axes[1]",
        metavar="FIELD",
        unset="none",
    )
    command_steering: str = _command_option(
        "",
        "which number of a message type of your own is the steering angle (rad), such as lateral.steering_tire_angle",
        metavar="FIELD",
        unset="none",
    )
    command_quantity: str = _command_option(
        "acceleration",
        "what the command in a message type of your own is: an acceleration (m/s²), or a speed to reach (m/s)",
        choices=Names(("acceleration", "speed")),
    )
    command_topic: str = _command_option(
        "ego/acceleration_command", "topic on which the controller publishes its commands", metavar="TOPIC"
    )


@dataclass(frozen=True, kw_only=True)
class StateOptions:
    """The table of how a simulator's node says what it sees."""

    scan_rate: float = graph_option(
        0.0,
        "laser scans and point clouds per simulated second, as near as the control periods allow. With 0 they "
        "come with every state",
        within=(0.0, 1000.0),
        metavar="HZ",
    )
    odom_frame: str = graph_option(FRAMES.odom, "name of the coordinate frame of the car's odometry", metavar="FRAME")
    base_frame: str = graph_option(FRAMES.base, "name of the coordinate frame of the car", metavar="FRAME")
    laser_frame: str = graph_option(FRAMES.laser, "name of the coordinate frame of the car's laser", metavar="FRAME")
    own_localisation: bool = graph_option(
        False, "the controller itself publishes the transform map → odom, so that the simulator must not"
    )


@dataclass(frozen=True, kw_only=True)
class SimulatorOptions(CommandOptions, StateOptions):
    """The table of what every simulator's node is told."""

    pacing: str = graph_option(
        LOCKSTEP,
        "when the simulator advances: lockstep (when all commands have arrived), or real_time (by the wall clock)",
        choices=Names((LOCKSTEP, REAL_TIME)),
        commands=_RATED,
        marks=(GRAPH,),
    )
    rate_factor: float = graph_option(
        1.0,
        "with real_time: how many simulated seconds pass in a second of the wall clock",
        within=(0.01, 100.0),
        metavar="F",
    )
    slip_limit: float = graph_option(
        0.05,
        "with real_time: how late a control period may begin, s of the wall clock. A later one aborts the episode",
        within=(0.001, 3600.0),
        metavar="S",
        commands=_RATED,
    )
    quiet_time: float | None = graph_option(
        None,
        "with lockstep: go on this many seconds of the wall clock after a state that is not answered. The last "
        "command holds",
        float,
        within=(0.0, 10.0),
        metavar="S",
        unset="the simulator waits until each state is answered",
        marks=(GRAPH, EXTERNAL, RARE),
    )
    command_timeout: float = graph_option(
        5.0,
        "an episode is aborted after this many seconds of the wall clock without a command",
        within=(0.05, 3600.0),
        metavar="S",
    )
    startup_timeout: float = graph_option(
        60.0,
        "seconds of the wall clock until the first command of an episode. Without --graph: how long a call of "
        "your controller may take",
        within=(0.05, 3600.0),
        metavar="S",
        marks=(RARE,),
    )
    maximum_acceleration: float = graph_option(
        3.0,
        "greatest acceleration with which the car follows a speed that is commanded, m/s²",
        within=(0.1, 20.0),
        metavar="A",
    )
    maximum_deceleration: float = graph_option(
        8.0,
        "greatest deceleration with which the car follows a speed that is commanded, m/s²",
        within=(0.1, 20.0),
        metavar="A",
    )
    initial_pose: bool = graph_option(
        False,
        "publish the car's start pose on /initialpose (geometry_msgs/PoseWithCovarianceStamped, frame map) "
        "before each episode",
        commands=(),
        marks=(RARE,),
    )
