"""The same problems as models of pomdp-py, in plain Python as its users write them, and its POUCT planner on them.

pomdp-py (Zheng and Tellex 2020) has the planner in Cython and calls the model's `sample` methods. Here the planner is
POUCT, POMCP's search; the belief it starts from is a sample of the same particle belief that the planner under test
uses, and both have the same default policy. A continuous observation is binned (`bin_width`), for POMCP makes a child
of every observation. pomdp-py knows no end of an episode: an ended state stays as it is and yields nothing.
"""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pomdp_py
from skd_adversary.model.road_user.pedestrian import DIRECTION_EAST, DIRECTION_NORTH, EAST, SOUTH, STAY
from skd_adversary.planning.belief import ParticleBelief
from skd_adversary.planning.pomdp import Pomdp
from skd_sim.geometry.contact import first_contact

from problems import light_dark, rock_sample, sub_hunt, tag, tiger
from problems.pursuit import STEP_REWARD, TAG, TAG_REWARD

State = tuple[float, ...]
ENDED: State = ()
CROSSED: State = (0.0,)  # SubHunt's other end


@dataclass(frozen=True)
class PythonModel:
    """A POMDP as plain functions of tuples; ENDED is the state after the end."""

    action_count: int
    transition: Callable[[State, int], State]
    observation: Callable[[State, int], Hashable]
    reward: Callable[[State, int, State], float]
    rollout_action: Callable[[State], int]


def python_model(name: str, model: Pomdp, bin_width: float = 1.0) -> PythonModel:
    """Return the model `name` with the parameters of its compiled twin.

    Args:
        name: tiger, rock_sample, tag, light_dark, sub_hunt or crossing.
        model: the compiled model.
        bin_width: of continuous observations, m or cells.
    """
    makers: dict[str, Callable[[Any, float], PythonModel]] = {
        "tiger": _tiger,
        "rock_sample": _rock_sample,
        "tag": _tag,
        "light_dark": _light_dark,
        "sub_hunt": _sub_hunt,
        "crossing": _crossing,
    }
    return makers[name](model.parameters, bin_width)


def _tiger(p: tiger.TigerParameters, _: float) -> PythonModel:
    def transition(state: State, action: int) -> State:
        return state if action == tiger.LISTEN else (float(random.random() < 0.5),)

    def observation(state: State, action: int) -> Hashable:
        right = random.random() < (p.accuracy if action == tiger.LISTEN else 0.5)
        return state[0] if right else 1.0 - state[0]

    def reward(state: State, action: int, _after: State) -> float:
        if action == tiger.LISTEN:
            return p.listen
        return p.wrong if state[0] == action - 1 else p.right

    return PythonModel(3, transition, observation, reward, lambda _state: tiger.LISTEN)


def _tag(p: tag.TagParameters, _: float) -> PythonModel:
    robot_moves, opponent_moves, chase = p.robot_moves.tolist(), p.opponent_moves.tolist(), p.chase.tolist()
    nearness = p.nearness.tolist()
    count, first = len(robot_moves), tag.CHANCES

    def transition(state: State, action: int) -> State:
        if not state or (action == TAG and state[0] == state[1]):
            return ENDED
        robot, opponent = int(state[0]), int(state[1])
        moved = robot_moves[robot][action]
        opponent = opponent_moves[robot][opponent][int(5.0 * random.random())]
        chances = [0.0] * count
        if opponent == moved:
            chances[moved] = 1.0
            return (moved, opponent, *chances)
        for targets, chance in zip(opponent_moves[robot], state[first:], strict=True):
            if chance > 0.0:
                for target in targets:
                    chances[target] += 0.2 * chance
        missed = 1.0 - chances[moved]
        chances[moved] = 0.0
        return (moved, opponent, *[chance / missed for chance in chances])

    def observation(state: State, _action: int) -> Hashable:
        return -1 if not state or state[0] == state[1] else state[0]

    def reward(state: State, action: int, after: State) -> float:
        if not state:
            return 0.0
        if action != TAG:
            return STEP_REWARD
        return -TAG_REWARD if after else TAG_REWARD

    def rollout_action(state: State) -> int:
        if not state or state[0] == state[1]:
            return TAG
        robot = int(state[0])
        scores = [chance * near for chance, near in zip(state[first:], nearness[robot], strict=True)]
        scores[robot] = 0.0
        return int(chase[robot][scores.index(max(scores))])

    return PythonModel(5, transition, observation, reward, rollout_action)


def _rock_sample(p: rock_sample.RockSampleParameters, _: float) -> PythonModel:
    size, rock_at, rocks, accuracies = p.size, p.rock_at.tolist(), p.rocks.tolist(), p.accuracy.tolist()
    first = rock_sample.CHANCES

    def transition(state: State, action: int) -> State:
        if not state:
            return ENDED
        cell, bits = int(state[0]), int(state[1])
        after = [state[0], state[1], rock_sample.NOTHING, *state[first:]]
        if action >= rock_sample.CHECK:
            rock = action - rock_sample.CHECK
            accuracy, chance = accuracies[cell][rock], state[first + rock]
            seems_good = ((bits >> rock) & 1 == 1) == (random.random() < accuracy)
            after[2] = rock_sample.GOOD if seems_good else rock_sample.BAD
            if_good = accuracy if seems_good else 1.0 - accuracy
            after[first + rock] = chance * if_good / (chance * if_good + (1.0 - chance) * (1.0 - if_good))
        elif action == rock_sample.SAMPLE:
            if rock_at[cell] >= 0:
                after[1] = bits & ~(1 << rock_at[cell])
                after[first + rock_at[cell]] = 0.0
        elif action == rock_sample.EAST:
            if cell % size + 1 == size:
                return ENDED
            after[0] = cell + 1
        elif action == rock_sample.NORTH and cell // size + 1 < size:
            after[0] = cell + size
        elif action == rock_sample.SOUTH and cell >= size:
            after[0] = cell - size
        elif action == rock_sample.WEST and cell % size > 0:
            after[0] = cell - 1
        return tuple(after)

    def observation(state: State, _action: int) -> Hashable:
        return state[2] if state else rock_sample.NOTHING

    def reward(state: State, action: int, after: State) -> float:
        if not state or action >= rock_sample.CHECK:
            return 0.0
        if not after:
            return rock_sample.REWARD
        if action == rock_sample.SAMPLE:
            rock = rock_at[int(state[0])]
            if rock < 0:
                return rock_sample.PENALTY
            return rock_sample.REWARD if (int(state[1]) >> rock) & 1 else -rock_sample.REWARD
        return rock_sample.PENALTY if state[0] == after[0] else 0.0

    def rollout_action(state: State) -> int:
        if not state:
            return rock_sample.EAST
        x, y = int(state[0]) % size, int(state[0]) // size
        nearest, chosen = 1 << 30, -1
        for i, (rock_x, rock_y) in enumerate(rocks):
            chance, distance = state[first + i], abs(rock_x - x) + abs(rock_y - y)
            if chance <= rock_sample.DECIDED or distance >= nearest:
                continue
            exit_value = rock_sample.REWARD * 0.95 ** (size - 1 - rock_x)
            if chance >= 1.0 - rock_sample.DECIDED:
                gain = 0.95**distance * (rock_sample.REWARD * (2.0 * chance - 1.0) + 0.95 * exit_value)
            else:
                sampled = chance * (rock_sample.REWARD + 0.95 * exit_value)
                gain = 0.95 ** (distance + 1) * (sampled + (1.0 - chance) * exit_value)
            if gain > rock_sample.REWARD * 0.95 ** (size - 1 - x):
                nearest, chosen = distance, i
        if chosen < 0:
            return rock_sample.EAST
        rock_x, rock_y = rocks[chosen]
        if x != rock_x:
            return rock_sample.EAST if x < rock_x else rock_sample.WEST
        if y != rock_y:
            return rock_sample.NORTH if y < rock_y else rock_sample.SOUTH
        return rock_sample.SAMPLE if state[first + chosen] >= 1.0 - rock_sample.DECIDED else rock_sample.CHECK + chosen

    return PythonModel(rock_sample.CHECK + len(rocks), transition, observation, reward, rollout_action)


def _light_dark(p: light_dark.LightDarkParameters, bin_width: float) -> PythonModel:
    moves, by_light = light_dark.MOVES, p.by_light.tolist()

    def transition(state: State, action: int) -> State:
        if not state or action == light_dark.STOP:
            return ENDED
        return (min(max(state[0] + moves[action], -p.radius), p.radius),)

    def observation(state: State, _action: int) -> Hashable:
        if not state:
            return 0
        return math.floor(random.gauss(state[0], abs(state[0] - p.light) + p.sharpest) / bin_width)

    def reward(state: State, action: int, _after: State) -> float:
        if not state:
            return 0.0
        if action != light_dark.STOP:
            return p.move
        return p.correct if state[0] == 0.0 else p.incorrect

    def rollout_action(state: State) -> int:
        if not state or state[0] == 0.0:
            return light_dark.STOP  # a rollout has to end somewhere; leaf values are not known to pomdp-py
        return by_light[int(state[0] + p.radius)]

    return PythonModel(len(moves), transition, observation, reward, rollout_action)


def _sub_hunt(p: sub_hunt.SubHuntParameters, bin_width: float) -> PythonModel:
    ways = ((0, 1), (1, 0), (0, -1), (-1, 0))

    def within(cell: float) -> float:
        return min(max(cell, 1.0), p.size)

    def transition(state: State, action: int) -> State:
        if len(state) < 6:
            return state
        own_x, own_y, x, y, goal, aware = state
        if action == sub_hunt.PING:
            aware = 1.0
        elif action != sub_hunt.ENGAGE:
            own_x = within(own_x + p.speed * ways[action][0])
            own_y = within(own_y + p.speed * ways[action][1])
        elif math.hypot(x - own_x, y - own_y) <= p.kill_radius and (aware == 0.0 or random.random() < p.kill_if_aware):
            return ENDED
        ahead = int(goal)
        aside = random.choice((ahead, ahead, (ahead + 3) % 4, (ahead + 1) % 4))
        x = within(x + ways[ahead][0] + ways[aside][0])
        y = within(y + ways[ahead][1] + ways[aside][1])
        along = y if ahead in (sub_hunt.NORTH, sub_hunt.SOUTH) else x
        if along == (p.size if ahead in (sub_hunt.NORTH, sub_hunt.EAST) else 1.0):
            return CROSSED
        return own_x, own_y, x, y, goal, aware

    def observation(state: State, action: int) -> Hashable:
        if len(state) < 6:
            return ()
        dx, dy = state[2] - state[0], state[3] - state[1]
        distance, beam = math.hypot(dx, dy), -1
        ping = action == sub_hunt.PING
        if ping or distance <= p.passive_radius:
            beam = (math.ceil(4.0 * math.atan2(dy, dx) / math.pi) - 1) % 8
        mean, sigma = (p.size, p.sigma) if ping else (p.passive_radius, p.passive_sigma)
        readings = [random.gauss(distance, p.sigma) if k == beam else random.gauss(mean, sigma) for k in range(8)]
        return tuple(math.floor(reading / bin_width) for reading in readings)

    def reward(state: State, _action: int, after: State) -> float:
        return p.kill if len(state) == 6 and after == ENDED else 0.0

    def rollout_action(state: State) -> int:
        if len(state) < 6:
            return sub_hunt.ENGAGE
        dx, dy = state[2] - state[0], state[3] - state[1]
        if math.hypot(dx, dy) <= p.kill_radius:
            return sub_hunt.ENGAGE
        if abs(dx) > abs(dy):
            return sub_hunt.EAST if dx > 0.0 else sub_hunt.WEST
        return sub_hunt.NORTH if dy > 0.0 else sub_hunt.SOUTH

    return PythonModel(6, transition, observation, reward, rollout_action)


def _crossing(p: Any, bin_width: float) -> PythonModel:
    """Return the kamikaze POMDP of a car whose C is known: `skd_adversary.model.objective.paper`.

    A state has a sixth entry, 1 after a collision and 2 beyond the car's path; the episode ends with either.
    """
    path = p.path.tolist()
    margin = p.radius + p.half_width

    def transition(state: State, action: int) -> State:
        x, y, car_y, speed, trigger, end = state
        if end:
            return state
        x_after = x + p.time_step * p.adversary_speed * DIRECTION_EAST[action]
        y_after = y + p.time_step * p.adversary_speed * DIRECTION_NORTH[action]
        acceleration = -p.deceleration if 0.0 <= y - car_y - p.front <= trigger else 0.0
        noise = speed * p.speed_noise * random.uniform(-1.0, 1.0)
        speed_after = max(0.0, speed + noise + p.time_step * acceleration)
        car_after = car_y + 0.5 * p.time_step * (speed + speed_after)
        hit = False
        if not (
            (x < -margin and x_after < -margin)
            or (x > margin and x_after > margin)
            or (y - car_y > p.front + p.radius and y_after - car_after > p.front + p.radius)
        ):
            fraction = first_contact(
                y - car_y, -x, y_after - car_after, -x_after, p.front, p.rear, p.half_width, p.radius
            )
            hit = fraction <= 1.0
        return x_after, y_after, car_after, speed_after, trigger, 1.0 if hit else 2.0 if x_after > margin else 0.0

    def observation(state: State, _action: int) -> Hashable:
        return math.floor(random.gauss(state[2] - state[1], p.position_noise) / bin_width)

    def reward(state: State, _action: int, after: State) -> float:
        if state[5]:
            return 0.0
        return -p.distance_weight * _distance(after[0], after[1], path) + p.collision_reward * (after[5] == 1.0)

    def rollout_action(state: State) -> int:
        if state[0] < -0.5 * p.half_width or state[2] + p.front >= state[1]:
            return EAST
        return SOUTH if random.random() < 0.5 else STAY

    return PythonModel(len(DIRECTION_EAST), transition, observation, reward, rollout_action)


def _distance(x: float, y: float, path: list[list[float]]) -> float:
    """Return the distance from (x, y) to a polyline, m."""
    best = math.inf
    for (ax, ay), (bx, by) in itertools.pairwise(path):
        along_x, along_y = bx - ax, by - ay
        squared = along_x * along_x + along_y * along_y
        s = ((x - ax) * along_x + (y - ay) * along_y) / squared if squared > 0.0 else 0.0
        s = min(1.0, max(0.0, s))
        best = min(best, math.hypot(x - ax - s * along_x, y - ay - s * along_y))
    return best


class _Action(pomdp_py.Action):  # type: ignore[misc]
    """An action by its index."""

    def __init__(self, index: int) -> None:
        self.index = index

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Action) and self.index == other.index

    def __hash__(self) -> int:
        return self.index


class _Transition(pomdp_py.TransitionModel):  # type: ignore[misc]
    def __init__(self, model: PythonModel) -> None:
        self._draw = model.transition

    def sample(self, state: Any, action: Any) -> Any:
        return pomdp_py.SimpleState(self._draw(state.data, action.index))


class _Observation(pomdp_py.ObservationModel):  # type: ignore[misc]
    def __init__(self, model: PythonModel) -> None:
        self._draw = model.observation

    def sample(self, next_state: Any, action: Any) -> Any:
        return pomdp_py.SimpleObservation(self._draw(next_state.data, action.index))


class _Reward(pomdp_py.RewardModel):  # type: ignore[misc]
    def __init__(self, model: PythonModel) -> None:
        self._reward = model.reward

    def sample(self, state: Any, action: Any, next_state: Any) -> float:
        return self._reward(state.data, action.index, next_state.data)


class _Policy(pomdp_py.RolloutPolicy):  # type: ignore[misc]
    def __init__(self, model: PythonModel) -> None:
        self._actions = [_Action(i) for i in range(model.action_count)]
        self._rollout = model.rollout_action

    def get_all_actions(self, state: Any = None, history: Any = None) -> list[Any]:
        return self._actions

    def sample(self, state: Any) -> Any:
        return random.choice(self._actions)

    def rollout(self, state: Any, history: Any = None) -> Any:
        return self._actions[self._rollout(state.data)]


class PomdpPyPlanner:
    """pomdp-py's POUCT behind the calls of our planner."""

    def __init__(
        self, model: PythonModel, *, simulations: int, depth: int, exploration: float, discount: float, seed: int
    ) -> None:
        """Prepare the models; pomdp-py draws from Python's global generator, which is seeded here."""
        random.seed(seed)
        self._models = _Transition(model), _Observation(model), _Reward(model)
        self._policy = _Policy(model)
        self._rng = np.random.default_rng(seed)
        self._simulations = simulations
        self._planner = pomdp_py.POUCT(
            max_depth=depth,
            num_sims=simulations,
            discount_factor=discount,
            exploration_const=exploration,
            num_visits_init=0,
            rollout_policy=self._policy,
        )

    def plan(self, belief: ParticleBelief, extra: State = ()) -> int:
        """Return the action for a belief; `extra` is appended to every state."""
        drawn = self._rng.choice(len(belief.weights), min(self._simulations, 1000), p=belief.weights)
        states = [pomdp_py.SimpleState((*row, *extra)) for row in belief.particles[drawn].tolist()]
        agent = pomdp_py.Agent(pomdp_py.Particles(states), self._policy, *self._models)
        return int(self._planner.plan(agent).index)
