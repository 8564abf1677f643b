"""What the adversary of the margin can do in a tick, its moves, and for which cars it is known what they answer.

A pedestrian takes the planner's six actions (moves 0 … 5), goes as φ (move 6, `AS_PHI`) or takes one of the five
directions at half speed (moves 7 … 11). As φ is the displacement that φ makes in the tick, none after φ's end, whatever
its pace: somebody has walked so.

A road user with a state of its own, as the cyclist, has its own actions from that state, at no half speed, for its
speed is part of the state; as φ it goes as far as it can from there, as a planned kamikaze does.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from skd_adversary.crossing.interfaces import path_velocity
from skd_adversary.crossing.model import choices
from skd_adversary.crossing.road_users import ACTION_COUNT, AS_PHI, PEDESTRIAN, STAY, action_velocity, road_user_named
from skd_sim.kernels.compilation import kernel
from skd_sim.options.car_and_adversary import DYNAMICS, CarUnderTest
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeSpec, Mode
from skd_sim.world.state import FloatArray

FIRST_HALF: Final = AS_PHI + 1
"""Way FIRST_HALF + a is action a at half speed."""
MOVE_COUNT: Final = FIRST_HALF + STAY
"""Of a pedestrian: 12."""
HALF: Final = 0.5
"""Of the full speed, of a road user that hesitates."""

assert STAY == ACTION_COUNT - 1  # all actions but the last have a direction, and so a half speed


@kernel(inline=True)
def move_velocity(move: int, path: FloatArray, tick: int, time_step: float, speed: float) -> tuple[float, float]:
    """Return the velocity (East, North), m/s, of a move of a pedestrian who crosses to the right.

    Args:
        move: number of the move, 0 … MOVE_COUNT − 1.
        path: φ, n × 2, m.
        tick: number of the tick in which the move is taken, ≥ 0.
        time_step: duration of a tick, s.
        speed: speed of the pedestrian, m/s.
    """
    if move == AS_PHI:
        return path_velocity(path, tick, time_step)
    if move > AS_PHI:
        return action_velocity(move - FIRST_HALF, HALF * speed)
    return action_velocity(move, speed)


def velocities(scenario: Scenario, path: FloatArray, tick: int, walked: FloatArray | None = None) -> FloatArray:
    """Return the velocities of all moves in a tick.

    Args:
        scenario: names the road user and its speed.
        path: φ, n × 2, m.
        tick: number of the tick, ≥ 0.
        walked: where the adversary has been at ticks 0 … tick, (tick + 1) × 2, m; a pedestrian's velocities do not
            depend on it.

    Returns:
        k × 2, (East, North), m/s; of a pedestrian k is MOVE_COUNT. Several may be the same.

    Raises:
        ValueError: where a road user with a state of its own has been is not given, or not for as many ticks.
    """
    step = scenario.time_step
    user = road_user_named(scenario.adversary.kind)
    if user is PEDESTRIAN:
        speed = scenario.adversary.speed
        found = np.array([move_velocity(move, path, tick, step, speed) for move in range(MOVE_COUNT)])
        found[np.arange(MOVE_COUNT) != AS_PHI, 0] *= scenario.end.crossing
        return found
    if walked is None or len(walked) != tick + 1:
        raise ValueError(f"what a {user.name} can do at tick {tick} depends on the {tick + 1} places where it has been")
    so_far = np.vstack([walked, walked[-1:]])
    return choices(user, scenario, path, so_far)[tick, :, 0]


def has_exact_margin(car: CarUnderTest, scenario: Scenario) -> bool:
    """Tell whether it is known what a car answers to every sequence of actions."""
    return not why_not_exact(car, scenario)


def why_not_exact(car: CarUnderTest, scenario: Scenario) -> str:
    """Return for what no margin is exact, in a few words; empty where it is.

    It is for the basic car, deciding once a tick, on a straight road and beside a pedestrian that is a disc, with no
    obstacles and others, that crosses to the right.
    """
    adversary, end = scenario.adversary, scenario.end
    reasons = {
        f"of controller {car.controller}": not car.is_known,
        f"with car.dynamics {scenario.car.dynamics}": not DYNAMICS[scenario.car.dynamics].known,
        "on a road with curves": not scenario.road.straight,
        f"with adversary.kind {adversary.kind}": adversary.is_box or road_user_named(adversary.kind) is not PEDESTRIAN,
        "beside obstacles": bool(scenario.obstacles),
        "beside others": bool(scenario.others),
        "where the adversary does not cross to the right, or has an ending of its own": end.crossing < 0.0
        or scenario.ending is not None,
        "of a car that decides more often than once a tick": scenario.control_periods != 1,
    }
    return next((reason for reason, is_so in reasons.items() if is_so), "")


def require_exact(episode: EpisodeSpec) -> None:
    """Refuse an episode of which it is not known what each sequence of actions would have led to.

    Raises:
        ValueError: it is not in kamikaze mode, or its margin not exact.
    """
    why = why_not_exact(episode.car, episode.scenario)
    if not why and (episode.mode != Mode.KAMIKAZE or episode.safe_trajectory is None):
        why = f"in mode {episode.mode.name}"
    if why:
        raise ValueError(f"no margin is exact {why}")
