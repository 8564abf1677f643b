"""Pictures of results: the paper's figure, trajectories seen from above."""

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
from skd_sim.arrays import FloatArray
from skd_sim.scenario.road import right_and_along
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog
from skd_sim.world.state import Trajectory

from skd_evaluator import palette
from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.objective_result import KamikazeSet, ObjectiveResult
from skd_evaluator.metrics.contact_place import last_car_position
from skd_evaluator.metrics.statistics import mean
from skd_evaluator.report.drawing import PAGE, TYPE, car_outline, draw_car, draw_fronts, draw_road, save_picture
from skd_evaluator.report.terminal import counted

mpl.use("Agg")


_APPROACH, _LANE_SHOWN = 2.5, 80.0  # m of a lane that are in the picture at least, and of a curved one that are drawn
_LABELLED = 3
"""Ticks between those whose time stands beside φ."""
_HEADING = 100  # characters of a line of the heading
_OUTLINES = "outline of the adversary at the hit"
PANELS = 6
"""Most φ that one picture shows."""


def _kamikaze_label(groups: Sequence[KamikazeSet], shown: int) -> str:
    most = max(len(group.logs) for group in groups)
    return f"kamikaze ψ, ending at ×; {shown} of {most}" if most > shown else "kamikaze ψ, ending at ×"


def _shortened(name: str, length: int) -> str:
    """Return a name with its middle left out where it is longer than `length`."""
    if len(name) <= length:
        return name
    kept = max(2, length - 1)
    return f"{name[: kept // 2]}…{name[-(kept - kept // 2) :]}"


def _broken(text: str, length: int) -> str:
    """Return a text with no line longer than `length`, but for words that are."""
    return "\n".join("\n".join(textwrap.wrap(line, length)) for line in text.split("\n"))


def _ranks(rating: Assessment, assessment: ObjectiveResult) -> bool:
    """Return whether an assessment is the one that is ranked by; its picture has the margin trajectories too."""
    return assessment is rating.for_deviation


def _figures(
    rating: Assessment, assessment: ObjectiveResult, deviation: float | None, skd: float | None, margin: float | None
) -> str:
    """Return those of three means (m) that are the car's own in this picture; others are of no use beside these."""
    alone = len(rating.results) == 1
    shown = []
    if margin is not None and _ranks(rating, assessment):
        shown.append(f"margin {margin:.2f} m")
    if deviation is not None and (alone or assessment is not rating.for_skd):
        shown.append(f"planned {deviation:.2f} m")
    if skd is not None and (alone or assessment is not rating.for_deviation):
        shown.append(f"SKD {skd:.2f} m")
    return ", ".join(shown)


def _panel_figure(rating: Assessment, assessment: ObjectiveResult, number: int) -> str:
    """Return what the margin of a φ is, and what its kamikazes came to, in a few words."""
    group = assessment.kamikaze[number]
    margins = None if rating.margins is None else rating.margins.per_phi[number]
    margin = None if margins is None or not margins.size else mean(margins)
    if not group.logs:
        lost = f"{group.aborted} of {group.trials} aborted" if group.aborted else "no kamikaze"
        return ", ".join(filter(None, [_figures(rating, assessment, None, None, margin), lost]))
    deviation = assessment.deviation.means[number]
    skd = assessment.skd.distances.means[number]
    figures = _figures(rating, assessment, deviation, skd, margin)
    failed = group.trials - group.aborted - assessment.successes_by_phi[number]
    return f"{figures}, {failed} failed" if failed else figures


def _heading(rating: Assessment, assessment: ObjectiveResult) -> str:
    """Return which car this is, and what was found over all φ."""
    plan = assessment.plan
    car = plan.car.label
    margin = None if rating.margins is None else rating.margins.mean
    figures = _figures(rating, assessment, assessment.deviation.mean, assessment.skd.distances.mean, margin)
    explained = figures.replace("planned ", "planned deviation ", 1)
    found = f"{car}: {explained or 'no kamikaze'} (kamikazes of objective {plan.objective})"
    return f"{found}\n{_intervals(rating, assessment)}" if figures else found


def _intervals(rating: Assessment, assessment: ObjectiveResult) -> str:
    """Return of how many the means are that `_heading` says, and how sure they are."""
    own = _figures(rating, assessment, 0.0, 0.0, 0.0)
    known = (
        ("margin", None if rating.margins is None else rating.margins.ci95),
        ("planned", assessment.deviation.interval),
        ("SKD", assessment.skd.distances.interval),
    )
    parts = [f"{name} {ends[0]:.2f} to {ends[1]:.2f} m" for name, ends in known if name in own and ends is not None]
    sure = f"95 % by φ: {', '.join(parts)}; " if parts else ""
    reached = "were hit" if assessment.plan.limits_deviation else "collided"
    return f"{sure}{assessment.successes} of {assessment.trials} trials {reached}, {len(assessment.kamikaze)} φ"


def _draw_ways(axes: Axes, ways: Sequence[Trajectory], shown: int) -> None:
    """Draw margin trajectories, the least first, at most so many."""
    least = ways[:shown]
    label = "margin trajectory (least deviation that is hit), ending at +" + (
        f"; {shown} of {len(ways)}" if len(ways) > shown else ""
    )
    colour, dashes = palette.MARGIN, (0, (4, 2))
    _draw_walks(axes, [way.positions for way in least], colour, label, "+", alpha=0.6, lw=0.9, ls=dashes, zorder=3.5)


def _draw_walks(
    axes: Axes, walks: Sequence[FloatArray], colour: str, label: str, end: str, alpha: float, **style: Any
) -> None:
    """Draw ways and a mark at the end of each: as two artists, for hundreds take most of a picture's time.

    Args:
        axes: axes of the panel.
        walks: positions of each, m, each shape (ticks, 2).
        colour: colour of all.
        label: what the legend says of them.
        end: marker at the end of each.
        alpha: how much of what is below a way is covered by it; a mark covers 0.25 more.
        style: what else `LineCollection` takes.
    """
    if not walks:
        return
    axes.add_collection(LineCollection(walks, colors=colour, alpha=alpha, label=label, **style))
    x, y = np.array([walk[-1] for walk in walks]).T
    axes.plot(x, y, end, color=colour, ms=5 if end == "+" else 4, alpha=alpha + 0.25, zorder=4)


def _draw_approach(axes: Axes, scenario: Scenario, logs: Sequence[EpisodeLog], low: float) -> None:
    """Draw the car of the episode whose contact is the median: how it came, tick by tick, and where it hits.

    Args:
        axes: axes of the panel.
        scenario: scenario of the test.
        logs: logs of at least one episode that collided.
        low: least y of the panel, m; what is below is left out.
    """
    log = sorted(logs, key=last_car_position)[len(logs) // 2]
    along = right_and_along(scenario.road.line, np.ascontiguousarray(log.car[:, :2]))[:-1, 1]
    visible = along[along + scenario.car.front > low] if scenario.road.straight else along
    draw_car(axes, scenario, last_car_position(log), "car, median at impact", 0.6)
    draw_fronts(axes, scenario, visible, "its front at the ticks before, with their times")
    if not scenario.road.straight:
        return
    for number, place in enumerate(along.tolist()):
        front = place + scenario.car.front
        if low < front < last_car_position(log) + scenario.car.front - 0.35:
            time, beside = number * scenario.time_step, scenario.car.half_width + 0.15
            axes.text(beside, front, f"{time:.1f} s", fontsize=TYPE, va="center", zorder=3, clip_on=True)


def _cross_out(axes: Axes, words: str) -> None:
    """Let a panel without a kamikaze not look like one of a car that nobody could make hit anybody."""
    axes.set_facecolor("#F3E3D8")
    axes.text(
        0.5, 0.35, words, transform=axes.transAxes, ha="center", va="center", color=palette.ALERT, weight="bold",
        fontsize=9, zorder=7,
    )  # fmt: skip


def _label_times(axes: Axes, phi: Trajectory) -> None:
    """Write beside φ when it is where, at every third tick."""
    for number in range(0, len(phi), _LABELLED):
        x, y = phi.positions[number]
        axes.annotate(
            f"{number * phi.time_step:.1f} s", (x, y), xytext=(0, -4), textcoords="offset points", fontsize=TYPE,
            ha="center", va="top", color=palette.SAFE, zorder=6,
            bbox={"fc": "white", "ec": "none", "alpha": 0.6, "pad": 0.5},
        )  # fmt: skip


def save_trajectories(path: Path, rating: Assessment, assessment: ObjectiveResult, shown: int = 40) -> None:
    """Save φ and its kamikaze trajectories seen from above, one panel per φ, with lane and car.

    In the picture of the kamikazes that rank the car are the margin trajectories too.

    Args:
        path: file to which the picture is written.
        rating: rating of the car.
        assessment: assessment of the rating that is drawn.
        shown: greatest number of kamikaze trajectories drawn for each φ; more would only blacken the panel.
    """
    scenario = assessment.plan.scenario
    groups = assessment.kamikaze[:PANELS]
    of_margin: list[list[Trajectory]] = [[] for _ in groups]
    if rating.margins is not None and _ranks(rating, assessment):
        known = [[way for way in ways if way is not None] for ways in rating.margins.hits[: len(groups)]]
        of_margin = [[way.trajectory for way in sorted(ways, key=lambda one: one.distance)] for ways in known]
    everything = [group.safe_trajectory.positions for group in groups] + [
        log.trajectory.positions for group in groups for log in group.logs[:shown]
    ]
    everything += [way.positions for ways in of_margin for way in ways]
    road = scenario.road
    if not road.straight:  # where the car comes from and goes to is not below and above the crossing
        everything += [car_outline(scenario, along) for along in (-_APPROACH, 0.0)]
        everything += [car_outline(scenario, last_car_position(log)) for group in groups for log in group.logs[:shown]]
    points = np.concatenate(everything)
    starts = [right_and_along(road.line, log.car[:1, :2])[0, 1] for group in groups for log in group.logs[:shown]]
    low = min(points[:, 1].min() - 1.0, -_APPROACH)
    high = max(points[:, 1].max() + 1.0, 1.5)
    left, right = points[:, 0].min() - 0.8, max(points[:, 0].max() + 0.8, 0.6 * scenario.road.lane_width)
    columns = min(2, len(groups))
    lines = -(-len(groups) // columns)
    aspect = (high - low) / (right - left)
    width = (PAGE - 0.7) / 2.0
    # Around the panels: title and axis labels of each row, the heading and the legend.
    size = (PAGE, lines * (min(width * aspect, 4.5) + 0.65) + 1.45)
    fitting = int(16 * width)  # characters of a line above a panel
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for panel in panels[len(groups) :]:
        panel.set_visible(False)
    for number, (panel, group) in enumerate(zip(panels, groups, strict=False)):
        draw_road(panel, scenario, *((low, high) if road.straight else (-_LANE_SHOWN, _LANE_SHOWN)))
        if group.logs:
            _draw_approach(panel, scenario, group.logs[:shown], low)
        elif group.aborted:
            _cross_out(panel, "ABORTED:\nthis says nothing\nabout the car")
        drawn: dict[bool, list[FloatArray]] = {False: [], True: []}
        for log in group.logs[:shown]:
            drawn[assessment.plan.succeeds(log)].append(log.trajectory.positions)
        touched = "walked into the car: touched, no hit"
        _draw_walks(panel, drawn[False], palette.CAR, touched, "x", alpha=0.45, lw=0.8, zorder=3)
        _draw_walks(
            panel, drawn[True], palette.KAMIKAZE, _kamikaze_label(groups, shown), "x", alpha=0.45, lw=0.8, zorder=3
        )
        _draw_ways(panel, of_margin[number], shown)
        outlines = [scenario.adversary.outline(log.trajectory.positions) for log in group.logs[:shown]]
        panel.add_collection(
            PolyCollection(outlines, fc="none", ec=palette.KAMIKAZE, lw=0.6, alpha=0.45, zorder=4, label=_OUTLINES)
        )
        x, y = group.safe_trajectory.positions.T
        panel.plot(x, y, color=palette.SAFE, lw=1.8, marker=".", ms=5, zorder=5, label="safe φ, a dot each tick")
        _label_times(panel, group.safe_trajectory)
        mean = _panel_figure(rating, assessment, number)
        count = f"{counted(len(group.logs), 'kamikaze')}"
        if of_margin[number]:
            count += f", {counted(len(of_margin[number]), 'way')} of the margin"
        name = _shortened(group.safe_trajectory.name, fitting - len(mean) - 2)
        panel.set_title(f"{name}: {mean}\n{count}", fontsize=TYPE, parse_math=False)
        panel.tick_params(labelsize=TYPE)
        panel.set_xlim(left, right)
        panel.set_ylim(low, high)
        panel.set_aspect("equal")
    for row in range(lines):
        panels[row * columns].set_ylabel("y, North (m)", fontsize=TYPE)
    for panel in panels[max(0, len(groups) - columns) : len(groups)]:
        panel.set_xlabel("x, East (m)", fontsize=TYPE)
        panel.xaxis.set_tick_params(labelbottom=True)
    entries: dict[str, Any] = {}
    for panel in panels[: len(groups)]:  # the first may have no kamikaze trajectory
        entries = {**dict(zip(*reversed(panel.get_legend_handles_labels()), strict=True)), **entries}
    figure.legend(
        list(entries.values()), list(entries), loc="outside lower center", ncols=2, frameon=False, fontsize=TYPE
    )
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
    heading = _broken(f"{aborted}{figures}Seen from above{which}{start}", _HEADING)
    figure.suptitle(heading, fontsize=9, parse_math=False, color=palette.ALERT if lost else "black")
    save_picture(figure, path)
