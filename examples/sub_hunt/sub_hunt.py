"""SubHunt (Sunberg and Kochenderfer, ICAPS 2018) as a POMDP of one's own, by docs/extending.md alone.

A submarine crosses a bay of 20 × 20 cells from one edge to the other. Ours goes three cells, pings, or engages, which
kills within two cells; a ping shows where the target is, and warns it. `python sub_hunt.py 20` plays 20 episodes.
"""

import math
import sys
from typing import NamedTuple

import numpy as np
from skd_adversary import ParticleBelief, Planner, PlannerOptions, Pomdp, check_model, play
from skd_sim import kernel

OWN_X, OWN_Y, X, Y, GOAL, AWARE = range(6)  # of a state
PING, ENGAGE = 4, 5  # 0 to 3: go north, east, south, west


class Parameters(NamedTuple):
    kill_if_aware: float = 0.6
    passive_radius: float = 3.0


@kernel
def initial(p, state, rng):
    goal, along = int(4 * rng.random()), 1.0 + int(20 * rng.random())
    far = 1.0 if goal < 2 else 20.0
    state[:] = np.array((10.0, 10.0, along if goal % 2 == 0 else far, far if goal % 2 == 0 else along, goal, 0.0))


@kernel
def step(p, state, action, after, rng):
    after[:] = state
    if action == PING:
        after[AWARE] = 1.0
    elif action == ENGAGE:
        distance = math.hypot(state[X] - state[OWN_X], state[Y] - state[OWN_Y])
        if distance <= 2.0 and (state[AWARE] == 0.0 or rng.random() < p.kill_if_aware):
            return 100.0, True
    else:
        after[OWN_X] = min(max(state[OWN_X] + 3.0 * ((action == 1) - (action == 3)), 1.0), 20.0)
        after[OWN_Y] = min(max(state[OWN_Y] + 3.0 * ((action == 0) - (action == 2)), 1.0), 20.0)
    goal, luck = int(state[GOAL]), rng.random()
    for way in (goal, goal if luck < 0.5 else (goal + 3) % 4 if luck < 0.75 else (goal + 1) % 4):
        after[X] = min(max(after[X] + (way == 1) - (way == 3), 1.0), 20.0)
        after[Y] = min(max(after[Y] + (way == 0) - (way == 2), 1.0), 20.0)
    return 0.0, after[Y if goal % 2 == 0 else X] == (20.0 if goal < 2 else 1.0)


@kernel
def beams(p, after, action):  # → beam that shows the target or −1, what it shows; what the others show, and their σ
    dx, dy = after[X] - after[OWN_X], after[Y] - after[OWN_Y]
    shown = action == PING or math.hypot(dx, dy) <= p.passive_radius
    beam = (math.ceil(4.0 * math.atan2(dy, dx) / math.pi) - 1) % 8 if shown else -1
    return beam, math.hypot(dx, dy), 20.0 if action == PING else p.passive_radius, 0.5 if action == PING else 5.0


@kernel
def observe(p, after, action, seen, rng):
    beam, distance, other, sigma = beams(p, after, action)
    for k in range(8):
        seen[k] = (distance if k == beam else other) + (0.5 if k == beam else sigma) * rng.standard_normal()


@kernel
def likelihood(p, after, action, seen):
    beam, distance, other, sigma = beams(p, after, action)
    squares = 0.0
    for k in range(8):
        squares += ((seen[k] - (distance if k == beam else other)) / (0.5 if k == beam else sigma)) ** 2
    return math.exp(-0.5 * squares) / (sigma if beam < 0 else 0.5)  # up to what all states have in common


@kernel
def rollout_action(p, state, rng):
    dx, dy = state[X] - state[OWN_X], state[Y] - state[OWN_Y]
    if math.hypot(dx, dy) <= 2.0:
        return ENGAGE
    return (1 if dx > 0.0 else 3) if abs(dx) > abs(dy) else (0 if dy > 0.0 else 2)


@kernel
def reinvigorate(p, state, seen, redrawn, rng):
    redrawn[:] = state
    redrawn[X], redrawn[Y] = 1.0 + int(20 * rng.random()), 1.0 + int(20 * rng.random())
    redrawn[GOAL] = int(4 * rng.random())


model = Pomdp("sub_hunt", 6, 8, 6, 0.99, Parameters(), initial, step, observe, likelihood, rollout_action, reinvigorate)


def episode(seed, options):
    rng = np.random.default_rng(seed)
    belief = ParticleBelief(model, options.particles, rng)
    return play(model, belief, Planner(model, options, rng), rng, moves=100).value


if __name__ == "__main__":
    check_model(model)
    options = PlannerOptions(exploration=100.0)
    values = [episode(seed, options) for seed in range(int(sys.argv[1]))]
    print(f"{np.mean(values):.1f} ± {np.std(values, ddof=1) / math.sqrt(len(values)):.1f}")
