"""What the parts of the adversary's model call each other by: the state, kinds of part, and their interfaces.

State (paper, "Generating Kamikaze Trajectories"): road user × predicted car × parameters of the car's policy, behind
them what a kind of car, a kind of road user and the objective have of their own. The car's place is its path coordinate
s along the road's centre line (`skd_sim.scenario.road`): y on the straight lane.

A part (road, road user, car, sensor, objective) is a set of small functions: a class that only groups them, of which no
object is made. Those that need functions of another part call them by the names below, its interfaces: `move` calls
`advance_car`, whatever the kind of car. Such a function is a `template`. `model.compose` chooses the parts, and
compiles their templates with each other's functions in place of the names. What an interface takes and returns is
written at the base class of its part. Velocities are (East, North) in m/s, places in m; `parameters` are those of the
composed model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, cast

import numpy as np
from skd_sim.kernels.compilation import Template, bound, kernel, unbound
from skd_sim.kernels.compilation import template as template
from skd_sim.scenario.ending import inside
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import runs_into
from skd_sim.world.state import CarState, FloatArray, Pair, Triple

from skd_adversary.pomdp.planner import Backup, Cells, PlannerOptions

# State vector; the trigger is the distance within which the car brakes, m (s for some learned cars)
ADVERSARY_X, ADVERSARY_Y, CAR_S, CAR_SPEED, TRIGGER = range(5)
STATE_DIM = 5
OFFSET, TURNED = range(STATE_DIM, STATE_DIM + 2)
"""Of a car that evades: how far it is to the right of the middle of its lane, m, and turned to the right of it, rad."""

_acts: Callable[..., None] = unbound
_gives_number: Callable[..., float] = unbound
_gives_pair: Callable[..., Pair] = unbound
_gives_triple: Callable[..., Triple] = unbound
_gives_truth: Callable[..., bool] = unbound

# Interfaces of the road user: see `RoadUserKernels`
start_road_user = settle = _acts
velocity = possible = moving = next_velocity = next_possible = _gives_pair
pointing = touch = _gives_number
steer: Callable[..., int] = unbound
# of the predicted car and of the sensor: see `CarKernels`, `SensorModel`
start_car = advance_car = resume_car = redraw_policy = place_car = _acts
last_changes = expected_motion = _gives_triple
# of the road: see `RoadKernels`
on_road = velocity_on_road = from_car = to_middle = aside = _gives_pair
at_distance = contact = _gives_number
left_behind = _gives_truth
# of the objective: see `ObjectiveModel`
begin = _acts

move = _gives_number
"""Of all parts together (`model`): (parameters, state, vx, vy, next_state_out, rng) → share of the step at which
adversary and car touch, else infinity; it writes both into the next state."""

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

SEARCH: Final = PlannerOptions(
    simulations=1000, depth=25, particles=300, backup=Backup.BEST, cells=Cells.NEAREST, keep_tree=True
)
"""Of the adversary's models. It looks at every step, whatever it does, so nothing can be gained by asking first; and a
hit is a matter of one good action at the right time, which a mean over all actions hides: docs/decisions.md (1)."""


def kernels_of(part: type, name: str, parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return all kernels of a part, by interface, its templates compiled with `parts`; see `bound`."""
    found = {interface: getattr(part, interface) for interface in dir(part)}
    return {
        interface: bound(one, name, parts)
        for interface, one in found.items()
        if isinstance(one, Template) or hasattr(one, "py_func")
    }


within = kernel(inline=True)(inside)
"""As `skd_sim.scenario.ending.inside`, for kernels."""


@kernel(inline=True)
def path_velocity(path: FloatArray, tick: int, time_step: float) -> Pair:
    """Return φ's own velocity (East, North), m/s, from a tick to the next: that of the action *as φ* of who can.

    Args:
        path: φ, n × 2, m.
        tick: ≥ 0; from n − 1 on φ stands still.
        time_step: s.
    """
    if tick + 1 >= path.shape[0]:
        return 0.0, 0.0
    return (path[tick + 1, 0] - path[tick, 0]) / time_step, (path[tick + 1, 1] - path[tick, 1]) / time_step


@kernel(inline=True)
def pace_at(pace: FloatArray, tick: int) -> Pair:
    """Return `path_velocity` of a tick, looked up: `pace` is `path_velocities` of φ's ticks, m/s."""
    if tick >= pace.shape[0]:
        return 0.0, 0.0
    return pace[tick, 0], pace[tick, 1]


def path_velocities(path: FloatArray, ticks: int, time_step: float) -> FloatArray:
    """Return `path_velocity` of ticks 0 … ticks − 1, ticks × 2, m/s."""
    found = np.zeros((ticks, 2))
    own = min(ticks, len(path) - 1)
    found[:own] = (path[1 : own + 1] - path[:own]) / time_step
    return found


@template
def leads_nowhere(parameters: Any, x: float, y: float, x_after: float, y_after: float) -> bool:
    """Return whether a step ends where the car cannot be met any more, or leads into something that stands."""
    p = parameters
    across, along = on_road(p, x_after, y_after)
    if within(p.loss, across, along):
        return True
    # On an open road the call alone would take as long as the rest of a step.
    return p.obstacles.shape[0] > 0 and runs_into(p.obstacles, x, y, x_after, y_after, p.core)


@kernel(inline=True)
def _begin_nothing(parameters: Any, state: FloatArray) -> None:
    """Write nothing: the objective has no state of its own."""


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
    follows_phi: bool = False
    plans_deviation: bool = False


class _KernelGroup(type):
    def __hash__(cls) -> int:  # said for mypy: a part is a key of what was compiled with it
        return super().__hash__()


class CarKernels(metaclass=_KernelGroup):
    """How a kind of predicted car moves.

    Attributes:
        name: name of the kind; compiled code is called by it.
        own_dim: length of the car's own part of a state, which comes right behind its place, speed and trigger.
        start_car: (parameters, state_out, rng): draw place, speed and policy of the car in the initial belief.
        advance_car: (parameters, state, vx, vy, next_state_out, rng): write all of the car's part of the next state,
            while the adversary moves with a velocity.
        expected_motion: (parameters, state, place, before, now, car, changes) → what the car of a state will do, its
            noise left aside: acceleration, m/s², how far it goes to the right in the tick, m, and how far it is turned
            to the right then, rad; the adversary being at a place, with its velocities of the tick before and of this
            one; the car's (path coordinate, speed, offset); by how much its speed changed in the last tick and in the
            one before, m/s, and how far it is turned now.
        resume_car: (parameters, state, redrawn_out, rng): draw the car's speed anew, near that of a state that was
            believed, before the sensor places the car.
        redraw_policy: (parameters, redrawn_out, rng): draw the car's policy anew, after that.
        last_changes: (parameters, state) → the `changes` with which `expected_motion` begins; 0 to a car that has a
            law.
        aside: (parameters, state) → how far the car is to the right of the middle of its lane, m, and turned, rad.
    """

    name: str
    own_dim: int


class SensorModel(metaclass=_KernelGroup):
    """What is seen of the car, and how likely that is.

    Attributes:
        name: name of the sensor; compiled code is called by it.
        sense: (scenario, own place (x, y) in m, the car, generator) → observation.
        observe: draws an observation; see `Pomdp`.
        likelihood: likelihood of an observation; see `Pomdp`.
        place_car: (parameters, state, observation, redrawn_out, rng): place the car of a redrawn state, which holds the
            adversary's own part already, where an observation says, with the sensor's noise; `state` was believed.
        observation_dim: length of an observation.
    """

    name: str
    observation_dim = 1
    sense: Callable[[Scenario, Pair, CarState, np.random.Generator], FloatArray]


class RoadKernels(metaclass=_KernelGroup):
    """The road that the car follows.

    Attributes:
        name: name of the kind; compiled code is called by it.
        parameters: scenario → parameters of the model, by name.
        on_road: (parameters, x, y) → how far to the right of the road's centre line, and where along it, a point is, m.
            In these coordinates every road is straight and leads North.
        velocity_on_road: (parameters, x, y, vx, vy) → a velocity to the right of the road and along it, beside a point.
        from_car: (parameters, x, y, car_s) → how far ahead and to the left of the car's reference point a point is, m.
        to_middle: (parameters, x, y, car_s, aside) → where a point is once it is moved together with a car that is
            `aside` so that this is on the centre line.
        left_behind: (parameters, x, y, car_s) → whether a point is behind the car, which will not turn back to it. The
            path coordinate alone does not say so: before a curve, who is on its inner side may be far behind the car,
            and be there before it by the short cut.
        at_distance: (parameters, x, y, distance, behind) → path coordinate (m) at a distance (m) from a point, before
            it on the road or beyond it.
        contact: (parameters, place, place_after, heading, car_s, car_s_after) → share of a step at which road user and
            car first touch, else infinity; both move uniformly. A template that uses `touch`.
    """

    name: str
    parameters: Callable[[Scenario], Mapping[str, Any]]


class RoadUserKernels(metaclass=_KernelGroup):
    """How road users of some kinds move, and how their bodies touch.

    Attributes:
        name: name by which compiled code is called.
        action_count: actions are 0 … action_count − 1.
        rest: action with which it stays where it is, or comes nearest to that.
        own_dim: length of the road user's own part of a state beyond its place; it begins at `USER_ROW`.
        box: whether its body has to be a box.
        late: `LATE_ACTIONS`.
        early: `EARLY_ACTIONS`.
        start_road_user: (parameters, state_out): write the own part of a first state.
        velocity: (parameters, state, action) → velocity.
        settle: (parameters, state, vx, vy, next_state_out): write the own part after a step with a velocity.
        possible: (parameters, state, vx, vy) → what comes nearest to a velocity of all that it can do from its state.
        moving: (parameters, state) → velocity with which it came into a state; none of one that changes it at once.
        next_velocity: (parameters, vx, vy, action) → velocity in a tick before which it moved at (vx, vy).
        next_possible: (parameters, vx, vy, x, y) → what comes nearest to velocity (x, y) of all it can do after (vx,
            vy).
        pointing: (parameters, state, vx, vy) → where its body points (rad) while it moves with a velocity.
        steer: (parameters, state, direction) → the action that comes nearest to one of a pedestrian's six, in which
            default policies think.
        touch: (parameters, before, after, turned) → share of a step at which its body first touches the car, else
            infinity: (ahead, left) of the car's reference point when the step begins and ends, m; heading of its body
            relative to the car's, rad.
    """

    name: str
    action_count: int
    rest: int
    own_dim = 0
    box = False
    late: tuple[int, ...]
    early: tuple[int, ...]


@dataclass(frozen=True)
class RoadUserModel:
    """A kind of road user: how the adversary can move, and all else that is special to it.

    Attributes:
        name: name of the kind, as in the section `adversary` of a scenario.
        kernels: kernels of how it moves; several kinds can share them.
        parameters: scenario → parameters of the model, by name.
        fastest: plausible speed, m/s; whatever moves faster in a recording is of another kind, or its unit is wrong.
        height: height of its body in pictures and messages, m.
        mass: its mass with who rides it, kg; nan where it is not known.
        names: what another simulator, a format or a data set calls it, by their names: `{"carla":
            "walker.pedestrian.0001", "openscenario": "pedestrian"}`; data sets of levelXdata are `levelxdata`.
    """

    name: str
    kernels: type[RoadUserKernels]
    parameters: Callable[[Scenario], Mapping[str, Any]]
    fastest: float
    height: float
    mass: float = math.nan
    names: Mapping[str, str] = field(default_factory=dict)


class CarPrediction(Protocol):
    """How the adversary predicts the car: a kind of car, its parameters, and the sensor that goes with it."""

    @property
    def kernels(self) -> type[CarKernels]:
        """Kernels of how the predicted car moves."""

    @property
    def sensor(self) -> type[SensorModel]:
        """Sensor by which the adversary sees the car."""

    def parameters(self, scenario: Scenario) -> Mapping[str, Any]:
        """Return numbers and arrays for the kernels, by name.

        Among them `waiting_reward`, m of deviation (at most 0) that each step after φ's end costs who waits for it.
        """
