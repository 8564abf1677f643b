"""What a kamikaze wants and plans by: collide, at the least deviation from where φ is at the time.

Until φ's end it moves on, and to wait is to deviate; from then on waiting would be free, so each further step costs
what the predicted car says (`waiting_reward`): a car that stops by a law will not come any more, one that creeps will.

Only a hit by the moving car is rewarded (`Collision.hit_speed`): a touch slower than that ends the episode like a miss.

The deviation of a pair is max over 0 ≤ t ≤ t_c of |ψ(t) − φ(t)|, t_c the time of the contact and φ held at its last
point after its end. Both move uniformly within a tick, and the norm of a linear function is convex, so ticks and
contact suffice. The state carries the greatest distance so far and the tick, so that the return of an episode that ends
in a collision is the collision's reward less its deviation; and there is one more action, *as φ*, for φ has its own
pace. A road user that cannot move so from its state comes as near to it as it can (interface `possible`).

A maximum distance is a budget: a collision at a greater deviation is worth no more than a miss. Who steps
beyond it does so in a tick in which it may meet the car before; if it does not, it goes on as φ does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np
from skd_sim.kernels.compilation import kernel
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import FloatArray, Pair, Triple

from skd_adversary.crossing.interfaces import (
    ADVERSARY_X,
    ADVERSARY_Y,
    AS_PHI,
    CAR_S,
    CAR_SPEED,
    EARLY_ACTIONS,
    LATE_ACTIONS,
    REST,
    ROW,
    SEARCH,
    USER_DIM,
    ObjectiveModel,
    aside,
    contact,
    expected_motion,
    last_changes,
    leads_nowhere,
    left_behind,
    move,
    moving,
    next_possible,
    next_velocity,
    on_road,
    pace_at,
    path_velocities,
    pointing,
    possible,
    steer,
    template,
    to_middle,
    velocity,
)
from skd_adversary.crossing.road_users import EAST, SOUTH

_OWN = 3
"""Length of the state's own part: the greatest squared distance from φ so far (m²), the tick, and the plan that the
default policy follows (0: none), which nothing but that policy reads."""

_EXCESS_COST = -0.1  # m: what it costs to leave the budget in vain, so that it is not done without a gain
_ATTENTION = 8.0  # ticks: the car of the paper that brakes earliest (C = 1.5) does so 6 ticks before it would arrive
_SAME = 1e-9  # m/s
_ERROR = 0.3  # m: about how well the car's place is known when it matters (1 m of noise, some looks)
_LOOKAHEAD = 25  # ticks
_LOOKAHEAD_COLUMNS = 13  # numbers of a tick that is looked ahead: see `_begin_lookahead`
# How a plan ends: in a contact, with φ beyond the path, with the car beyond φ, or not within the look-ahead.
_MET, _LATE, _EARLY, _ONGOING = range(4)


@template
def begin(parameters: Any, state: FloatArray) -> None:
    """Write the objective's own part of a first state, in which the adversary is where φ begins, or near there."""
    dx, dy = state[ADVERSARY_X] - parameters.path[0, 0], state[ADVERSARY_Y] - parameters.path[0, 1]
    state[ROW] = dx * dx + dy * dy
    state[ROW + 1] = 0.0
    state[ROW + 2] = 0.0


@template
def _velocity(parameters: Any, vx: float, vy: float, action: int, tick: int) -> Pair:
    """Return the velocity (East, North), m/s, of a road user that takes an action, or goes as φ, at a tick.

    Args:
        parameters: parameters of the model.
        vx: velocity to the East in the tick before, m/s.
        vy: velocity to the North in the tick before, m/s.
        action: the action.
        tick: number of the tick now.
    """
    if action == AS_PHI:
        phi_x, phi_y = pace_at(parameters.pace, tick)
        return next_possible(parameters, vx, vy, phi_x, phi_y)
    return next_velocity(parameters, vx, vy, action)


@kernel(inline=True)
def _squared_deviation(path: FloatArray, x: float, y: float, tick: int, share: float) -> float:
    """Return the squared distance (m²) from (x, y) to where φ is a share of a tick after a tick."""
    last = path.shape[0] - 1
    begin, end = min(tick, last), min(tick + 1, last)
    dx = x - path[begin, 0] - share * (path[end, 0] - path[begin, 0])
    dy = y - path[begin, 1] - share * (path[end, 1] - path[begin, 1])
    return float(dx * dx + dy * dy)


@template
def _chosen(parameters: Any, state: FloatArray, action: int) -> Pair:
    """Return the velocity (East, North), m/s, of an action of a state."""
    if action == AS_PHI:
        phi_x, phi_y = pace_at(parameters.pace, int(state[ROW + 1]))
        return possible(parameters, state, phi_x, phi_y)
    return velocity(parameters, state, action)


@template
def step(
    parameters: Any, state: FloatArray, action: int, next_state: FloatArray, rng: np.random.Generator
) -> tuple[float, bool]:
    """Generative step: (reward, terminal); ends at a collision, or when there is none to come within the maximum."""
    p = parameters
    tick = int(state[ROW + 1])
    vx, vy = _chosen(p, state, action)
    fraction = move(p, state, vx, vy, next_state, rng)
    hit = fraction <= 1.0
    x, y = next_state[ADVERSARY_X], next_state[ADVERSARY_Y]
    share = 1.0
    if hit:  # ψ ends where they touch
        share = fraction
        x = state[ADVERSARY_X] + share * (x - state[ADVERSARY_X])
        y = state[ADVERSARY_Y] + share * (y - state[ADVERSARY_Y])
    squared = max(state[ROW], _squared_deviation(p.path, x, y, tick, share))
    next_state[ROW] = squared
    next_state[ROW + 1] = state[ROW + 1] + 1.0
    next_state[ROW + 2] = state[ROW + 2]
    cost = p.waiting_reward if tick + 1 >= p.path.shape[0] else 0.0
    limit = p.maximum_distance * p.maximum_distance
    if squared > limit:
        if state[ROW] > limit:  # lost already
            return cost, hit
        return cost + _EXCESS_COST, True
    if hit:
        # Who walks into a car that stands, or nearly so, has not been hit by it, and goes nowhere from there.
        impact = state[CAR_SPEED] + fraction * (next_state[CAR_SPEED] - state[CAR_SPEED])
        return cost + (p.collision_reward - math.sqrt(squared) if impact >= p.hit_speed else 0.0), True
    if leads_nowhere(p, state[ADVERSARY_X], state[ADVERSARY_Y], x, y):
        return cost, True
    passed = left_behind(p, x, y, next_state[CAR_S]) and next_state[CAR_SPEED] > p.adversary_speed
    return cost, passed


@kernel(inline=True)
def _follows(parameters: Any, along: float, worst: float, tick: float) -> bool:
    """Return whether there is nothing to do but as φ: its deviation is too great, or the car is too far away yet.

    That goes by what is known for sure: where the car began at most, and how fast.
    """
    p = parameters
    stride = p.car_start_speed * p.time_step
    nearest = p.car_start_high + p.front + tick * stride
    return bool(worst > p.maximum_distance * p.maximum_distance or along - nearest > _ATTENTION * stride)


@template
def legal(parameters: Any, state: FloatArray, action: int) -> bool:
    """Return whether an action makes sense; as φ always does.

    None but φ's where there is nothing to do, none beyond the path, from where nothing leads back (that the car will be
    met before is seldom worth it, and depends on its model to the decimetre), none into an obstacle, and no
    displacement twice.
    """
    if action == AS_PHI:
        return True
    own_x, own_y = velocity(parameters, state, action)
    p = parameters
    x, y = state[ADVERSARY_X], state[ADVERSARY_Y]
    _, along = on_road(p, x, y)
    if _follows(p, along, state[ROW], state[ROW + 1]):
        return False
    x_after, y_after = x + p.time_step * own_x, y + p.time_step * own_y
    if leads_nowhere(p, x, y, x_after, y_after):
        return False
    phi_x, phi_y = pace_at(p.pace, int(state[ROW + 1]))
    phi_x, phi_y = possible(p, state, phi_x, phi_y)
    return bool(abs(own_x - phi_x) > _SAME or abs(own_y - phi_y) > _SAME)


@template
def _begin_lookahead(parameters: Any, state: FloatArray, car_s: float, worst: float) -> None:
    """Write the first row of `lookahead`: how a plan begins.

    A row is the road user's place (x, y), m; the car's place, m, speed, m/s, and offset, m; the greatest squared
    distance from φ so far, m²; the car's `changes`, as `expected_motion` takes them; how the road user moves, as
    `next_velocity` takes it; its velocity in the tick before, m/s.

    Args:
        parameters: parameters of the model.
        state: state in which the plan begins.
        car_s: path coordinate at which the car's reference point is believed to be, m.
        worst: greatest squared distance from φ so far, m².
    """
    place = state[ADVERSARY_X], state[ADVERSARY_Y]
    changes, own = last_changes(parameters, state), moving(parameters, state)
    car = car_s, state[CAR_SPEED], aside(parameters, state)[0]
    _keep(parameters.lookahead, 0, place, car, worst, changes, own, (0.0, 0.0))


@kernel(inline=True)
def _keep(
    kept: FloatArray, row: int, place: Pair, car: Triple, worst: float, changes: Triple, own: Pair, before: Pair
) -> None:
    """Write a row of `lookahead`; see `_begin_lookahead`."""
    kept[row, 0], kept[row, 1] = place
    kept[row, 2], kept[row, 3], kept[row, 4] = car
    kept[row, 5] = worst
    kept[row, 6], kept[row, 7], kept[row, 8] = changes
    kept[row, 9], kept[row, 10] = own
    kept[row, 11], kept[row, 12] = before


@template
def _look_ahead(
    parameters: Any, state: FloatArray, now: int, switch: int, action: int, bound: float
) -> tuple[float, int, int]:
    """Play a plan against a car without noise: as φ until a tick, and one action from then on.

    What as φ alone leads to is kept in `lookahead`, a row a tick (see `_begin_lookahead`), so that other plans begin
    where they leave it: that one has to be played first.

    Args:
        parameters: parameters of the model.
        state: state in which the plan begins.
        now: number of the tick now.
        switch: tick from which on `action` is taken; `now` if that is as φ.
        action: action that is taken from then on.
        bound: squared distance (m²) from φ from which on the plan is of no interest.

    Returns:
        Squared deviation at the contact (m²), infinity without one; how it ended; the tick in which it did.
    """
    p, kept, row = parameters, parameters.lookahead, switch - now
    x, y = kept[row, 0], kept[row, 1]
    car_s, speed, offset, worst = kept[row, 2], kept[row, 3], kept[row, 4], kept[row, 5]
    if worst >= bound:
        return math.inf, _LATE, switch
    changes, own = (kept[row, 6], kept[row, 7], kept[row, 8]), (kept[row, 9], kept[row, 10])
    before = kept[row, 11], kept[row, 12]
    edge = p.half_width + p.radius
    for tick in range(switch, now + _LOOKAHEAD):
        own = _velocity(p, own[0], own[1], action, tick)
        vx, vy = own
        x_after, y_after = x + p.time_step * vx, y + p.time_step * vy
        if tick == now:  # what it did before, is not known to every model
            before = own
        acceleration, drift, turned = expected_motion(p, state, (x, y), before, own, (car_s, speed, offset), changes)
        before = own
        speed_after = max(0.0, speed + p.time_step * acceleration)
        place = to_middle(p, x, y, car_s, (offset, changes[2]))
        changes = (speed_after - speed, changes[0], turned)
        car_s_after = car_s + 0.5 * p.time_step * (speed + speed_after)
        squared = _squared_deviation(p.path, x_after, y_after, tick, 1.0)
        heading = pointing(p, state, vx, vy)
        place_after = to_middle(p, x_after, y_after, car_s_after, (offset + drift, turned))
        share = contact(p, place, place_after, heading, car_s, car_s_after)
        if share <= 1.0:
            if speed + share * (speed_after - speed) < p.hit_speed:
                return math.inf, _LATE, tick
            x += share * (x_after - x)
            y += share * (y_after - y)
            return max(worst, _squared_deviation(p.path, x, y, tick, share)), _MET, tick
        worst = max(worst, squared)
        if leads_nowhere(p, x, y, x_after, y_after):
            return math.inf, _LATE, tick
        if left_behind(p, x_after, y_after, car_s_after):
            return math.inf, _EARLY, tick
        if worst >= bound:
            return math.inf, _LATE, tick
        if speed_after == 0.0 and vy >= 0.0 and tick + 1 >= p.path.shape[0]:
            across, _ = on_road(p, x_after, y_after)
            if p.crossing * across >= -edge:
                return math.inf, _LATE, tick
        x, y, car_s, speed, offset = x_after, y_after, car_s_after, speed_after, offset + drift
        if action == AS_PHI:
            _keep(kept, tick + 1 - now, (x, y), (car_s, speed, offset), worst, changes, own, before)
    return math.inf, _ONGOING, now


@template
def _coded(switch: int, action: int) -> float:
    """Return a plan, as φ until a tick and one action from then on, as a number; 0 is none."""
    return float((AS_PHI + 1) * switch + action + 1)


@template
def _planned(plan: float, tick: int) -> int:
    """Return a plan's action at a tick."""
    code = int(plan) - 1
    return AS_PHI if code < 0 or tick < code // (AS_PHI + 1) else code % (AS_PHI + 1)


@template
def _plan(parameters: Any, state: FloatArray, worst: float, now: int, rng: np.random.Generator) -> float:
    """Choose when to leave φ's pace, and for what, so that the deviation is least; coded in a number.

    As φ if that meets the car. If not, the later φ is left, the less is the deviation: so the ticks before the one in
    which it failed are tried backwards, until it gets worse. Arguments as in `_look_ahead` and `_begin_lookahead`.

    One that keeps heading or speed also leaves φ early where that neither meets the car nor gets past it within the
    look-ahead, as ahead of it on its lane, and for no hit beyond η_max, which is worth no more than a miss. The
    pedestrian, whose figures stand, leaves φ at once there, and for any hit.
    """
    p = parameters
    car_s = state[CAR_S] + _ERROR * rng.standard_normal()
    _begin_lookahead(p, state, car_s, worst)
    _, how, end = _look_ahead(p, state, now, now, AS_PHI, math.inf)
    if how == _MET:
        return _coded(now + _LOOKAHEAD, AS_PHI)
    nothing = math.inf
    if USER_DIM > 0:
        nothing = p.collision_reward * p.collision_reward
        if how == _ONGOING:
            end = now + _LOOKAHEAD // 2  # the other half is left for the hit
    best = nothing
    across, _ = on_road(p, state[ADVERSARY_X], state[ADVERSARY_Y])
    plan = _coded(now, steer(p, state, SOUTH if p.crossing * across > -0.5 * p.half_width else EAST))
    for back in range(end - now + 1):
        switch = end - back
        found = False
        early = how == _EARLY
        count = AS_PHI if p.evades else len(EARLY_ACTIONS) if early else len(LATE_ACTIONS)
        for choice in range(count):
            action = choice if p.evades else EARLY_ACTIONS[choice] if early else LATE_ACTIONS[choice]
            squared, _, _ = _look_ahead(p, state, now, switch, action, best)
            if squared < best:
                best = squared
                plan = _coded(switch, action)
                found = True
        if best < nothing and not found:
            break
    return plan


@template
def rollout_action(parameters: Any, state: FloatArray, rng: np.random.Generator) -> int:
    """Default policy: plan once, for the car about as it is; anew where that leads beyond the path or nowhere."""
    p = parameters
    tick = int(state[ROW + 1])
    x, y = state[ADVERSARY_X], state[ADVERSARY_Y]
    _, along = on_road(p, x, y)
    if _follows(p, along, state[ROW], state[ROW + 1]):
        return AS_PHI
    action = _planned(state[ROW + 2], tick)
    own_x, own_y = moving(p, state)
    vx, vy = _velocity(p, own_x, own_y, action, tick)
    x_after, y_after = x + p.time_step * vx, y + p.time_step * vy
    leaves = leads_nowhere(p, x, y, x_after, y_after)
    waits_in_vain = action == REST and state[CAR_SPEED] == 0.0
    if leaves or waits_in_vain or state[ROW + 2] == 0.0:
        state[ROW + 2] = _plan(p, state, state[ROW], tick, rng)
        action = _planned(state[ROW + 2], tick)
    return action


def parameters_of(scenario: Scenario, path: FloatArray) -> Mapping[str, Any]:
    """Return φ's velocities, and the rewards: a miss counts as η_max in the mean deviation, which a hit saves."""
    pace = path_velocities(np.asarray(path, dtype=np.float64), len(path) - 1, scenario.time_step)
    return {
        "collision_reward": scenario.eta_max,
        "hit_speed": scenario.collision.hit_speed,
        "pace": pace,
        "lookahead": np.zeros((_LOOKAHEAD + 1, _LOOKAHEAD_COLUMNS)),  # room for `_begin_lookahead`
    }


DEVIATION: Final = ObjectiveModel(
    "deviation",
    1.0,
    replace(SEARCH, exploration=3.0, particles=1000),
    parameters_of,
    step=step,
    rollout_action=rollout_action,
    legal=legal,
    begin=begin,
    own_dim=lambda points: _OWN,
    follows_phi=True,
    plans_deviation=True,
)
