"""A scenario as a picture from above: who starts where, and the ways that its protocol prescribes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from skd_sim.arrays import FloatArray

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from skd_sim.scenario.protocol import time_of_meeting
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.state import Trajectory

from skd_evaluator import palette
from skd_evaluator.report.scenery import car_outline, draw_car, draw_ghosts, draw_road
from skd_evaluator.saved_picture import save_picture

_DPI = 110
_BESIDE = 2.0  # m that are shown beside everything
_AFTER = 1.0  # s of a way that are shown after the unbraked car is there
_LANE = 150.0  # m of the lane that are drawn to each side of the crossing
_LONGEST, _WIDEST = 9.0, 6.0  # inches of the view
_LEGEND = 5.6  # inches that the longest line of the legend takes


def save_scenario(path: Path, scenario: Scenario, ways: Sequence[Trajectory]) -> None:
    """Save the picture of a scenario as a PNG file.

    Args:
        path: of the file.
        scenario: to be drawn.
        ways: of its protocol's target, one for each impact place; none where it has no protocol.
    """
    car, adversary = scenario.car, scenario.adversary
    start = -car.start_gap - 0.5 * car.start_gap_range - car.front
    meets = start + car.start_speed * time_of_meeting(scenario) if ways else -car.front  # by its front
    body = adversary.outline_at(_first(scenario, ways), adversary.first_heading)
    cars = [car_outline(scenario, along) for along in (start, meets, -car.front)]
    box = _extent(scenario, [*cars, body, *_near(scenario, ways)])
    size = np.array([box[1] - box[0], box[3] - box[2]])
    width, height = size * min(_WIDEST / size[0], _LONGEST / size[1])
    figure = Figure(figsize=(max(_LEGEND, width + 1.2), max(3.0, height + 2.5)), layout="constrained")
    axes = figure.subplots()
    draw_road(axes, scenario, -_LANE, _LANE)
    draw_car(axes, scenario, start, "car under test at the start")
    told = (
        "car under test when it reaches the target's way, unbraked" if ways else "car under test at the crossing line"
    )
    draw_ghosts(axes, scenario, np.array([meets]), told)
    _draw_ways(axes, scenario, ways)
    axes.add_patch(
        Polygon(body, fc=palette.KAMIKAZE, ec="black", zorder=7, label=f"adversary ({adversary.kind}) at the start")
    )
    axes.set_xlim(box[0], box[1])
    axes.set_ylim(box[2], box[3])
    axes.set_aspect("equal")
    axes.set_xlabel("x, East (m)")
    axes.set_ylabel("y, North (m)")
    axes.set_title(f"{scenario.name}, {3.6 * car.start_speed:.0f} km/h", fontsize=10, parse_math=False)
    figure.legend(loc="outside lower center", ncols=1, frameon=False, fontsize=8)
    save_picture(figure, path, _DPI)


def _first(scenario: Scenario, ways: Sequence[Trajectory]) -> FloatArray:
    """Return where the adversary starts, m: on the middle way of the protocol, if there is one."""
    if ways:
        return np.asarray(ways[(len(ways) - 1) // 2].positions[0])
    return np.array([scenario.adversary.start_x, scenario.adversary.start_y])


def _near(scenario: Scenario, ways: Sequence[Trajectory]) -> list[FloatArray]:
    """Return the parts of ways until just after the unbraked car is there."""
    return [way.positions[: 2 + int((time_of_meeting(scenario) + _AFTER) / scenario.time_step)] for way in ways]


def _draw_ways(axes: Axes, scenario: Scenario, ways: Sequence[Trajectory]) -> None:
    """Draw the way to each impact place, with a dot each tick, and where its target is when the car meets it."""
    label: str | None = "ways of the protocol's target to each impact place, a dot each tick"
    reached: str | None = "target at that moment"
    for way, colour in zip(ways, palette.ordered(max(1, len(ways))), strict=False):
        axes.plot(*way.positions.T, color=colour, lw=1.0, marker=".", ms=4, zorder=5, label=label)
        ticks = scenario.time_step * np.arange(len(way))
        place = [float(np.interp(time_of_meeting(scenario), ticks, way.positions[:, axis])) for axis in (0, 1)]
        axes.plot(*place, color=colour, marker="D", ms=5, mec="black", mew=0.6, ls="none", zorder=8, label=reached)
        label = reached = None


def _extent(scenario: Scenario, shapes: Sequence[FloatArray]) -> tuple[float, float, float, float]:
    """Return what the picture shows: x from and to, y from and to, m."""
    parked = [obstacle.corners for obstacle in scenario.obstacles]
    first = zip(scenario.others, scenario.others_at(0), strict=True)
    others = [other.outline_at(np.array(state[:2]), state.heading) for other, state in first]
    points = np.concatenate([*shapes, *parked, *others])
    low, high = points.min(axis=0) - _BESIDE, points.max(axis=0) + _BESIDE
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])
