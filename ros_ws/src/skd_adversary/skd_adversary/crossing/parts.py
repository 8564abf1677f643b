"""What a model is put together of: the kinds of part, templates, and the interfaces by which parts call each other.

A template is a kernel that calls other parts by name. It says which names it uses; `bound` compiles it with what stands
for them. Nothing that is not said is bound: a forgotten name stays a placeholder, with which no kernel compiles.

States are vectors as in `model`, velocities (East, North) in m/s, `parameters` those of the composed model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Generic, NamedTuple, ParamSpec, Protocol, TypeVar, cast

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel, specialise
from skd_sim.scenario.scenario import Scenario

from skd_adversary.crossing.path import path_velocities
from skd_adversary.pomdp.search import Backup, Cells, PlannerOptions

_UNBOUND = "bound by the composer"
_NO_NUMBER = cast(int, None)  # with which no kernel compiles

USER_ROW: Final = _NO_NUMBER
"""Where the road user's own part of a state begins."""
ROW: Final = _NO_NUMBER
"""Where the objective's own part of a state begins."""
USER_DIM: Final = _NO_NUMBER
"""Length of the road user's own part of a state; 0: what it did before does not matter to what it can do."""
REST: Final = _NO_NUMBER
"""The action with which the road user stays where it is, or comes nearest to that."""
LATE_ACTIONS: Final = cast(tuple[int, ...], None)
"""Actions of the road user by one of which it meets a car that comes after φ has left its path."""
EARLY_ACTIONS: Final = cast(tuple[int, ...], None)
"""Actions by one of which it meets a car that has passed before φ gets there."""
AS_PHI: Final = _NO_NUMBER
"""The action *as φ*, one beyond the road user's own: φ's displacement in the present tick, none after its end, or what
of the `possible` comes nearest to that."""


# --- the road user's


def velocity(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Return the velocity under an action of the road user."""
    raise NotImplementedError(_UNBOUND)


def start_road_user(parameters: Any, state: FloatArray) -> None:
    """Write the adversary's own part of a first state."""
    raise NotImplementedError(_UNBOUND)


def settle(parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray) -> None:
    """Write the adversary's own part of the next state, after a step with a velocity."""
    raise NotImplementedError(_UNBOUND)


def possible(parameters: Any, state: FloatArray, vx: float, vy: float) -> tuple[float, float]:
    """Return what comes nearest to a wanted velocity of all that the road user can do from its state."""
    raise NotImplementedError(_UNBOUND)


def moving(parameters: Any, state: FloatArray) -> tuple[float, float]:
    """Return the velocity with which the road user came into a state; none of one that does as it likes at once."""
    raise NotImplementedError(_UNBOUND)


def next_velocity(parameters: Any, vx: float, vy: float, action: int) -> tuple[float, float]:
    """Return the velocity under an action of the road user in a tick before which it moved at (vx, vy), m/s."""
    raise NotImplementedError(_UNBOUND)


def next_possible(parameters: Any, vx: float, vy: float, wanted_x: float, wanted_y: float) -> tuple[float, float]:
    """Return what comes nearest to a wanted velocity of all that the road user can do after one of (vx, vy), m/s."""
    raise NotImplementedError(_UNBOUND)


def pointing(parameters: Any, state: FloatArray, vx: float, vy: float) -> float:
    """Return where the road user's body points (rad) while it moves with a velocity."""
    raise NotImplementedError(_UNBOUND)


def steer(parameters: Any, state: FloatArray, way: int) -> int:
    """Return the adversary's action that comes nearest to one of a pedestrian's; *as φ* is as φ for every kind.

    Default policies think in those: North, South, East, North-East, South-East, stay.
    """
    raise NotImplementedError(_UNBOUND)


def touch(parameters: Any, ahead: float, left: float, ahead_after: float, left_after: float, turned: float) -> float:
    """Return the share of a step at which the road user's body first touches the car's footprint, else infinity.

    Args:
        parameters: parameters of the model.
        ahead: how far the adversary's centre is ahead of the car's reference point when the step begins, m.
        left: how far its centre is to the left of that point then, m.
        ahead_after: how far its centre is ahead when the step ends, m.
        left_after: how far its centre is to the left when the step ends, m.
        turned: heading of its body relative to the car's, rad.
    """
    raise NotImplementedError(_UNBOUND)


# --- the road's


def on_road(parameters: Any, x: float, y: float) -> tuple[float, float]:
    """Return how far to the right of the road's centre line, and where along it, a point (x, y) is; m.

    In these coordinates every road is straight and leads North.
    """
    raise NotImplementedError(_UNBOUND)


def velocity_on_road(parameters: Any, x: float, y: float, vx: float, vy: float) -> tuple[float, float]:
    """Return the components of a velocity to the right of the road and along it, beside a point (x, y)."""
    raise NotImplementedError(_UNBOUND)


def from_car(parameters: Any, x: float, y: float, car_s: float) -> tuple[float, float]:
    """Return how far ahead and to the left of the car's reference point, at path coordinate s (m), a point is; m."""
    raise NotImplementedError(_UNBOUND)


def left_behind(parameters: Any, x: float, y: float, car_s: float) -> bool:
    """Return whether a point (x, y), m, is behind the car at path coordinate s (m), which will not turn back to it.

    The path coordinate alone does not say so: before a curve, who is beside the road on its inner side may be far
    behind the car, and be there before it by the short cut.
    """
    raise NotImplementedError(_UNBOUND)


def at_distance(parameters: Any, x: float, y: float, distance: float, behind: bool) -> float:
    """Return the path coordinate (m) at a distance (m) from a point (x, y), before it on the road or beyond it."""
    raise NotImplementedError(_UNBOUND)


def contact(
    parameters: Any,
    x: float,
    y: float,
    x_after: float,
    y_after: float,
    heading: float,
    car_s: float,
    car_s_after: float,
) -> float:
    """Return the share of a step at which road user and car first touch, else infinity; both move uniformly.

    Args:
        parameters: parameters of the model.
        x: place of the adversary to the East when the step begins, m.
        y: place of the adversary to the North when the step begins, m.
        x_after: place to the East when the step ends, m.
        y_after: place to the North when the step ends, m.
        heading: heading of its body, rad.
        car_s: path coordinate of the car's reference point when the step begins, m.
        car_s_after: path coordinate of the car's reference point when the step ends, m.
    """
    raise NotImplementedError(_UNBOUND)


# --- the predicted car's


def start_car(parameters: Any, state: FloatArray, rng: np.random.Generator) -> None:
    """Draw place, speed and policy of the car into a state of the initial belief."""
    raise NotImplementedError(_UNBOUND)


def advance_car(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> None:
    """Write all of the car's part of the next state, while the adversary moves with a velocity."""
    raise NotImplementedError(_UNBOUND)


def expected_acceleration(
    parameters: Any,
    state: FloatArray,
    x: float,
    y: float,
    vx_before: float,
    vy_before: float,
    vx: float,
    vy: float,
    car_s: float,
    speed: float,
    change: float,
    change_before: float,
) -> float:
    """Return what the car of a state will do (m/s²), its noise left aside, once it and the road user have moved.

    Args:
        parameters: parameters of the model.
        state: state whose policy of the car is asked.
        x: place of the adversary to the East, m.
        y: place of the adversary to the North, m.
        vx_before: velocity of the adversary to the East in the tick before, m/s.
        vy_before: velocity of the adversary to the North in the tick before, m/s.
        vx: velocity of the adversary to the East in the tick itself, m/s.
        vy: velocity of the adversary to the North in the tick itself, m/s.
        car_s: path coordinate of the car's reference point, m.
        speed: speed of the car, m/s.
        change: change of that speed in the last tick, m/s.
        change_before: change of that speed in the tick before the last, m/s.
    """
    raise NotImplementedError(_UNBOUND)


def last_changes(parameters: Any, state: FloatArray) -> tuple[float, float]:
    """Return by how much the car's speed changed in the last tick, and in the one before, m/s; 0 to who does not care.

    It begins what `expected_acceleration` is told.
    """
    raise NotImplementedError(_UNBOUND)


def resume_car(parameters: Any, state: FloatArray, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Draw the car's speed anew, near that of a state that was believed, before the sensor places the car."""
    raise NotImplementedError(_UNBOUND)


def redraw_policy(parameters: Any, redrawn: FloatArray, rng: np.random.Generator) -> None:
    """Draw the car's policy anew, after the sensor has placed it."""
    raise NotImplementedError(_UNBOUND)


# --- the sensor's


def place_car(
    parameters: Any, state: FloatArray, observation: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Place the car of a redrawn state where an observation says, with the sensor's noise.

    Args:
        parameters: parameters of the model.
        state: state that was believed before.
        observation: observation as the sensor gives it.
        redrawn: state that holds the adversary's own part already; the car's place is written into it.
        rng: generator of the noise.
    """
    raise NotImplementedError(_UNBOUND)


# --- the objective's


def chosen(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Return the velocity under an action: one of the road user's, or *as φ*, if the objective has that."""
    raise NotImplementedError(_UNBOUND)


def sensible(parameters: Any, state: FloatArray, vx: float, vy: float) -> bool:
    """Return whether it makes sense to move with a velocity that the road user can have."""
    raise NotImplementedError(_UNBOUND)


def begin(parameters: Any, state: FloatArray) -> None:
    """Write the objective's own part of a first state."""
    raise NotImplementedError(_UNBOUND)


# --- of all together (`model`)


def move(
    parameters: Any, state: FloatArray, vx: float, vy: float, next_state: FloatArray, rng: np.random.Generator
) -> float:
    """Write adversary and car of the next state; return the share of the step at which they touch, else infinity."""
    raise NotImplementedError(_UNBOUND)


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
        expected_acceleration: interface.
        resume_car: interface.
        redraw_policy: interface.
        last_changes: interface.
    """

    name: str
    own_dim: int
    start_car: Any
    advance_car: Any
    expected_acceleration: Any
    resume_car: Any
    redraw_policy: Any
    last_changes: Any


@dataclass(frozen=True)
class SensorModel:
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
    """How a kind moves, outside kernels; it remembers two numbers of how it moved, which may mean nothing.

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
        motion: the same motion outside kernels.
        fastest: plausible speed, m/s; whatever moves faster in a recording is of another kind, or its unit is wrong.
        height: height of its body in pictures and messages, m.
        called: what another simulator, a format or a data set calls it, by their names: `{"carla":
            "walker.pedestrian.0001", "openscenario": "pedestrian"}`; data sets of levelXdata are `levelxdata`.
    """

    name: str
    kernels: RoadUserKernels
    parameters: Callable[[Scenario], Mapping[str, Any]]
    motion: Motion
    fastest: float
    height: float
    called: Mapping[str, str] = field(default_factory=dict)

    def choices(self, scenario: Scenario, path: FloatArray, moved: FloatArray) -> FloatArray:
        """Return the velocities that it can choose in each tick of a trajectory, having gone it so far.

        Args:
            scenario: says how fast it is, and the time step.
            path: φ, k × 2, m; may be one point.
            moved: the trajectory, n × 2, m.

        Returns:
            (n − 1) × action_count × 2, m/s.
        """
        actions = range(self.kernels.action_count)
        found = [
            [self.motion.velocity(scenario, own, one) for one in actions] for own in self._so_far(scenario, path, moved)
        ]
        return np.array(found).reshape(-1, len(actions), 2)

    def as_phi(self, scenario: Scenario, path: FloatArray, moved: FloatArray) -> FloatArray:
        """Return its velocities as φ, or as near to that as it can, in each tick of a trajectory, (n − 1) × 2, m/s.

        Arguments as of `choices`.
        """
        wanted = path_velocities(path, len(moved) - 1, scenario.time_step).tolist()
        so_far = self._so_far(scenario, path, moved)
        found = [self.motion.nearest(scenario, own, vx, vy) for own, (vx, vy) in zip(so_far, wanted, strict=True)]
        return np.array(found).reshape(-1, 2)

    def _so_far(self, scenario: Scenario, path: FloatArray, moved: FloatArray) -> Iterator[Own]:
        """Yield what it remembers at the begin of each tick of a trajectory."""
        own = self.motion.first(scenario, path)
        for vx, vy in (np.diff(moved, axis=0) / scenario.time_step).tolist():
            yield own
            own = self.motion.after(own, vx, vy)


class CarPrediction(Protocol):
    """How the adversary predicts the car: a kind of car, its parameters, and the sensor that goes with it."""

    @property
    def kernels(self) -> CarKernels:
        """Kernels of how the predicted car moves."""

    @property
    def sensor(self) -> SensorModel:
        """Sensor by which the adversary sees the car."""

    def parameters(self, scenario: Scenario) -> Mapping[str, Any]:
        """Return numbers and arrays for the kernels, by name.

        Among them `waiting_reward`, m of deviation (at most 0) that each step after φ's end costs who waits for it.
        """
