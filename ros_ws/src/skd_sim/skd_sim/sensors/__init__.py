"""What the car perceives of its surroundings, and of itself."""

from skd_sim.sensors.imu import Inertia, InertialUnit
from skd_sim.sensors.laser import PlanarLaser, make_laser
from skd_sim.sensors.scan import Scan

__all__ = ["Inertia", "InertialUnit", "PlanarLaser", "Scan", "make_laser"]
