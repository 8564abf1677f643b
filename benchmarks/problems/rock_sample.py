"""RockSample(n, k): a rover samples those of k rocks that are good (Smith and Simmons 2004, UAI).

n × n cells, k rocks at known places, each good with probability 1/2. Actions: North, East, South, West, sample, check
rock 1 … k. Sampling a good rock is worth 10 and makes it bad, a bad one −10; leaving over the East edge is worth 10 and
ends the episode; leaving elsewhere, or sampling where there is no rock, costs 100 and changes nothing. A check from
distance d is right with probability (1 + 2^(−d/20))/2; other actions show nothing. γ = 0.95.

Maps, start and half-efficiency distance as in DESPOT's C++ (`AdaCompNUS/despot`, examples/cpp_models/rock_sample),
which says that they are those of the APPL toolkit's files. SARSOP reaches 21.47 ± 0.04 on (7, 8) and 21.56 ± 0.11 on
(11, 11) (Ye, Somani, Hsu and Lee 2017, table 2).
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from skd_adversary.pomdp.model import Pomdp
from skd_sim.kernels.compilation import kernel
from skd_sim.world.state import FloatArray, IntArray

NORTH, EAST, SOUTH, WEST, SAMPLE = range(5)
CHECK: Final = 5  # the first of k
NOTHING, BAD, GOOD = 0.0, 1.0, 2.0
DISCOUNT: Final = 0.95
REWARD: Final = 10.0  # a good rock, or the exit
PENALTY: Final = -100.0
HALF_EFFICIENCY_DISTANCE: Final = 20.0
DECIDED: Final = 0.05  # P(good) below which, or above 1 less it, a rock is not checked any more
ROCKS: Final = {
    (4, 4): ((3, 1), (2, 1), (1, 3), (1, 0)),
    (7, 8): ((2, 0), (0, 1), (3, 1), (6, 3), (2, 4), (3, 4), (5, 5), (1, 6)),
    (11, 11): ((0, 3), (0, 7), (1, 8), (2, 4), (3, 3), (3, 8), (4, 3), (5, 8), (6, 1), (9, 3), (9, 9)),
}
STARTS: Final = {(4, 4): (0, 2), (7, 8): (0, 3), (11, 11): (0, 5)}
CELL, GOOD_ROCKS, SEEN, CHANCES = range(4)
"""State: x + n·y; bit i for a good rock i; the last observation; from CHANCES on P(rock i is good | what was seen)."""


class RockSampleParameters(NamedTuple):
    """Map and tables: rock in each cell or −1, the rocks' (x, y), P(a check is right) cell × rock, γ^0 … γ^(2n + 1)."""

    size: int
    start: int
    rock_at: IntArray
    rocks: IntArray
    accuracy: FloatArray
    discounts: FloatArray


@kernel
def initial(parameters: RockSampleParameters, state: FloatArray, rng: np.random.Generator) -> None:
    """Start in the start cell; every set of good rocks is as probable as any other."""
    state[CELL] = parameters.start
    state[GOOD_ROCKS] = int((1 << parameters.rocks.shape[0]) * rng.random())
    state[SEEN] = NOTHING
    state[CHANCES:] = 0.5


@kernel(inline=True)
def step(
    parameters: RockSampleParameters, state: FloatArray, action: int, after: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Move, sample or check."""
    cell, size = int(state[CELL]), parameters.size
    for i in range(state.shape[0]):
        after[i] = state[i]
    after[SEEN] = NOTHING
    if action >= CHECK:
        rock = action - CHECK
        accuracy = parameters.accuracy[cell, rock]
        good = (int(state[GOOD_ROCKS]) >> rock) & 1 == 1
        seems_good = good == (rng.random() < accuracy)
        after[SEEN] = GOOD if seems_good else BAD
        chance = state[CHANCES + rock]
        if_good = accuracy if seems_good else 1.0 - accuracy
        after[CHANCES + rock] = chance * if_good / (chance * if_good + (1.0 - chance) * (1.0 - if_good))
        return 0.0, False
    if action == SAMPLE:
        rock = parameters.rock_at[cell]
        if rock < 0:
            return PENALTY, False
        bits = int(state[GOOD_ROCKS])
        after[GOOD_ROCKS] = bits & ~(1 << rock)
        after[CHANCES + rock] = 0.0
        return REWARD if (bits >> rock) & 1 else -REWARD, False
    x, y = cell % size, cell // size
    if action == EAST:
        if x + 1 == size:
            return REWARD, True
        after[CELL] = cell + 1
    elif action == NORTH and y + 1 < size:
        after[CELL] = cell + size
    elif action == SOUTH and y > 0:
        after[CELL] = cell - size
    elif action == WEST and x > 0:
        after[CELL] = cell - 1
    else:
        return PENALTY, False
    return 0.0, False


@kernel(inline=True)
def observe(
    parameters: RockSampleParameters, state: FloatArray, action: int, seen: FloatArray, rng: np.random.Generator
) -> None:
    """Show the reading of a check, which `step` has drawn."""
    seen[0] = state[SEEN]


@kernel(inline=True)
def likelihood(parameters: RockSampleParameters, state: FloatArray, action: int, seen: FloatArray) -> float:
    """Return 1 if that is what the state has seen, else 0."""
    return 1.0 if state[SEEN] == seen[0] else 0.0


@kernel(inline=True)
def _next_rock(parameters: RockSampleParameters, state: FloatArray, x: int, y: int, done: int) -> int:
    """Return the nearest rock, not in the set `done`, for which the way to it and then to the exit pays, or −1."""
    size, discounts = parameters.size, parameters.discounts
    leaving = REWARD * discounts[size - 1 - x]
    nearest, rock = 1 << 30, -1
    for i in range(parameters.rocks.shape[0]):
        chance = state[CHANCES + i]
        if chance <= DECIDED or (done >> i) & 1 == 1:
            continue
        distance = abs(parameters.rocks[i, 0] - x) + abs(parameters.rocks[i, 1] - y)
        if distance >= nearest:
            continue
        exit_value = REWARD * discounts[size - 1 - parameters.rocks[i, 0]]
        if chance >= 1.0 - DECIDED:
            gain = discounts[distance] * (REWARD * (2.0 * chance - 1.0) + discounts[1] * exit_value)
        else:
            sampled = chance * (REWARD + discounts[1] * exit_value)
            gain = discounts[distance + 1] * (sampled + (1.0 - chance) * exit_value)
        if gain > leaving:
            nearest, rock = distance, i
    return rock


@kernel(inline=True)
def rollout_action(parameters: RockSampleParameters, state: FloatArray, rng: np.random.Generator) -> int:
    """Go to the nearest rock that pays, check it there, where a check is exact, sample it if good; at last leave."""
    cell = int(state[CELL])
    x, y = cell % parameters.size, cell // parameters.size
    rock = _next_rock(parameters, state, x, y, 0)
    if rock < 0:
        return EAST
    rock_x, rock_y = parameters.rocks[rock, 0], parameters.rocks[rock, 1]
    if x != rock_x:
        return EAST if x < rock_x else WEST
    if y != rock_y:
        return NORTH if y < rock_y else SOUTH
    return SAMPLE if state[CHANCES + rock] >= 1.0 - DECIDED else CHECK + rock


@kernel(inline=True)
def legal(parameters: RockSampleParameters, state: FloatArray, action: int) -> bool:
    """Return whether an action makes sense: no penalty, no check of a rock that is decided, no sample of a bad bet.

    In the sense of POMCP's preferred actions (Silver and Veness 2010), with probabilities in place of counts.
    """
    cell, size = int(state[CELL]), parameters.size
    if action >= CHECK:
        return DECIDED < state[CHANCES + action - CHECK] < 1.0 - DECIDED
    if action == SAMPLE:
        rock = parameters.rock_at[cell]
        return rock >= 0 and state[CHANCES + rock] > 0.5
    if action == NORTH:
        return cell + size < size * size
    if action == SOUTH:
        return cell >= size
    return action == EAST or cell % size > 0


@kernel
def _default_value(parameters: RockSampleParameters, state: FloatArray) -> float:
    """Return the expected return of the default policy, given what was seen (not what the rocks are).

    What it does next depends on where it is, not on how many steps the last rock took: so the discount is a mean.
    """
    x, y = int(state[CELL]) % parameters.size, int(state[CELL]) // parameters.size
    step_discount = parameters.discounts[1]
    value, done = 0.0, 0
    discount = 1.0
    while True:
        rock = _next_rock(parameters, state, x, y, done)
        if rock < 0:
            return value + discount * parameters.discounts[parameters.size - 1 - x] * REWARD
        done |= 1 << rock
        chance = state[CHANCES + rock]
        rock_x, rock_y = parameters.rocks[rock, 0], parameters.rocks[rock, 1]
        discount *= parameters.discounts[abs(rock_x - x) + abs(rock_y - y)]
        if chance >= 1.0 - DECIDED:
            value += discount * REWARD * (2.0 * chance - 1.0)
            discount *= step_discount
        else:
            discount *= step_discount
            value += discount * REWARD * chance
            discount *= chance * step_discount + 1.0 - chance
        x, y = rock_x, rock_y


@kernel(inline=True)
def leaf_value(parameters: RockSampleParameters, state: FloatArray) -> float:
    """Return the expected return of the default policy."""
    return _default_value(parameters, state)


@kernel(inline=True)
def step_of_advantages(
    parameters: RockSampleParameters, state: FloatArray, action: int, after: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Move, sample or check; the reward is the action's advantage over the default policy π, Q^π − V^π.

    The return of any policy is V^π plus its discounted sum of advantages (Kakade and Langford 2002, lemma 6.1), so the
    best policy is the same. But an advantage is an expectation over what is not known yet: no luck is left in it.
    """
    reward, terminal = step(parameters, state, action, after, rng)
    base = _default_value(parameters, state)
    if terminal:
        return reward - base, True
    ahead = _default_value(parameters, after)
    if action >= CHECK:
        rock = action - CHECK
        chance, posterior = state[CHANCES + rock], after[CHANCES + rock]
        accuracy = parameters.accuracy[int(state[CELL]), rock]
        seems_good = chance * accuracy + (1.0 - chance) * (1.0 - accuracy)
        probability = seems_good if after[SEEN] == GOOD else 1.0 - seems_good
        ahead *= probability
        if probability < 1.0:  # what the other reading would lead to
            after[CHANCES + rock] = min(max((chance - probability * posterior) / (1.0 - probability), 0.0), 1.0)
            ahead += (1.0 - probability) * _default_value(parameters, after)
            after[CHANCES + rock] = posterior
    elif action == SAMPLE and reward > PENALTY:
        reward = REWARD * (2.0 * state[CHANCES + parameters.rock_at[int(state[CELL])]] - 1.0)
    return reward + parameters.discounts[1] * ahead - base, False


@kernel(inline=True)
def no_value(parameters: RockSampleParameters, state: FloatArray) -> float:
    """Return 0: the default policy has no advantage over itself."""
    return 0.0


@kernel
def reinvigorate(
    parameters: RockSampleParameters, state: FloatArray, seen: FloatArray, redrawn: FloatArray, rng: np.random.Generator
) -> None:
    """Keep the place, which is known, and draw the rocks anew from what was seen before."""
    redrawn[:] = state
    redrawn[SEEN] = seen[0]
    bits = 0
    for i in range(parameters.rocks.shape[0]):
        if rng.random() < state[CHANCES + i]:
            bits |= 1 << i
    redrawn[GOOD_ROCKS] = bits


def rock_sample(size: int = 7, rock_count: int = 8, *, advantages: bool = False) -> Pomdp:
    """Return RockSample(size, rock_count).

    Args:
        size: n; the maps are (4, 4), (7, 8) and (11, 11).
        rock_count: k.
        advantages: whether the rewards are those of `step_of_advantages`: for planning.
    """
    rocks = ROCKS[size, rock_count]
    rock_at = np.full(size * size, -1, np.int64)
    accuracy = np.empty((size * size, rock_count))
    for i, (rock_x, rock_y) in enumerate(rocks):
        rock_at[rock_x + size * rock_y] = i
        for cell in range(size * size):
            distance = math.hypot(cell % size - rock_x, cell // size - rock_y)
            accuracy[cell, i] = 0.5 * (1.0 + 2.0 ** (-distance / HALF_EFFICIENCY_DISTANCE))
    start_x, start_y = STARTS[size, rock_count]
    return Pomdp(
        name="benchmark_rock_sample_advantages" if advantages else "benchmark_rock_sample",
        state_dim=CHANCES + rock_count,
        observation_dim=1,
        action_count=CHECK + rock_count,
        discount=DISCOUNT,
        parameters=RockSampleParameters(
            size,
            start_x + size * start_y,
            rock_at,
            np.array(rocks, np.int64),
            accuracy,
            DISCOUNT ** np.arange(2.0 * size + 2.0),
        ),
        initial=initial,
        step=step_of_advantages if advantages else step,
        observe=observe,
        likelihood=likelihood,
        rollout_action=rollout_action,
        reinvigorate=reinvigorate,
        leaf_value=no_value if advantages else leaf_value,
        legal=legal,
    )
