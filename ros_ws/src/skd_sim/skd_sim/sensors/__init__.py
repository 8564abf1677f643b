"""What the car perceives of its surroundings."""

from skd_sim.sensors.laser import PlanarLaser, make_laser
from skd_sim.sensors.scan import Scan

__all__ = ["PlanarLaser", "Scan", "make_laser"]
