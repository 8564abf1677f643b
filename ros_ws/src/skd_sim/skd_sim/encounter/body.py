"""The body of a road user: a disc, or a box that points the way it moves, and of which kind it is."""

from __future__ import annotations

import math
import re

import numpy as np

from skd_sim.arrays import FloatArray
from skd_sim.encounter.unchanging import Unchanging
from skd_sim.errors import UsageError

HEIGHT = 1.8
"""How high a road user is drawn, m; nothing but pictures and boxes in messages depends on it."""

_KIND = re.compile(r"[a-z][a-z0-9_]*")


class Body(Unchanging):
    """What the adversary and the others of a scenario have in common.

    Attributes:
        radius: radius of a disc, m; a box has none.
        length: length of a box along the way that it moves, m; a disc has none.
        width: width of a box, m; a disc has none.
        kind: kind of road user, such as pedestrian or car.
        start_heading: where a box points before it moves, rad, counter-clockwise from East.
    """

    __slots__ = ()
    radius: float | None
    length: float | None
    width: float | None
    kind: str
    start_heading: float | None

    @property
    def first_heading(self) -> float:
        """Where a box points before it moves, rad: to the East, unless it says otherwise; a disc points nowhere: 0."""
        return 0.0 if self.start_heading is None or not self.is_box else self.start_heading

    @property
    def is_box(self) -> bool:
        """Whether it is a box; a disc if not."""
        return self.radius is None

    @property
    def reach(self) -> float:
        """Distance from its centre to its furthest point, m: a disc's radius, or half of a box's diagonal."""
        if self.radius is not None:
            return self.radius
        return 0.5 * math.hypot(self.length or 0.0, self.width or 0.0)

    @property
    def core(self) -> float:
        """Radius of the largest disc about its centre that lies within it, m; it cannot pass through an obstacle."""
        return self.radius if self.radius is not None else 0.5 * min(self.length or 0.0, self.width or 0.0)

    @property
    def shape(self) -> tuple[float, float, float]:
        """Radius, half length, half width (m), as `geometry.contact` takes them; of a disc the last two are 0."""
        if self.radius is not None:
            return self.radius, 0.0, 0.0
        return 0.0, 0.5 * (self.length or 0.0), 0.5 * (self.width or 0.0)

    def heading(self, before: float, vx: float, vy: float) -> float:
        """Return where it points (rad) while it moves at a velocity (m/s); a disc points nowhere: 0.

        Args:
            before: heading before, rad; it is kept while the body stands.
            vx: velocity to the East, m/s.
            vy: velocity to the North, m/s.
        """
        if not self.is_box or vx == vy == 0.0:
            return before
        return math.atan2(vy, vx)

    def outline(self, positions: FloatArray) -> FloatArray:
        """Return its outline after a way, as a polygon: k × 2, m.

        Args:
            positions: places of its centre so far, n × 2 with n ≥ 1, m; a box points along its last move.
        """
        return self.outline_at(positions[-1], self.last_heading(positions))

    def outline_at(self, place: FloatArray, heading: float) -> FloatArray:
        """Return its outline at a place (x, y), m, where a box has a heading (rad), as a polygon: k × 2, m."""
        radius, half_length, half_width = self.shape
        if radius > 0.0:
            angles = np.linspace(0.0, 2.0 * math.pi, 33)[:-1]
            return np.asarray(place + radius * np.column_stack([np.cos(angles), np.sin(angles)]))
        ahead, left = (
            np.array([math.cos(heading), math.sin(heading)]),
            np.array([-math.sin(heading), math.cos(heading)]),
        )
        corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
        return np.array([place + a * half_length * ahead + b * half_width * left for a, b in corners])

    def last_heading(self, positions: FloatArray) -> float:
        """Return where it points (rad) after a way (n × 2, m)."""
        heading = self.first_heading
        for step in np.diff(positions, axis=0):
            heading = self.heading(heading, float(step[0]), float(step[1]))
        return heading

    def check_body(self, where: str, section: str) -> None:
        """Refuse a body without a shape, or with two.

        Args:
            where: file or other origin, for messages.
            section: name of the scenario's section that describes it, for messages.

        Raises:
            UsageError: names the key.
        """
        given = [key for key in ("length", "width") if getattr(self, key) is not None]
        if self.radius is not None and given:
            raise UsageError(
                f"{where}: {section} has a radius and a {given[0]}; give radius for a disc, or length and width for a "
                "box"
            )
        if self.radius is None and len(given) < 2:
            missing = "width" if given == ["length"] else "length" if given else "radius"
            hint = "a box needs length and width" if given else "of a disc; or length and width, of a box"
            raise UsageError(f"{where}: missing key {section}.{missing} ({hint})")
        if not _KIND.fullmatch(self.kind):
            raise UsageError(
                f"{where}: {section}.kind must be a name of small letters, digits and _, as pedestrian; "
                f"got {self.kind!r}"
            )
