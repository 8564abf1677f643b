"""Walking a way as people do: from standard normals to places at ticks, compiled.

The normals of a crossing have names. One each for the person: `start` (when somebody sets off), `pace` (how fast the
person walks), `heading` (which way, beside the one intended) and `unrest` (how much the pace changes on the way). Then
five for each tick: `pace`, `turn` and `doubt` drive three processes with a memory: the logarithm of the pace and the
direction (Ornstein and Uhlenbeck 1930), and, smoother, the doubt that makes a person slow down, and stop, beyond a
threshold; `along` and `across` are sway. A scale multiplies every normal. What follows is continuous in them, so that
nearby normals are nearby crossings.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from skd_sim.arrays import FloatArray
from skd_sim.kernels.compilation import kernel

OF_PERSON: Final = ("start", "pace", "heading", "unrest")
OF_TICK: Final = ("pace", "turn", "doubt", "along", "across")
FASTEST: Final = 12.0
"""m/s; nobody has run faster (model/road_user/pedestrian.py)."""
_PERSON, _TICK = len(OF_PERSON), len(OF_TICK)
_STEEPEST = 0.5 * math.pi


def normals_of(ticks: int) -> int:
    """Return how many normals a crossing of so many ticks at most is made of."""
    return _PERSON + _TICK * ticks


@kernel
def _place(path: FloatArray, moment: float) -> tuple[float, float]:
    """Return where a way is at a moment in ticks, linear between its points and at its end after it."""
    last = path.shape[0] - 1
    if moment >= last:
        return path[last, 0], path[last, 1]
    index = int(moment)
    share = moment - index
    return (
        path[index, 0] + share * (path[index + 1, 0] - path[index, 0]),
        path[index, 1] + share * (path[index + 1, 1] - path[index, 1]),
    )


@kernel
def smooth(now: float, past: float, keep: float, normal: float, tick: int) -> float:
    """Return the next value of a stationary process of variance 1 and of second order, both roots alike.

    It has a velocity: nobody stops at once, as a process of first order would have it.
    """
    if tick == 0:
        return normal
    square = keep * keep
    if tick == 1:
        like = 2.0 * keep / (1.0 + square)
        return like * now + math.sqrt(1.0 - like * like) * normal
    return 2.0 * keep * now - square * past + math.sqrt((1.0 - square) ** 3 / (1.0 + square)) * normal


@kernel
def walk(
    path: FloatArray, values: FloatArray, normals: FloatArray, scale: float, time_step: float, way: FloatArray
) -> int:
    """Walk a way as the normals say.

    Args:
        path: the way that is intended, at ticks, n × 2, m.
        values: parameters of the behaviour model, in the order of `MEANINGS`.
        normals: standard normals, `normals_of(ticks)`.
        scale: by which they are multiplied.
        time_step: duration of a tick, s.
        way: (ticks + 1) × 2, m; is filled with the places at ticks.

    Returns:
        How many places there are: as far as the way's end, or all.
    """
    (start_delay, pace, heading, unrest, pace_noise, pace_time, turn, turn_time, threshold, depth, doubt_time, sway) = (
        values[0], values[1], values[2], values[3], values[4], values[5],
        values[6], values[7], values[8], values[9], values[10], values[11],
    )  # fmt: skip
    ticks: int = way.shape[0] - 1
    last = path.shape[0] - 1.0
    delay = scale * start_delay * normals[0] / time_step
    own_pace = scale * pace * normals[1]
    own_heading = scale * heading * normals[2]
    restless = math.exp(scale * unrest * normals[3])
    keep_pace, keep_turn = math.exp(-time_step / pace_time), math.exp(-time_step / turn_time)
    keep_doubt = math.exp(-time_step / doubt_time)
    new_pace, new_turn = math.sqrt(1.0 - keep_pace * keep_pace), math.sqrt(1.0 - keep_turn * keep_turn)
    moment = min(max(0.0, -delay), last)  # who sets off early is already on the way
    x, y = _place(path, moment)
    on_x, on_y = x, y
    way[0, 0], way[0, 1] = x, y
    now_pace = now_turn = now_doubt = past_doubt = 0.0
    for tick in range(ticks):
        first = _PERSON + _TICK * tick
        if tick == 0:
            now_pace, now_turn = normals[first], normals[first + 1]
        else:
            now_pace = keep_pace * now_pace + new_pace * normals[first]
            now_turn = keep_turn * now_turn + new_turn * normals[first + 1]
        now_doubt, past_doubt = smooth(now_doubt, past_doubt, keep_doubt, normals[first + 2], tick), now_doubt
        off = min(max(tick + 1.0 - delay, 0.0), 1.0)  # share of the tick after the start
        slowed = min(max(1.0 - depth * (scale * restless * now_doubt - threshold), 0.0), 1.0)
        passed = off * slowed * math.exp(own_pace + scale * pace_noise * restless * now_pace)
        # At the pace of the intended way here, so that a long step jumps over none of its turns or stops.
        ahead = min(moment + passed, last)
        next_x, next_y = _place(path, ahead)
        step_x, step_y = next_x - on_x, next_y - on_y
        length, longest = math.sqrt(step_x * step_x + step_y * step_y), FASTEST * time_step
        if length > longest:
            ahead = moment + (ahead - moment) * longest / length
            next_x, next_y = _place(path, ahead)
            step_x, step_y = next_x - on_x, next_y - on_y
        turned = min(max(own_heading + scale * turn * now_turn, -_STEEPEST), _STEEPEST)
        cos, sin = math.cos(turned), math.sin(turned)
        x, y = x + cos * step_x - sin * step_y, y + sin * step_x + cos * step_y
        moment, on_x, on_y = ahead, next_x, next_y
        way[tick + 1, 0] = x + scale * sway * normals[first + 3]
        way[tick + 1, 1] = y + scale * sway * normals[first + 4]
        if moment >= last:
            return tick + 2
    return ticks + 1


@kernel
def walk_many(path: FloatArray, values: FloatArray, normals: FloatArray, time_step: float, ways: FloatArray) -> None:
    """Walk one way as each row of normals says; ways are m × (ticks + 1) × 2."""
    for row in range(normals.shape[0]):
        count = walk(path, values, normals[row], 1.0, time_step, ways[row])
        for tick in range(count, ways.shape[1]):
            ways[row, tick, 0], ways[row, tick, 1] = np.nan, np.nan


def walked(path: FloatArray, values: FloatArray, normals: FloatArray, scale: float, time_step: float) -> FloatArray:
    """Return the places at ticks of somebody who walks a way; see `walk`."""
    ticks = (len(normals) - _PERSON) // _TICK
    way = np.empty((ticks + 1, 2))
    count: int = walk(np.ascontiguousarray(path), values, normals, scale, time_step, way)
    return way[:count]
