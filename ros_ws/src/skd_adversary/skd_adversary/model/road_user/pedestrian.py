"""The pedestrian: moves at one speed, or stays (paper, section "Safe Trajectories")."""

from __future__ import annotations

import math
from typing import Any

from skd_sim.compilation import kernel

from skd_adversary.model.parts import RoadUserModel
from skd_adversary.planning.pomdp import FloatArray

# Actions, in the order of the paper
NORTH, SOUTH, EAST, NORTH_EAST, SOUTH_EAST, STAY = range(6)
ACTION_COUNT = 6
AS_PHI = ACTION_COUNT
"""As φ (objective `deformation` only): the displacement that φ makes in the present tick, none after its end."""
_DIAGONAL = math.sqrt(0.5)
DIRECTION_EAST = (0.0, 0.0, 1.0, _DIAGONAL, _DIAGONAL, 0.0)
DIRECTION_NORTH = (1.0, -1.0, 0.0, _DIAGONAL, -_DIAGONAL, 0.0)


@kernel(inline=True)
def action_velocity(action: int, speed: float) -> tuple[float, float]:
    """Return the pedestrian's velocity (East, North), m/s, under an action."""
    return speed * DIRECTION_EAST[action], speed * DIRECTION_NORTH[action]


@kernel(inline=True)
def velocity(parameters: Any, state: FloatArray, action: int) -> tuple[float, float]:
    """Slot `velocity`: whatever the pedestrian did before."""
    return action_velocity(action, parameters.pedestrian_speed)


ROAD_USER = RoadUserModel("pedestrian", ACTION_COUNT, STAY, velocity)
