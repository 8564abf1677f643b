"""What a model is put together of, and templates: kernels that call other parts by name.

A template says which names it uses; `bound` compiles it with what stands for them. Nothing that is not said is bound: a
forgotten name stays the placeholder of `interfaces`, with which no kernel compiles.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Generic, NamedTuple, ParamSpec, Protocol, TypeVar

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel, specialise
from skd_sim.scenario.scenario import Scenario

from skd_adversary.pomdp.search import Backup, Cells, PlannerOptions

_P = ParamSpec("_P")
_R = TypeVar("_R")

SEARCH: Final = PlannerOptions(
    simulations=1000,
    depth=25,
    particles=300,
    backup=Backup.BEST,
    cells=Cells.NEAREST,
    keep_tree=True,
)
"""Of the adversary's models. It looks at every step, whatever it does, so nothing can be gained by asking first; and a
hit is a matter of one good action at the right time, which a mean over all that was tried hides. docs/decisions.md."""


class Template(Generic[_P, _R]):
    """A kernel to be, which calls parts of the model, or other templates of its module, by name."""

    def __init__(self, function: Callable[_P, _R], uses: tuple[str, ...], inline: bool) -> None:
        """Keep a function, and the names in it that `bound` replaces by parts; see `template`."""
        self.function = function
        self.uses = uses
        self.inline = inline

    def __call__(self, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Refuse to be called: only a compiled copy can be.

        Raises:
            TypeError: always.
        """
        raise TypeError(f"{self.function.__qualname__} is a template; `bound` makes a kernel of it")


def template(*uses: str, inline: bool = True) -> Callable[[Callable[_P, _R]], Template[_P, _R]]:
    """Make a function a template.

    Args:
        uses: names of `interfaces`, and of other templates of the module, that the function reads.
        inline: whether callers contain its code; see `kernel`.
    """
    return lambda function: Template(function, uses, inline)


def bound(part: Any, name: str, parts: Mapping[str, Any]) -> Any:
    """Compile a template with the parts that it uses; anything else is returned as it is.

    Args:
        part: template, compiled kernel or None.
        name: name of the composition, unique for these `parts`.
        parts: kernel or number of each part, by name.

    Raises:
        TypeError: the template uses what is neither a part nor a template of its module.
    """
    if not isinstance(part, Template):
        return part
    bindings = {}
    for use in part.uses:
        helper = parts[use] if use in parts else part.function.__globals__.get(use)
        if use not in parts and not isinstance(helper, Template):
            raise TypeError(f"{part.function.__module__}.{part.function.__qualname__} uses {use}, which is no part")
        bindings[use] = bound(helper, name, parts)
    return specialise(part.function, name, bindings, inline=part.inline)


@kernel(inline=True)
def _begin_nothing(parameters: Any, state: FloatArray) -> None:
    """Write nothing: the objective has no state of its own."""


@kernel(inline=True)
def _always(parameters: Any, state: FloatArray, vx: float, vy: float) -> bool:
    """Allow any velocity."""
    return True


@dataclass(frozen=True)
class ObjectiveModel:
    """What the adversary wants; see `objectives` for those there are.

    Attributes:
        name: name of the objective; compiled code is called by it.
        discount: discount factor γ of rewards.
        options: options of the planner, except the number of simulations.
        parameters: scenario, φ (n × 2, m) → parameters of its own (numbers and arrays), by name.
        step: (parameters, state, action, next_state_out, rng) → (reward, terminal).
        rollout_action: (parameters, state, rng) → action of the default policy.
        legal: which actions are legal; see `Pomdp`.
        begin: (parameters, state_out): write the objective's own part of a first state, which begins at `ROW`.
        own_dim: number of points of φ → length of the objective's own part of a state.
        chosen: interface; by default that of the road user, for an objective without *as φ*.
        sensible: interface; by default all makes sense.
        follows_phi: whether there is one action more than the road user's, *as φ* (`AS_PHI`).
        plans_deviation: the distance that it plans for, and that a maximum distance limits, is the deviation; else
            the discrete Fréchet distance.
    """

    name: str
    discount: float
    options: PlannerOptions
    parameters: Callable[[Scenario, FloatArray], Mapping[str, Any]]
    step: Any
    rollout_action: Any
    legal: Any = None
    begin: Any = _begin_nothing
    own_dim: Callable[[int], int] = field(default=lambda _points: 0)
    chosen: Any = None
    sensible: Any = _always
    follows_phi: bool = False
    plans_deviation: bool = False


@dataclass(frozen=True)
class CarKernels:
    """How a kind of predicted car moves; the kernels are described where they are used, in `interfaces`.

    Attributes:
        name: name of the kind; compiled code is called by it.
        own_dim: length of the car's own part of a state, which comes right behind its place, speed and trigger.
        start_car: interface.
        advance_car: interface.
        foreseen_acceleration: interface.
        resume_car: interface.
        redraw_policy: interface.
        last_changes: interface.
    """

    name: str
    own_dim: int
    start_car: Any
    advance_car: Any
    foreseen_acceleration: Any
    resume_car: Any
    redraw_policy: Any
    last_changes: Any


@dataclass(frozen=True)
class Sensor:
    """What is seen of the car, and how likely that is.

    Attributes:
        name: name of the sensor; compiled code is called by it.
        parameters: scenario → parameters of the model, by name.
        sense: (scenario, own place (x, y) in m, that of the car (x, y) in m, generator) → observation.
        observe: draws an observation; see `Pomdp`.
        likelihood: likelihood of an observation; see `Pomdp`.
        place_car: interface.
    """

    name: str
    parameters: Callable[[Scenario], Mapping[str, float]]
    sense: Callable[[Scenario, tuple[float, float], tuple[float, float], np.random.Generator], FloatArray]
    observe: Any
    likelihood: Any
    place_car: Any


@dataclass(frozen=True)
class RoadKernels:
    """The road that the car follows.

    Attributes:
        name: name of the kind; compiled code is called by it.
        parameters: scenario → parameters of the model, by name.
        on_road: interface.
        velocity_on_road: interface.
        from_car: interface.
        left_behind: interface.
        at_distance: interface.
        contact: interface, as a template that uses interface `touch`.
    """

    name: str
    parameters: Callable[[Scenario], Mapping[str, Any]]
    on_road: Any
    velocity_on_road: Any
    from_car: Any
    left_behind: Any
    at_distance: Any
    contact: Any


@dataclass(frozen=True)
class RoadUserKernels:
    """How road users of some kinds move, and how their bodies touch; they are described in `interfaces`.

    Attributes:
        name: name by which compiled code is called.
        action_count: actions are 0 … action_count − 1.
        rest: action with which it stays where it is, or comes nearest to that.
        own_dim: length of the road user's own part of a state beyond its place; it begins at `USER_ROW`.
        box: whether its body has to be a box.
        start_road_user: interface.
        velocity: interface.
        settle: interface.
        possible: interface.
        moving: interface.
        next_velocity: interface.
        next_possible: interface.
        pointing: interface.
        steer: interface.
        touch: interface.
        late: `LATE_ACTIONS`.
        early: `EARLY_ACTIONS`.
    """

    name: str
    action_count: int
    rest: int
    own_dim: int
    box: bool
    start_road_user: Any
    velocity: Any
    settle: Any
    possible: Any
    moving: Any
    next_velocity: Any
    next_possible: Any
    pointing: Any
    steer: Any
    touch: Any
    late: tuple[int, ...]
    early: tuple[int, ...]


Own = tuple[float, float]
"""What the kind remembers, in units of its own."""


class Motion(NamedTuple):
    """How a kind moves that remembers two numbers of how it moved, outside kernels.

    Attributes:
        first: (scenario, φ) → what it remembers before its first step.
        after: (remembered, vx, vy) → what it remembers after a step at a velocity, m/s.
        velocity: (scenario, remembered, action) → the velocity of an action, m/s.
        nearest: (scenario, remembered, vx, vy) → the velocity that it can have that comes nearest to a wanted one, m/s.
    """

    first: Callable[[Scenario, FloatArray], Own]
    after: Callable[[Own, float, float], Own]
    velocity: Callable[[Scenario, Own, int], tuple[float, float]]
    nearest: Callable[[Scenario, Own, float, float], tuple[float, float]]


@dataclass(frozen=True)
class RoadUserModel:
    """A kind of road user: how the adversary can move, and all else that is special to it.

    Attributes:
        name: name of the kind, as in the section `adversary` of a scenario.
        kernels: kernels of how it moves; several kinds can share them.
        parameters: scenario → parameters of the model, by name.
        choices: (scenario, φ, way) → velocities that it can choose in each tick of a way (n × 2, m), having gone it so
            far: (n − 1) × action_count × 2, m/s; φ (k × 2, m) may be one point.
        as_phi: (scenario, φ, way) → its velocities as φ, or as near to that as it can, in each tick of a way, having
            gone it so far: (n − 1) × 2, m/s.
        fastest: plausible speed, m/s; whatever moves faster in a recording is of another kind, or its unit is wrong.
        height: height of its body in pictures and messages, m.
        called: what another simulator, a format or a data set calls it, by their names: `{"carla":
            "walker.pedestrian.0001", "openscenario": "pedestrian"}`; data sets of levelXdata are `levelxdata`.
        motion: how it moves, of a kind that remembers how it moved.
    """

    name: str
    kernels: RoadUserKernels
    parameters: Callable[[Scenario], Mapping[str, Any]]
    choices: Callable[[Scenario, FloatArray, FloatArray], FloatArray]
    as_phi: Callable[[Scenario, FloatArray, FloatArray], FloatArray]
    fastest: float
    height: float
    called: Mapping[str, str] = field(default_factory=dict)
    motion: Motion | None = None


class CarPrediction(Protocol):
    """How the adversary predicts the car: a kind of car, its parameters, and the sensor that goes with it."""

    @property
    def kernels(self) -> CarKernels:
        """Kernels of how the predicted car moves."""

    @property
    def sensor(self) -> Sensor:
        """Sensor by which the adversary sees the car."""

    def parameters(self, scenario: Scenario) -> Mapping[str, Any]:
        """Return numbers and arrays for the kernels, by name.

        Among them `waiting_reward`, m of deviation (at most 0) that each step after φ's end costs who waits for it.
        """
