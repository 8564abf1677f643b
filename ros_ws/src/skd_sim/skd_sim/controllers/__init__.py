"""The car under test: the protocol that a user's controller fulfils, and the cars that come with SKD."""

from skd_sim.controllers.basic import PAPER_MULTIPLIERS, BasicController, basic_acceleration
from skd_sim.controllers.cal import CalController
from skd_sim.controllers.carla_agent import CarlaAgent
from skd_sim.controllers.factory import make_controller
from skd_sim.controllers.protocol import Controller, SensingController, require_sensor

__all__ = [
    "PAPER_MULTIPLIERS",
    "BasicController",
    "CalController",
    "CarlaAgent",
    "Controller",
    "SensingController",
    "basic_acceleration",
    "make_controller",
    "require_sensor",
]
