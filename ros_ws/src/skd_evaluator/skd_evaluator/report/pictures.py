"""Pictures: the paper's figure, and an assessment's trajectories seen from above."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")

from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from skd_sim.encounter.road import Road, right_and_along, road_pose
from skd_sim.encounter.scenario import Scenario
from skd_sim.trajectory import FloatArray

from skd_evaluator.campaign.assessment import Assessment
from skd_evaluator.campaign.plan import KamikazeSet
from skd_evaluator.campaign.rating import Rating
from skd_evaluator.report.terminal import car_name

SAFE_COLOUR, KAMIKAZE_COLOUR, CAR_COLOUR, ROAD_COLOUR = "#1b7837", "#d6604d", "#4a6fa5", "#e8e8e8"
KIND_STYLE = {"synthetic": ("#2166ac", "o"), "recorded": ("#b2182b", "s")}
DPI = 150
_APPROACH, _LANE_SHOWN = 10.0, 80.0  # m of a curved lane that are in the picture at least, and that are drawn
PANELS = 6
"""Most φ that one picture shows."""


def _error_bars(axes: Axes, rows: Sequence[Mapping[str, Any]], value: str, interval: str, scale: float) -> None:
    for kind in dict.fromkeys(row["kind"] for row in rows):
        mine = [row for row in rows if row["kind"] == kind and row[value] is not None]
        if not mine:
            continue
        x = np.array([row["multiplier"] for row in mine])
        y = scale * np.array([row[value] for row in mine])
        ends = scale * np.array([row[interval] or (row[value], row[value]) for row in mine])
        colour, marker = KIND_STYLE.get(kind, ("#555555", "^"))
        errors = np.maximum(0.0, np.abs(ends.T - y))
        axes.errorbar(x, y, errors, label=f"{kind} φ", color=colour, marker=marker, ms=4.5, capsize=2.5, lw=1.4)
    axes.set_xlabel("multiplier C of the basic controller")
    axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False)


def save_sweep(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Save deformation, SKD and collision rate against C, with 95 % intervals; the paper's figure has the last two."""
    figure = Figure(figsize=(14.0, 4.2), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    _error_bars(left, rows, "deformation", "deformation_ci95", 1.0)
    left.set_ylabel("mean deformation (m)")
    left.set_title("(a) Deformation, 95 % interval over attempts", loc="left")
    _error_bars(middle, rows, "skd", "skd_ci95", 1.0)
    middle.set_ylabel("Safe-Kamikaze Distance (m)")
    middle.set_title("(b) SKD, 95 % interval over pairs", loc="left")
    _error_bars(right, rows, "collision_rate", "collision_rate_ci95", 100.0)
    right.set_ylabel("collision rate along φ (%)")
    right.set_ylim(-2.0, 102.0)
    right.set_title("(c) Collision rate, 95 % Wilson interval", loc="left")
    figure.savefig(path, dpi=DPI)


def _draw_road(axes: Axes, road: Road, low: float, high: float) -> None:
    edges = [road.edge(side, low, high) for side in (-1.0, 1.0)]
    axes.add_patch(Polygon(np.concatenate([edges[0], edges[1][::-1]]), fc=ROAD_COLOUR, ec="none", zorder=0))
    for edge in edges:
        axes.plot(*edge.T, color="#999999", lw=1.0, zorder=1)


def _car_outline(scenario: Scenario, along: float) -> FloatArray:
    """Return the corners of the car (4 × 2, m) with its reference point at a path coordinate (m)."""
    car = scenario.car
    x, y, heading = road_pose(scenario.road.line, along)
    cos, sin = math.cos(heading), math.sin(heading)
    ahead, left = np.array([cos, sin]), np.array([-sin, cos])
    corners = [(car.front, 1), (-car.rear, 1), (-car.rear, -1), (car.front, -1)]
    return np.array([np.array([x, y]) + a * ahead + b * car.half_width * left for a, b in corners])


def _draw_car(axes: Axes, scenario: Scenario, along: float, label: str, alpha: float) -> None:
    outline = Polygon(_car_outline(scenario, along), fc=CAR_COLOUR, ec="black", alpha=alpha, zorder=2, label=label)
    axes.add_patch(outline)


def _kamikaze_label(groups: Sequence[KamikazeSet], shown: int) -> str:
    most = max(len(group.logs) for group in groups)
    return f"kamikaze ψ, ending at ×; {shown} of {most}" if most > shown else "kamikaze ψ, ending at ×"


def _shortened(name: str, length: int) -> str:
    """Return a name with its middle left out where it is longer than `length`."""
    if len(name) <= length:
        return name
    kept = max(2, length - 1)
    return f"{name[: kept // 2]}…{name[-(kept - kept // 2) :]}"


def _figures(rating: Rating, assessment: Assessment, deformation: float | None, skd: float | None) -> str:
    """Return those of two means of an assessment (m) that are the car's own; others are of no use beside these."""
    alone = len(rating.assessments) == 1
    shown = []
    if deformation is not None and (alone or assessment is not rating.for_skd):
        shown.append(f"D {deformation:.2f} m")
    if skd is not None and (alone or assessment is not rating.for_deformation):
        shown.append(f"SKD {skd:.2f} m")
    return ", ".join(shown)


def _panel_figure(rating: Rating, assessment: Assessment, number: int) -> str:
    """Return what the kamikazes of a φ came to, in a few words."""
    group = assessment.kamikaze[number]
    if not group.logs:
        return f"{group.aborted} of {group.attempts} aborted" if group.aborted else "no kamikaze"
    deformation = assessment.deformation.per_safe_trajectory[number].mean
    figures = _figures(rating, assessment, deformation, assessment.skd.per_safe_trajectory[number].mean_distance)
    return f"{figures}, {group.failed} failed" if group.failed else figures


def _heading(rating: Rating, assessment: Assessment) -> str:
    """Return which car this is, and what the kamikazes came to over all φ."""
    plan = assessment.plan
    car = car_name({"controller": plan.controller, "multiplier": plan.multiplier})
    figures = _figures(rating, assessment, assessment.deformation.mean, assessment.skd.skd)
    explained = figures.replace("D ", "deformation D ", 1) if figures.startswith("D ") else figures
    return f"{car}: {explained or 'no kamikaze'} (kamikazes of objective {plan.objective})"


def save_trajectories(path: Path, rating: Rating, assessment: Assessment, shown: int = 40) -> None:
    """Save φ and its kamikaze trajectories seen from above, one panel per φ, with lane and car.

    Args:
        path: of the picture.
        rating: of the car.
        assessment: the one of its assessments that is to be drawn.
        shown: kamikaze trajectories per φ at the most; more would only blacken the panel.
    """
    scenario = assessment.plan.scenario
    groups = assessment.kamikaze[:PANELS]
    everything = [group.safe_trajectory.positions for group in groups] + [
        log.trajectory.positions for group in groups for log in group.logs[:shown]
    ]
    road = scenario.road
    if not road.straight:  # where the car comes from and goes to is not below and above the crossing
        everything += [_car_outline(scenario, along) for along in (-_APPROACH, 0.0)]
        everything += [_car_outline(scenario, log.last_car_position) for group in groups for log in group.logs[:shown]]
    points = np.concatenate(everything)
    starts = [right_and_along(road.line, log.car[:1, :2])[0, 1] for group in groups for log in group.logs[:shown]]
    low = min(points[:, 1].min() - 1.0, -6.0)
    high = max(points[:, 1].max() + 1.0, 1.5)
    left, right = points[:, 0].min() - 0.8, max(points[:, 0].max() + 0.8, 0.6 * scenario.road.lane_width)
    columns = min(3, len(groups))
    lines = -(-len(groups) // columns)
    aspect = (high - low) / (right - left)
    width = max(1.8, min(4.2, 6.0 / aspect))
    # Around the panels: title and axis labels of each row, the heading and the legend.
    size = (max(6.0, columns * width + 0.8), lines * (min(width * aspect, 9.0) + 0.65) + 0.85)
    fitting = max(16, int(11 * size[0] / columns))  # characters of a title
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for panel in panels[len(groups) :]:
        panel.set_visible(False)
    for number, (panel, group) in enumerate(zip(panels, groups, strict=False)):
        _draw_road(panel, road, *((low, high) if road.straight else (-_LANE_SHOWN, _LANE_SHOWN)))
        if group.logs:
            impacts = [log.last_car_position for log in group.logs[:shown]]
            _draw_car(panel, scenario, float(np.median(impacts)), "car, median at impact", 0.45)
        for index, log in enumerate(group.logs[:shown]):
            x, y = log.trajectory.positions.T
            panel.plot(
                x,
                y,
                color=KAMIKAZE_COLOUR,
                lw=0.8,
                alpha=0.45,
                zorder=3,
                label=_kamikaze_label(groups, shown) if index == 0 else None,
            )
            panel.plot(x[-1], y[-1], "x", color=KAMIKAZE_COLOUR, ms=4, alpha=0.7, zorder=4)
        outlines = [scenario.pedestrian.outline(log.trajectory.positions) for log in group.logs[:shown]]
        panel.add_collection(PolyCollection(outlines, fc="none", ec=KAMIKAZE_COLOUR, lw=0.6, alpha=0.45, zorder=4))
        x, y = group.safe_trajectory.positions.T
        panel.plot(x, y, color=SAFE_COLOUR, lw=1.8, marker=".", ms=5, zorder=5, label="safe φ")
        mean = _panel_figure(rating, assessment, number)
        panel.set_title(
            f"{_shortened(group.safe_trajectory.name, fitting - len(mean) - 2)}: {mean}", fontsize=9, parse_math=False
        )
        panel.set_xlim(left, right)
        panel.set_ylim(low, high)
        panel.set_aspect("equal")
    for row in range(lines):
        panels[row * columns].set_ylabel("y, North (m)")
    for panel in panels[max(0, len(groups) - columns) : len(groups)]:
        panel.set_xlabel("x, East (m)")
        panel.xaxis.set_tick_params(labelbottom=True)
    entries: dict[str, Any] = {}
    for panel in panels[: len(groups)]:  # the first may have no kamikaze trajectory
        entries = {**dict(zip(*reversed(panel.get_legend_handles_labels()), strict=True)), **entries}
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    total = len(assessment.kamikaze)
    which = f" (first {len(groups)} of {total} φ)" if total > len(groups) else ""
    start = ""
    if starts and road.straight:
        start = f"; the car comes from the South, from y ≈ {np.mean(starts):.1f} m".replace("-", "−")
    elif starts:
        start = f"; the car comes along the lane, from ≈ {-np.mean(starts):.1f} m before the crossing"
    lost = len(rating.reasons)
    aborted = f"{lost} of {rating.episodes} episodes aborted\n" if lost else ""
    figures = f"{_heading(rating, assessment)}\n"
    figure.suptitle(
        f"{aborted}{figures}Seen from above{which}{start}", fontsize=10, color="#b2182b" if lost else "black"
    )
    figure.savefig(path, dpi=DPI)
