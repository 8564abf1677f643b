"""Pictures of trajectories: φ, kamikazes and margin trajectories seen from above."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from skd_sim.scenario.road import right_and_along, road_pose
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator import palette
from skd_evaluator.assessment.assessment import Assessment, ObjectiveResult
from skd_evaluator.metrics.contact_place import last_car_position, last_pose, outline_of
from skd_evaluator.metrics.statistics import mean
from skd_evaluator.report import episode_pictures as drawing
from skd_evaluator.report.formats import counted

mpl.use("Agg")


_APPROACH, _LANE_SHOWN = 2.5, 80.0  # m of a lane that are in the picture at least, and of a curved one that are drawn
_LABELLED = 3
"""Ticks between those whose time stands beside φ."""
_BETWEEN = 0.8  # m between two of these times
_HEADING, _NAME = 100, 30  # characters of a line of the heading, and of the name of a φ
PANELS = 6
"""Most φ that one picture shows."""


def save_trajectories(path: Path, assessment: Assessment, result: ObjectiveResult, shown: int = 40) -> None:
    """Save φ and its kamikaze trajectories seen from above, one panel per φ, with lane and car.

    In the picture of the kamikazes that rank the car are the margin trajectories too.

    Args:
        path: file to which the picture is written.
        assessment: assessment of the car.
        result: that of the objective whose kamikazes are drawn.
        shown: greatest number of kamikaze trajectories drawn for each φ; more would only blacken the panel.
    """
    scenario, groups = result.plan.scenario, result.kamikaze[:PANELS]
    least: list[list[Trajectory]] = [[] for _ in groups]
    if assessment.margins is not None and result is assessment.for_deviation:
        for place, hits in enumerate(assessment.margins.hits[: len(groups)]):
            known = sorted((hit for hit in hits if hit is not None), key=lambda hit: hit.distance)
            least[place] = [hit.trajectory for hit in known]
    logs = [group.logs[:shown] for group in groups]
    box = _extent(scenario, [group.safe_trajectory for group in groups], [log for part in logs for log in part], least)
    columns = min(2, len(groups))
    lines = -(-len(groups) // columns)
    width = (drawing.PAGE - 0.7) / 2.0
    height = min(width * (box[3] - box[2]) / (box[1] - box[0]), 4.5)
    # Around the panels: title and axis labels of each row, the heading and the legend.
    figure = Figure(figsize=(drawing.PAGE, lines * (height + 0.65) + 1.45), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for panel in panels[len(groups) :]:
        panel.set_visible(False)
    for place, (panel, group) in enumerate(zip(panels, groups, strict=False)):
        _draw_panel(panel, scenario, group.safe_trajectory, box)
        if logs[place]:
            _draw_approach(panel, scenario, logs[place], box[2])
        elif group.aborted:
            _cross_out(panel, "ABORTED:\nthis says nothing\nabout the car")
        _draw_kamikazes(panel, result, logs[place])
        _draw_walks(
            panel, [one.positions for one in least[place][:shown]], palette.MARGIN,
            "margin trajectory (least deviation that is hit), ending at +", "+", alpha=0.6, lw=0.9, ls=(0, (4, 2)),
            zorder=3.5,
        )  # fmt: skip
        panel.set_title(_panel_title(assessment, result, place, shown), fontsize=drawing.TYPE, parse_math=False)
    for row in range(lines):
        panels[row * columns].set_ylabel("y, North (m)", fontsize=drawing.TYPE)
    for panel in panels[max(0, len(groups) - columns) : len(groups)]:
        panel.set_xlabel("x, East (m)", fontsize=drawing.TYPE)
        panel.xaxis.set_tick_params(labelbottom=True)
    entries: dict[str, Any] = {}
    for panel in panels[: len(groups)]:  # the first may have no kamikaze trajectory
        entries = {**dict(zip(*reversed(panel.get_legend_handles_labels()), strict=True)), **entries}
    below: dict[str, Any] = {"ncols": 2, "frameon": False, "fontsize": drawing.TYPE}
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", **below)
    colour = palette.ALERT if assessment.reasons else "black"
    figure.suptitle(_heading(assessment, result), fontsize=9, parse_math=False, color=colour)
    drawing.save_picture(figure, path)


def _figures(
    assessment: Assessment, result: ObjectiveResult, deviation: float | None, skd: float | None, margin: float | None
) -> str:
    """Return those of three means (m) that are the car's own in this picture; others are of no use beside these."""
    single, ranks = len(assessment.results) == 1, result is assessment.for_deviation
    plans_skd = single or result is not assessment.for_skd
    known = ("margin", margin, ranks), ("planned deviation", deviation, plans_skd), ("SKD", skd, single or not ranks)
    return ", ".join(f"{name} {value:.2f} m" for name, value, own in known if own and value is not None)


def _heading(assessment: Assessment, result: ObjectiveResult) -> str:
    """Return which car this is, what was found over all φ, and what the picture shows."""
    plan, scenario = result.plan, result.plan.scenario
    car = plan.car.label
    margin = None if assessment.margins is None else assessment.margins.mean
    figures = _figures(assessment, result, result.deviation.mean, result.skd.distances.mean, margin)
    found = f"{car}: {figures or 'no kamikaze'} (kamikazes of objective {plan.objective})"
    lost = len(assessment.reasons)
    aborted = [f"{lost} of {assessment.episodes} episodes aborted"] if lost else []
    total = len(result.kamikaze)
    seen = f"Seen from above (first {PANELS} of {total} φ)" if total > PANELS else "Seen from above"
    starts = [log.car[:1, :2] for group in result.kamikaze for log in group.logs]
    if starts:
        start = float(np.mean(right_and_along(scenario.road.line, np.concatenate(starts))[:, 1]))
        way = f"from the South, from y ≈ {start:.1f} m" if scenario.road.straight else f"from {-start:.1f} m before"
        seen += f"; the car comes {way}".replace("-", "−")
    return "\n".join(textwrap.fill(line, _HEADING) for line in (*aborted, found, seen))


def _panel_title(assessment: Assessment, result: ObjectiveResult, place: int, shown: int) -> str:
    """Return what the margin of a φ is, what its kamikazes came to, and how many are drawn."""
    group = result.kamikaze[place]
    margins = None if assessment.margins is None else assessment.margins.per_phi[place]
    margin = None if margins is None or not margins.size else mean(margins)
    name = textwrap.shorten(group.safe_trajectory.name, _NAME, placeholder="…") or group.safe_trajectory.name[:_NAME]
    if not group.logs:
        lost = f"{group.aborted} of {len(group.episodes)} aborted" if group.aborted else "no kamikaze"
        return f"{name}: {lost}\n{_figures(assessment, result, None, None, margin)}"
    means = result.deviation.means[place], result.skd.distances.means[place]
    failed = len(group.finished) - result.successes_by_phi[place]
    drawn = f", {shown} drawn" if len(group.logs) > shown else ""
    count = f"{counted(len(group.logs), 'kamikaze')}{drawn}{f', {failed} failed' if failed else ''}"
    return f"{name}: {count}\n{_figures(assessment, result, *means, margin)}"


def _extent(
    scenario: Scenario, safe: Sequence[Trajectory], logs: Sequence[EpisodeLog], least: Sequence[Sequence[Trajectory]]
) -> tuple[float, float, float, float]:
    """Return what every panel shows: x from and to, y from and to, m."""
    everything = [one.positions for one in (*safe, *(log.trajectory for log in logs), *(t for of in least for t in of))]
    if not scenario.road.straight:  # where the car comes from and goes to is not below and above the crossing
        poses = [road_pose(scenario.road.line, along) for along in (-_APPROACH, 0.0)]
        everything += [outline_of(scenario, pose) for pose in (*poses, *map(last_pose, logs))]
    points = np.concatenate(everything)
    left, right = points[:, 0].min() - 0.8, max(points[:, 0].max() + 0.8, 0.6 * scenario.road.lane_width)
    return left, right, min(points[:, 1].min() - 1.0, -_APPROACH), max(points[:, 1].max() + 1.0, 1.5)


def _draw_panel(axes: Axes, scenario: Scenario, phi: Trajectory, box: tuple[float, float, float, float]) -> None:
    """Draw lanes and φ, with its time at every third tick."""
    drawing.draw_road(axes, scenario, *(box[2:] if scenario.road.straight else (-_LANE_SHOWN, _LANE_SHOWN)))
    axes.plot(*phi.positions.T, color=palette.SAFE, lw=1.8, marker=".", ms=5, zorder=5, label="safe φ, a dot each tick")
    last = np.full(2, np.inf)
    for number in range(0, len(phi), _LABELLED):
        place = phi.positions[number]
        if np.linalg.norm(place - last) < _BETWEEN:
            continue
        last = place
        drawing.write_time(axes, number * phi.time_step, place, palette.SAFE, (0, -4))
    axes.tick_params(labelsize=drawing.TYPE)
    drawing.set_extent(axes, box)


def _draw_kamikazes(axes: Axes, result: ObjectiveResult, logs: Sequence[EpisodeLog]) -> None:
    """Draw where adversaries walked, and their outlines at the hit."""
    hits = [log.trajectory.positions for log in logs if result.plan.succeeds(log)]
    others = [log.trajectory.positions for log in logs if not result.plan.succeeds(log)]
    for walks, colour, label in (
        (others, palette.CAR, "walked into the car: touched, no hit"),
        (hits, palette.KAMIKAZE, "kamikaze ψ, ending at ×"),
    ):
        _draw_walks(axes, walks, colour, label, "x", alpha=0.45, lw=0.8, zorder=3)
    outlines = [result.plan.scenario.adversary.outline(log.trajectory.positions) for log in logs]
    label = "outline of the adversary at the hit"
    style: dict[str, Any] = {"fc": "none", "ec": palette.KAMIKAZE, "lw": 0.6, "alpha": 0.45, "zorder": 4}
    axes.add_collection(PolyCollection(outlines, label=label, **style))


def _draw_walks(
    axes: Axes, walks: Sequence[FloatArray], colour: str, label: str, end: str, alpha: float, **style: Any
) -> None:
    """Draw trajectories (each ticks × 2, m) with a mark at the end of each: as two artists, which is quick."""
    if not walks:
        return
    axes.add_collection(LineCollection(walks, colors=colour, alpha=alpha, label=label, **style))
    x, y = np.array([walk[-1] for walk in walks]).T
    axes.plot(x, y, end, color=colour, ms=5 if end == "+" else 4, alpha=alpha + 0.25, zorder=4)


def _draw_approach(axes: Axes, scenario: Scenario, logs: Sequence[EpisodeLog], low: float) -> None:
    """Draw the car of the episode whose contact is the median, tick by tick above `low` (y, m), and where it hits."""
    log = sorted(logs, key=last_car_position)[len(logs) // 2]
    poses, last = log.car[:-1, :3], last_pose(log)
    fronts = poses[:, 1] + scenario.car.front
    drawing.draw_car(axes, scenario, last, "car, median at impact", 0.6)
    visible = poses[fronts > low] if scenario.road.straight else poses
    drawing.draw_before(axes, scenario, visible, "its front at the ticks before, with their times")
    if not scenario.road.straight:
        return
    for number, (pose, front) in enumerate(zip(poses, fronts.tolist(), strict=True)):
        if low < front < last[1] + scenario.car.front - 0.35:
            edge = outline_of(scenario, pose)[3]
            drawing.write_time(axes, number * scenario.time_step, edge, palette.CAR, (4, 0))


def _cross_out(axes: Axes, words: str) -> None:
    """Let a panel without a kamikaze not look like one of a car that no kamikaze could make hit."""
    axes.set_facecolor("#F3E3D8")
    axes.text(
        0.5, 0.35, words, transform=axes.transAxes, ha="center", va="center", color=palette.ALERT, weight="bold",
        fontsize=9, zorder=7,
    )  # fmt: skip
