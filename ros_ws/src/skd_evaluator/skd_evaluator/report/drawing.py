"""What pictures have in common: how they are saved, lanes, and a car on its own."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from skd_sim.arrays import FloatArray
from skd_sim.scenario.road import road_pose
from skd_sim.scenario.scenario import Scenario

from skd_evaluator import palette
from skd_evaluator.metrics.contact_place import outline_of

DPI = 150
PAGE = 7.2
"""Width of a page between its margins, inches: a wider picture is printed smaller, with its type."""
TYPE = 8.0
"""Least size of type in a picture of that width, pt."""


def save_picture(figure: Figure, path: Path, dpi: int = DPI) -> None:
    """Save a picture; a letter that the font lacks is drawn as a box, without a word."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph", UserWarning)
        figure.savefig(path, dpi=dpi)


def draw_road(axes: Axes, scenario: Scenario, low: float, high: float, elapsed: float = 0.0) -> None:
    """Draw the lanes between two path coordinates, m, what is parked, and the others so many seconds after the start.

    Where there are several lanes, arrows on them show which way each is driven.
    """
    for left, right in scenario.road.surfaces(low, high):
        axes.add_patch(Polygon(np.concatenate([left, right[::-1]]), fc=palette.ROAD, ec="none", zorder=0))
        for edge in (left, right):
            axes.plot(*edge.T, color=palette.ROAD_EDGE, lw=1.0, zorder=1)
    for arrow in scenario.road.arrows(low, high):
        axes.add_patch(Polygon(arrow, fc=palette.ROAD_EDGE, ec="none", alpha=0.5, zorder=1))
    for index, obstacle in enumerate(scenario.obstacles):
        label = None if index else "parked"
        axes.add_patch(
            Polygon(obstacle.corners, fc=palette.OBSTACLE, ec=palette.CAR, lw=0.8, hatch="///", zorder=1, label=label)
        )
    for index, (other, state) in enumerate(zip(scenario.others, scenario.others_after(elapsed), strict=True)):
        label = None if index else "others"
        outline = other.outline_at(np.array(state[:2]), state.heading)
        axes.add_patch(Polygon(outline, fc=palette.OBSTACLE, ec="black", lw=0.8, zorder=3, label=label))
        if not other.stands:
            way = np.array([[point.x, point.y] for point in other.way])
            axes.plot(*way.T, color=palette.CAR, lw=0.8, ls=":", zorder=1)


def front_band(scenario: Scenario, along: float, reach: float) -> FloatArray:
    """Return the corners (4 × 2, m) of a band across the lane about the front of a car at a path coordinate (m).

    It reaches so far to the front and to the rear, m, and a little beyond the car's sides.
    """
    car = scenario.car
    x, y, heading = road_pose(scenario.road.line, along)
    ahead = np.array([math.cos(heading), math.sin(heading)])
    left = (car.half_width + 0.15) * np.array([-ahead[1], ahead[0]])
    middle = np.array([x, y]) + car.front * ahead
    return np.array([middle + a * reach * ahead + b * left for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))])


def draw_car(
    axes: Axes, scenario: Scenario, pose: Sequence[float], label: str | None = None, alpha: float = 0.6
) -> Polygon:
    """Draw the car at a pose, and return it."""
    outline = Polygon(outline_of(scenario, pose), fc=palette.CAR, ec="black", alpha=alpha, zorder=2, label=label)
    axes.add_patch(outline)
    return outline


def draw_before(
    axes: Axes, scenario: Scenario, poses: FloatArray, label: str | None = None, *, whole: bool = False
) -> None:
    """Draw where the car was before (poses, n × 3), as lines across its front, or `whole` as outlines."""
    for index, pose in enumerate(poses.tolist()):
        outline = outline_of(scenario, pose)
        places = np.concatenate([outline, outline[:1]]) if whole else outline[[0, 3]]
        said = label if index == 0 else None
        axes.plot(*places.T, color=palette.CAR, lw=1.0, ls=(0, (3, 2)), zorder=2, label=said)


def write_time(axes: Axes, time: float, place: FloatArray, colour: str, offset: tuple[float, float]) -> None:
    """Write a time (s) beside a place (m), so many points away from it."""
    axes.annotate(
        f"{time:.1f} s", (place[0], place[1]), xytext=offset, textcoords="offset points", fontsize=TYPE, color=colour,
        zorder=6, ha="left" if offset[0] else "center",
        va="center" if offset[0] else "top" if offset[1] < 0 else "bottom",
        bbox={"fc": "white", "ec": "none", "alpha": 0.6, "pad": 0.5}, clip_on=True,
    )  # fmt: skip


def extent_of(*shapes: FloatArray, beside: float) -> tuple[float, float, float, float]:
    """Return what a picture of shapes (n × 2, m) shows, with so many m beside it: x from and to, y from and to, m."""
    points = np.concatenate(shapes)
    (left, low), (right, high) = points.min(axis=0) - beside, points.max(axis=0) + beside
    return float(left), float(right), float(low), float(high)


def set_extent(axes: Axes, box: tuple[float, float, float, float]) -> None:
    """Let axes show a part of the ground, to scale, with its names."""
    axes.set_xlim(*box[:2])
    axes.set_ylim(*box[2:])
    axes.set_aspect("equal")
