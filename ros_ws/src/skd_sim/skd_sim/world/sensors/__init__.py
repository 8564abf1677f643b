"""What the car perceives of its surroundings, and of itself."""

from skd_sim.world.sensors.imu import Inertia, InertialUnit
from skd_sim.world.sensors.laser import PlanarLaser, make_laser
from skd_sim.world.sensors.scan import Scan

__all__ = ["Inertia", "InertialUnit", "PlanarLaser", "Scan", "make_laser"]
