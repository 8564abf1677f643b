"""How little deformation is found to be enough to be hit by any car that runs in process: not less than the floor.

Of a car that is not known beforehand only its own answers tell what it does. So sequences of the seven actions are
tried against the episode's own world and controller, with the episode's own draws, until a budget of simulated ticks is
used up. First are φ itself, the kamikaze's own sequence, and, if neither collides, walking up to the car from late on
φ, then from earlier. Then two searches take turns. One goes best first through what has been reached, in the order of
what has been strayed and of what it would take to meet a car that drives on as it does now; places in a cell of a few
centimetres, beside a car in nearly the same state, count as one. The other changes the best sequence so far in a few
ticks.

A longer budget goes on where a shorter one stopped, so it never finds less.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from skd_adversary.model.road_user.pedestrian import ACTION_COUNT, AS_PHI, action_velocity
from skd_adversary.model.safe_path import path_velocity
from skd_sim.branching import Branch, ControllerFactory, Way
from skd_sim.compilation import kernel
from skd_sim.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.geometry import rectangle_distance
from skd_sim.randomness import Role, generator
from skd_sim.state import PedestrianState
from skd_sim.trajectory import FloatArray, Trajectory

from skd_evaluator.measure.deformation import deformation

DEFAULT_FLOOR_BUDGET = 1000
_ENOUGH = 1e-9  # m: nobody has strayed
_CELL = 0.06  # m, in which places count as one
_CAR_CELL = (0.05, 0.1)  # m and m/s, likewise for the car
_BUCKET = 0.05  # m: of nodes that differ by less, the later one in time goes first
_EXPANSIONS, _VARIATIONS = 40, 12  # a turn of either search
_EVERY = 3  # ticks along φ, from its end on, from which it is tried to walk up to the car
_SUB_STEPS = 4  # of a tick, in which the car that drives on is looked at
_BRAKES = -0.5  # m/s², below which the car is taken to go on braking


@dataclass(frozen=True, eq=False)
class AnytimeFloor:
    """The best sequence found.

    Attributes:
        distance: its deformation, m.
        actions: one per tick, as numbered in `skd_adversary.model.road_user.pedestrian`.
        trajectory: the pedestrian's positions, up to the place of the first contact.
        duration: until then, ticks.
        simulated_steps: ticks of the car that the search has simulated.
    """

    distance: float
    actions: npt.NDArray[np.int64]
    trajectory: Trajectory
    duration: float
    simulated_steps: int


@dataclass(eq=False, slots=True)
class _Node:
    branch: Branch
    pedestrian: PedestrianState
    tick: int
    strayed: float
    parent: _Node | None
    action: int


def actions_of(log: EpisodeLog) -> list[int]:
    """Return the sequence of actions that is nearest to what a kamikaze walked, one per tick."""
    episode = log.episode
    assert episode.safe_trajectory is not None
    steps = np.diff(log.pedestrian, axis=0)
    found = []
    for tick, step in enumerate(steps):
        moves = [_velocity(episode, action, tick) for action in range(ACTION_COUNT + 1)]
        away = [math.dist(step, [episode.scenario.time_step * v for v in move]) for move in moves]
        found.append(int(np.argmin(away)))
    return found


def anytime_floor(
    episode: Episode,
    budget: int = DEFAULT_FLOOR_BUDGET,
    start: Sequence[int] | None = None,
    controller: ControllerFactory | None = None,
) -> AnytimeFloor | None:
    """Search for the colliding sequence of least deformation.

    Args:
        episode: kamikaze mode; its objective does not matter.
        budget: ticks of the car that may be simulated.
        start: a sequence to begin with, as that of the episode's own kamikaze.
        controller: makes the car under test, anew at each call; from the specification by default.

    Returns:
        The best sequence found; None where none collided.

    Raises:
        ValueError: the episode is not in kamikaze mode, or the budget is below 1.
    """
    if episode.mode != Mode.KAMIKAZE or episode.safe_trajectory is None:
        raise ValueError(f"only a kamikaze episode has a floor, not mode {episode.mode.name}")
    if budget < 1:
        raise ValueError(f"the budget must be at least 1 tick, got {budget}")
    copies = Branch(episode, controller).can_be_copied()
    while True:
        search = _Search(episode, budget, Branch(episode, controller, copies=copies))
        search.run(start)
        if search.best is None:
            return None
        actions = search.actions(search.best)
        walked = _walk(episode, actions, controller)
        if walked is not None and abs(walked[1] - search.least) <= _ENOUGH:
            trajectory, distance, duration = walked
            return AnytimeFloor(distance, np.array(actions), trajectory, duration, search.steps)
        assert copies, f"episode {episode.episode_id}: the car answers differently to the same actions"
        copies = False  # it keeps something outside of what was copied


def _velocity(episode: Episode, action: int, tick: int) -> tuple[float, float]:
    if action != AS_PHI:
        return action_velocity(action, episode.scenario.pedestrian.speed)
    assert episode.safe_trajectory is not None
    vx, vy = path_velocity(episode.safe_trajectory.positions, tick, episode.scenario.time_step)
    return float(vx), float(vy)


def _walk(
    episode: Episode, actions: Sequence[int], controller: ControllerFactory | None
) -> tuple[Trajectory, float, float] | None:
    """Run a sequence from the start; return trajectory, deformation and duration; none unless it ends in a hit."""
    branch = Branch(episode, controller)
    pedestrian = branch.world.pedestrian
    places = [pedestrian[:2]]
    contact = None
    for tick, action in enumerate(actions):
        if contact is not None:
            return None
        pedestrian, contact = branch.go_on(pedestrian, _velocity(episode, action, tick))
        places.append(pedestrian[:2])
    if contact is None:
        return None
    before, after = np.array(places[-2]), np.array(places[-1])
    walked = np.array([*places[:-1], before + contact.fraction * (after - before)])
    duration = len(actions) - 1 + contact.fraction
    assert episode.safe_trajectory is not None
    distance = deformation(episode.safe_trajectory.positions, walked, duration)
    return Trajectory(walked, episode.scenario.time_step), distance, duration


@kernel
def _still(
    phi: FloatArray,
    tick: int,
    ticks: int,
    time_step: float,
    x: float,
    y: float,
    fastest: float,
    car: tuple[float, float, float, float],
    acceleration: float,
    footprint: tuple[float, float, float, float],
) -> float:
    """Return how far from φ, at least, one meets a car that goes on as it does, within one's reach; infinity: never.

    Args:
        phi: φ, n × 2, m.
        tick: now.
        ticks: at the end of the episode.
        time_step: s.
        x: of the pedestrian now, m.
        y: likewise.
        fastest: speed of the pedestrian, m/s.
        car: x, y (m), heading (rad) and speed (m/s) now.
        acceleration: of the car, m/s².
        footprint: front, rear, half width, and the pedestrian's radius, m.
    """
    front, rear, half_width, radius = footprint
    cos, sin = math.cos(car[2]), math.sin(car[2])
    last = phi.shape[0] - 1
    least = math.inf
    for sub in range(1, (ticks - tick) * _SUB_STEPS + 1):
        time = sub * time_step / _SUB_STEPS
        driving = time if acceleration >= 0.0 else min(time, car[3] / -acceleration)
        way = car[3] * driving + 0.5 * min(acceleration, 0.0) * driving * driving
        x_car, y_car = car[0] + way * cos, car[1] + way * sin
        whole = tick + sub // _SUB_STEPS
        share = (sub % _SUB_STEPS) / _SUB_STEPS
        before, after = min(whole, last), min(whole + 1, last)
        dx = phi[before, 0] + share * (phi[after, 0] - phi[before, 0]) - x_car
        dy = phi[before, 1] + share * (phi[after, 1] - phi[before, 1]) - y_car
        away = rectangle_distance(cos * dx + sin * dy, cos * dy - sin * dx, front, rear, half_width) - radius
        if away >= least:
            continue
        dx, dy = x - x_car, y - y_car
        way_there = rectangle_distance(cos * dx + sin * dy, cos * dy - sin * dx, front, rear, half_width) - radius
        if way_there <= fastest * time:
            least = max(0.0, away)
    return least


class _Search:
    """One search, with the best that it has found.

    Attributes:
        best: last node of the best sequence; its strayed is that of the contact.
        steps: ticks simulated.
    """

    def __init__(self, episode: Episode, budget: int, root: Branch) -> None:
        assert episode.safe_trajectory is not None
        scenario = episode.scenario
        self._episode = episode
        self._phi = episode.safe_trajectory.positions
        self._budget = budget
        self._rng = generator(episode.seed, episode.episode_id, Role.FLOOR)
        self._root = _Node(root, root.world.pedestrian, 0, 0.0, None, -1)
        steps = np.linalg.norm(np.diff(self._phi, axis=0), axis=1) / scenario.time_step
        self._fastest = float(max(scenario.pedestrian.speed, steps.max(initial=0.0)))
        self._footprint = (scenario.car.front, scenario.car.rear, scenario.car.half_width, scenario.pedestrian.reach)
        self._seen: dict[tuple[int, ...], float] = {}
        self._queue: list[tuple[int, int, int, _Node]] = []
        self._pushed = 0
        self.best: _Node | None = None
        self.steps = 0

    @property
    def least(self) -> float:
        """Deformation of the best sequence, m; infinity: none."""
        return math.inf if self.best is None else self.best.strayed

    def actions(self, node: _Node | None) -> list[int]:
        """Return the sequence that leads to a node."""
        return [step.action for step in self._chain(node)[1:]]

    def run(self, start: Sequence[int] | None) -> None:
        """Search until the budget is used up, or nothing is left to find."""
        last = self._roll_out(self._root, lambda _node: AS_PHI)
        if start is not None:
            self._roll_out(self._root, lambda node: start[node.tick] if node.tick < len(start) else AS_PHI)
        for node in self._chain(last)[::-_EVERY]:
            if self.best is None:
                self._roll_out(node, self._towards_the_car)
        self._push(self._root)
        while self._goes_on() and (self._queue or self.best is not None):
            for _ in range(_EXPANSIONS):
                if self._queue and self._goes_on():
                    self._expand(heapq.heappop(self._queue)[-1])
            for _ in range(_VARIATIONS):
                if self.best is not None and self._goes_on():
                    self._vary()

    def _goes_on(self) -> bool:
        return self.steps < self._budget and self.least > _ENOUGH

    @staticmethod
    def _chain(node: _Node | None) -> list[_Node]:
        chain = []
        while node is not None:
            chain.append(node)
            node = node.parent
        return chain[::-1]

    def _after(self, node: _Node, way: Way, action: int) -> tuple[_Node, Outcome]:
        """Return what an action leads to on the ways of a node; its strayed counts up to the contact."""
        tick = node.tick
        branch, pedestrian, contact = way.go(_velocity(self._episode, action, tick))
        share = 1.0 if contact is None else contact.fraction
        last = len(self._phi) - 1
        here, there = self._phi[min(tick, last)], self._phi[min(tick + 1, last)]
        before = node.pedestrian
        ex = before.x + share * (pedestrian.x - before.x) - (here[0] + share * (there[0] - here[0]))
        ey = before.y + share * (pedestrian.y - before.y) - (here[1] + share * (there[1] - here[1]))
        after = _Node(branch, pedestrian, tick + 1, max(node.strayed, math.hypot(ex, ey)), node, action)
        outcome = self._episode.outcome(tick + 1, pedestrian, collided=contact is not None)
        if outcome == Outcome.COLLISION and after.strayed < self.least:
            self.best = after
        return after, outcome

    def _expand(self, node: _Node) -> None:
        if node.strayed >= self.least:
            return
        way = node.branch.drive(node.pedestrian)
        for action in range(ACTION_COUNT, -1, -1):
            if way.ticks and not way.shared and self.steps + way.ticks >= self._budget:
                break
            after, outcome = self._after(node, way, action)
            if outcome == Outcome.RUNNING and after.strayed < self.least and not self._known(after):
                self._push(after)
        self.steps += way.ticks

    def _known(self, node: _Node) -> bool:
        """Tell whether somebody has been about here before who had not strayed further; if not, remember this one."""
        car, at = node.branch.world.car, self._phi[min(node.tick, len(self._phi) - 1)]
        key = (
            node.tick,
            round(car.x / _CAR_CELL[0]),
            round(car.y / _CAR_CELL[0]),
            round(car.speed / _CAR_CELL[1]),
            round((node.pedestrian.x - at[0]) / _CELL),
            round((node.pedestrian.y - at[1]) / _CELL),
        )
        if self._seen.get(key, math.inf) <= node.strayed:
            return True
        self._seen[key] = node.strayed
        return False

    def _push(self, node: _Node) -> None:
        world = node.branch.world
        car, before = world.car, node.parent.branch.world.car if node.parent is not None else world.car
        time_step = self._episode.scenario.time_step
        change = (car.speed - before.speed) / time_step
        still = _still(
            self._phi,
            node.tick,
            self._episode.scenario.ticks,
            time_step,
            node.pedestrian.x,
            node.pedestrian.y,
            self._fastest,
            (car.x, car.y, car.heading, car.speed),
            change if change < _BRAKES else 0.0,
            self._footprint,
        )
        total = max(node.strayed, still)
        if math.isinf(total):
            total = 1e3
        self._pushed += 1
        heapq.heappush(self._queue, (int(total / _BUCKET), -node.tick, self._pushed, node))

    def _roll_out(self, node: _Node, choose: Callable[[_Node], int]) -> _Node:
        """Follow a sequence from a node until it ends or has strayed as far as the best; return the last node."""
        outcome = self._episode.outcome(node.tick, node.pedestrian, collided=False)
        while outcome == Outcome.RUNNING and self._goes_on() and node.strayed < self.least:
            way = node.branch.drive(node.pedestrian)
            node, outcome = self._after(node, way, choose(node))
            self.steps += way.ticks
        return node

    def _towards_the_car(self, node: _Node) -> int:
        """Return the action that ends nearest to where the car will be if it keeps its speed."""
        car, time_step = node.branch.world.car, self._episode.scenario.time_step
        front, rear, half_width, _ = self._footprint
        cos, sin = math.cos(car.heading), math.sin(car.heading)
        way = time_step * car.speed
        best, chosen = math.inf, AS_PHI
        for action in range(ACTION_COUNT + 1):
            vx, vy = _velocity(self._episode, action, node.tick)
            dx = node.pedestrian.x + time_step * vx - car.x - way * cos
            dy = node.pedestrian.y + time_step * vy - car.y - way * sin
            away = rectangle_distance(cos * dx + sin * dy, cos * dy - sin * dx, front, rear, half_width)
            if away < best:
                best, chosen = away, action
        return chosen

    def _vary(self) -> None:
        """Try the best sequence with one to three ticks changed, or a tick left out or put in."""
        chain = self._chain(self.best)
        actions = [node.action for node in chain[1:]]
        at = int(self._rng.integers(len(actions)))
        kind = int(self._rng.integers(4))
        if kind == 0:
            del actions[at]
        elif kind == 1:
            actions.insert(at, int(self._rng.integers(ACTION_COUNT + 1)))
        else:
            for tick in range(at, min(len(actions), at + int(self._rng.integers(1, 4)))):
                actions[tick] = int(self._rng.integers(ACTION_COUNT + 1))
        self._roll_out(chain[at], lambda node: actions[node.tick] if node.tick < len(actions) else AS_PHI)
