"""The car under test, its dynamics, its simulator and its adversary by name, with what is known of each.

Imports none of them: every command begins with it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Final, cast

from skd_sim.errors import UsageError
from skd_sim.inputs.files import from_here
from skd_sim.options.registry import Registry

DEFAULT = "basic"
EXTERNAL = "external"


@dataclass(frozen=True)
class ControllerKind:
    """What is known of a controller before it is made.

    Attributes:
        target: `package.module:Class` that makes it; empty: it is a node that is not SKD's.
        multiplier: whether it is made with a multiplier C.
        known: whether its answer to any action of the adversary follows from C and the episode's draws.
        own: whether it is SKD's own, and need not be kept in a process of its own.
        control_period: time between two decisions (s) that it declares; none: the scenario's.
        simulator: the simulator within which alone it decides, in the simulator's own process; empty: any.
    """

    target: str
    multiplier: bool = False
    known: bool = False
    own: bool = False
    control_period: float | None = None
    simulator: str = ""


_OWN = {
    DEFAULT: ControllerKind("skd_sim.controllers.basic:BasicController", multiplier=True, known=True, own=True),
    "cal": ControllerKind("skd_sim.controllers.cal:CalController", own=True, control_period=0.05),
    "carla": ControllerKind("skd_sim.controllers.cal:CarlaAgent", own=True),
    "metadrive_expert": ControllerKind(
        "skd_sim.simulators.metadrive.simulator:MetaDriveExpert", own=True, control_period=0.1, simulator="metadrive"
    ),
}
_REFERENCE = {
    "cc_driver": "reference_drivers:CarefulDriver",
    "reg157": "reference_drivers:Reg157",
    "rss": "reference_drivers:RssDriver",
    "fsm": "reference_drivers:FuzzyDriver",
    "aeb_berkeley": "reference_drivers:BerkeleyBrake",
    "aeb_honda": "reference_drivers:HondaBrake",
    "aeb_mazda": "reference_drivers:MazdaBrake",
    "idm": "reference_drivers:IdmDriver",
}
REFERENCE_DRIVERS = tuple(_REFERENCE)
"""Published driver models that a car is compared with."""
_FURTHER = {
    "eidm": "reference_drivers:EnhancedIdmDriver",
    "krauss": "reference_drivers:KraussDriver",
    "f1tenth": "reference_drivers:TimeToCollisionBrake",
    "nav2_monitor": "reference_drivers:CollisionMonitor",
    "rl": "reference_drivers:LearnedPolicy",
    "rl_overtrained": "reference_drivers:OvertrainedPolicy",
}
_OWN |= {
    name: ControllerKind(f"skd_sim.controllers.{target}", own=True, control_period=0.1)
    for name, target in (_REFERENCE | _FURTHER).items()
}
CONTROLLERS = Registry("controller", "skd.controllers", {name: kind.target for name, kind in _OWN.items()})
_EXTERNAL = ControllerKind("")
_CLASS = re.compile(r"[\w.]+:[\w.]+|.+\.py:[\w.]+")


class ControllerName(str):
    """Name of a controller; a file in it is an absolute path, so that it means the same in every process."""

    __slots__ = ()

    def __new__(cls, text: str) -> ControllerName:
        """Make it of what a user has written: a name, `package.module:Class` or `path/to/file.py:Class`."""
        file, colon, name = str(text).rpartition(":")
        if not file.endswith(".py"):
            return super().__new__(cls, text)
        try:
            path = Path(file).expanduser().absolute()
        except RuntimeError:  # there is no home folder
            path = Path(file)
        return super().__new__(cls, f"{path}{colon}{name}")

    @property
    def short(self) -> str:
        """The name without the folders of a file."""
        file, colon, name = self.rpartition(":")
        return f"{Path(file).name}{colon}{name}" if file.endswith(".py") else str(self)


@dataclass(frozen=True)
class CarUnderTest:
    """A car under test: who drives it.

    Attributes:
        controller: a name of `CONTROLLERS`, `package.module:Class` or `file.py:Class` of a user's, or `external` (a
            node of a user's).
        multiplier: C, where it has one.
        name: what the user calls it; empty: nothing else.
    """

    controller: str = DEFAULT
    multiplier: float = 1.0
    name: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "controller", ControllerName(self.controller))

    @property
    def kind(self) -> ControllerKind:
        """What is known of its controller; whatever is not SKD's own is taken for a user's class."""
        if self.is_external:
            return _EXTERNAL
        return _OWN.get(self.controller) or ControllerKind(self.controller)

    @property
    def exists(self) -> bool:
        """Whether the name of its controller is well formed; it may still fail to load."""
        return self.is_external or self.controller in CONTROLLERS or bool(_CLASS.fullmatch(self.controller))

    @property
    def is_external(self) -> bool:
        """Whether it is driven by a process that is not SKD's."""
        return self.controller == EXTERNAL

    @property
    def is_own(self) -> bool:
        """Whether its controller comes with SKD; the code of any other may do what it likes."""
        return self.kind.own

    @property
    def user_code(self) -> str:
        """The user's code that drives it, as messages name it, which is run in a child process; empty: it is SKD's."""
        return "" if self.is_own or self.is_external else f"controller {from_here(self.controller)}"

    @property
    def has_multiplier(self) -> bool:
        """Whether the car has a multiplier C."""
        return self.kind.multiplier

    @property
    def stated_multiplier(self) -> float | None:
        """C, as results state it; None for a car that has none."""
        return self.multiplier if self.has_multiplier else None

    @property
    def is_known(self) -> bool:
        """Whether it is known how the car decides, and so how it would have answered other actions."""
        return self.kind.known

    @property
    def label(self) -> str:
        """Its name in headings; different cars have different names."""
        if self.name:
            return self.name
        return f"{self.controller}, C = {self.multiplier:g}" if self.has_multiplier else self.short_controller

    @property
    def file_name(self) -> str:
        """Its name in names of files and campaigns."""
        if self.name:
            return self.name
        return f"{self.controller}-C{self.multiplier:g}" if self.has_multiplier else self.short_controller

    @property
    def short_controller(self) -> str:
        """Its controller as messages name it, without the folders of a file."""
        return ControllerName(self.controller).short


@dataclass(frozen=True)
class DynamicsKind:
    """What is known of a car's dynamics before they are made.

    Attributes:
        target: `package.module:function` that makes them for a scenario.
        tyres: whether the car has tyres of its own, on which the road's friction acts and which limit every brake.
        known: whether their answer to a command follows from what is recorded and the episode's draws.
        steers: whether the car can follow a road with curves.
        scenario: a shipped scenario that has them.
    """

    target: str
    tyres: bool
    known: bool
    steers: bool
    scenario: str


BASIC = "basic"
DYNAMICS = {
    BASIC: DynamicsKind(
        "skd_sim.world.dynamics.basic:BasicCar", tyres=False, known=True, steers=True, scenario="crossing"
    ),
    "multi_body": DynamicsKind(
        "skd_sim.world.dynamics.multi_body:MultiBodyCar",
        tyres=True,
        known=False,
        steers=False,
        scenario="crossing_multi_body",
    ),
}


WORLD: Final = "world"
SIMULATORS: Final = Registry(
    "simulator",
    "skd.simulators",
    {
        WORLD: "skd_sim.simulators.simulator:WorldSimulator",
        "metadrive": "skd_sim.simulators.metadrive.simulator:MetaDriveSimulator",
    },
)
"""Classes of `skd_sim.simulators.simulator.Simulator`, made without arguments."""


def is_own_world(name: str) -> bool:
    """Return whether a simulator is SKD's own, for which it is known what other commands would have led to."""
    return name == WORLD


# --- what the adversary knows of the car, and what its plan is rewarded for


class AdversaryModel(StrEnum):
    """What a kamikaze knows of the car."""

    GENERIC = "generic"  # the car is taken for a basic one, with any C
    LEARNED = "learned"  # a model that was fitted to logs of the car
    EXACT = "exact"  # the law by which the car brakes, and C


def default_adversary_model(car: CarUnderTest, car_model: str) -> AdversaryModel:
    """Return the adversary model by default: learned with a car model, exact where C is known, else generic.

    Args:
        car: the car under test.
        car_model: text or path of the model that is given; empty: none.
    """
    if car_model:
        return AdversaryModel.LEARNED
    return AdversaryModel.EXACT if car.is_known else AdversaryModel.GENERIC


def check_adversary_model(adversary_model: AdversaryModel, car: CarUnderTest, *, model: bool) -> None:
    """Refuse an adversary model that this car does not allow.

    Args:
        adversary_model: what the adversary knows of the car.
        car: the car under test.
        model: whether a car model is given.

    Raises:
        UsageError: C of a car that has none, or a car model that would not be used.
    """
    if model and adversary_model != AdversaryModel.LEARNED:
        raise UsageError(
            f"a car model goes with adversary model {AdversaryModel.LEARNED}: leave out the car model, "
            f"or {adversary_model}"
        )
    if adversary_model == AdversaryModel.EXACT and not car.is_known:
        raise UsageError(
            f"adversary model {AdversaryModel.EXACT}: how car {car.controller} decides is not known to the adversary; "
            f"{AdversaryModel.LEARNED} finds out, {AdversaryModel.GENERIC} does without"
        )


DEFAULT_SIMULATIONS: Final = 1000
"""Simulations per decision: where more come no nearer to the clairvoyant kamikaze (docs/metrics.md)."""


class Objective(StrEnum):
    """What a kamikaze's plan is rewarded for: a member is one of SKD's own; others are registered, by their name."""

    PAPER = "paper"  # to collide as fast as possible, less each step's distance to φ
    DEVIATION = "deviation"  # to collide, less the greatest distance from where φ is at the same time
    FRECHET = "frechet"  # to collide, less the discrete Fréchet distance of the whole of ψ to φ

    def __reduce_ex__(self, protocol: object) -> tuple[type[Objective], tuple[str]]:
        """Pickle by value: a member that a package has registered is made anew where it is read."""
        return Objective, (str(self),)

    @classmethod
    def _missing_(cls, value: object) -> Objective:
        """Return the objective that an installed package has registered under a name.

        Raises:
            UsageError: none has.
        """
        OBJECTIVES.target(str(value))
        found = str.__new__(cls, value)
        found._name_, found._value_ = str(value), str(value)
        return cast(Objective, cls._value2member_map_.setdefault(value, found))


OBJECTIVES: Final = Registry(
    "objective",
    "skd.objectives",
    {
        "paper": "skd_adversary.crossing.objectives:PAPER",
        "deviation": "skd_adversary.crossing.kamikaze:DEVIATION",
        "frechet": "skd_adversary.crossing.objectives:FRECHET",
    },
)
"""Where the model of each is made: above this package, which knows of it by name only."""


DEFAULT_OBJECTIVES: Final = (Objective.DEVIATION, Objective.PAPER)
"""Of an assessment, in this order: the one that ranks cars, and the paper's own."""
RANKING_OBJECTIVES: Final = (Objective.DEVIATION, Objective.FRECHET, Objective.PAPER)
SKD_OBJECTIVES: Final = (Objective.PAPER, Objective.FRECHET, Objective.DEVIATION)
"""Whose kamikazes the deviation and the SKD that are reported first are of: the first of these that ran."""
BOTH: Final = "both"
"""What the default objectives are called where one is chosen by name."""


def first_of(preferred: Sequence[Objective], ran: Iterable[Objective]) -> Objective:
    """Return the first of the preferred objectives that ran, else the first one that ran."""
    names = list(ran)
    return next((one for one in preferred if one in names), names[0])


def objectives_named(name: str) -> tuple[Objective, ...]:
    """Return the objectives that a name asks for: the default ones, or the one of that name."""
    return DEFAULT_OBJECTIVES if name == BOTH else (Objective(name),)
