"""One sweep of a planar laser scanner: what sensor_msgs/LaserScan carries, without anything of ROS."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatRanges = NDArray[np.float32]


class Scan(NamedTuple):
    """Ranges by bearing, in the frame of the sensor (x ahead, y left); as single precision as on the wire.

    Attributes:
        ranges: range of each beam, m; +inf where nothing came back (REP 117).
        angle_min: bearing of the first beam, rad, counter-clockwise from straight ahead.
        angle_increment: angle between neighbouring beams, rad.
        range_max: greatest range that is measured, m.
    """

    ranges: FloatRanges
    angle_min: float
    angle_increment: float
    range_max: float

    def points(self) -> FloatRanges:
        """Return where something came back: n × 3, m, in the frame of the sensor, in its plane (z = 0)."""
        hit = np.flatnonzero(np.isfinite(self.ranges))
        bearings = self.angle_min + hit * self.angle_increment
        found = np.zeros((len(hit), 3), np.float32)
        found[:, 0] = self.ranges[hit] * np.cos(bearings)
        found[:, 1] = self.ranges[hit] * np.sin(bearings)
        return found
