"""The car under test: the protocol that a user's controller fulfils, and the cars that come with SKD."""

from skd_sim.controllers.basic import PAPER_MULTIPLIERS, BasicController, basic_acceleration
from skd_sim.controllers.cal import CalController
from skd_sim.controllers.carla_agent import CarlaAgent
from skd_sim.controllers.loading import make_controller
from skd_sim.controllers.protocol import (
    BatchController,
    Controller,
    SensingController,
    control_period_of,
    is_sensing,
    require_control_period,
    require_sensor,
    sight_of,
    takes_batches,
    takes_scene,
    with_control_period,
)

__all__ = [
    "PAPER_MULTIPLIERS",
    "BasicController",
    "BatchController",
    "CalController",
    "CarlaAgent",
    "Controller",
    "SensingController",
    "basic_acceleration",
    "control_period_of",
    "is_sensing",
    "make_controller",
    "require_control_period",
    "require_sensor",
    "sight_of",
    "takes_batches",
    "takes_scene",
    "with_control_period",
]
