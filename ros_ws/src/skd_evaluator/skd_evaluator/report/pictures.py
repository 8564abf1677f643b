"""Pictures of scenarios, of episodes and of trajectories, as seen from above.

Episodes are drawn with the car as the adversary believes it to be; φ with its kamikazes and margin trajectories. First
stands what all pictures have in common: how they are saved, lanes, and a car on its own.
"""

from __future__ import annotations

import math
import shutil
import subprocess
import textwrap
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from skd_adversary.safe_trajectories.recordings import interpolated
from skd_sim.errors import UsageError
from skd_sim.scenario.protocol import time_of_meeting
from skd_sim.scenario.road import right_and_along, road_pose
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.contact import rectangle_distance, to_car_frame
from skd_sim.world.episode import EpisodeLog
from skd_sim.world.state import FloatArray, Trajectory

from skd_evaluator import palette
from skd_evaluator.assessment.assessment import Assessment, ObjectiveResult
from skd_evaluator.metrics.contact_place import last_car_position, last_pose, outline_of
from skd_evaluator.metrics.statistics import mean
from skd_evaluator.report.formats import counted

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
        parked: dict[str, Any] = {"fc": palette.OBSTACLE, "ec": palette.CAR, "lw": 0.8, "hatch": "///"}
        axes.add_patch(Polygon(obstacle.corners, zorder=1, label=label, **parked))
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


mpl.use("Agg")

DEVIATIONS = 2.0
"""Standard deviations to each side of the mean that pictures show: about 95 %."""


_DPI = 110
_TIMES = 0.05  # share of the height that is added above it, so that the labels of times fit
_BESIDE = 2.0  # m that are shown beside everything
_AFTER = 1.0  # s of a way that are shown after the unbraked car is there
_SCENARIO_LANE = 150.0  # m of the lane that are drawn to each side of the crossing
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
    poses = [road_pose(scenario.road.line, along) for along in (start, meets, -car.front)]
    cars = [outline_of(scenario, pose) for pose in poses]
    box = _scenario_extent(scenario, [*cars, body, *_near(scenario, ways)])
    size = np.array([box[1] - box[0], box[3] - box[2]])
    width, height = size * min(_WIDEST / size[0], _LONGEST / size[1])
    figure = Figure(figsize=(max(_LEGEND, width + 1.2), max(3.0, height + 2.5)), layout="constrained")
    axes = figure.subplots()
    draw_road(axes, scenario, -_SCENARIO_LANE, _SCENARIO_LANE)
    draw_car(axes, scenario, poses[0], "car under test at the start")
    there = "when it reaches the target's way, unbraked" if ways else "at the crossing line"
    draw_before(axes, scenario, np.array(poses[1:2]), f"car under test {there}", whole=True)
    _draw_ways(axes, scenario, ways)
    label = f"adversary ({adversary.kind}) at the start"
    axes.add_patch(Polygon(body, fc=palette.KAMIKAZE, ec="black", zorder=7, label=label))
    set_extent(axes, box)
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


def _scenario_extent(scenario: Scenario, shapes: Sequence[FloatArray]) -> tuple[float, float, float, float]:
    """Return what the picture shows: x from and to, y from and to, m."""
    parked = [obstacle.corners for obstacle in scenario.obstacles]
    first = zip(scenario.others, scenario.others_at(0), strict=True)
    others = [other.outline_at(np.array(state[:2]), state.heading) for other, state in first]
    return extent_of(*shapes, *parked, *others, beside=_BESIDE)


_FILM_DPI = 110
_HEIGHT = 5.4  # inches of the view from above
_APART = 1.6  # m between two places of the adversary whose times are written
_CAR_TIMES = 0.9  # m, of the car likewise
_MOST = 20.0  # m of a straight lane in the picture: a car that comes from further away drives into it
_RATE = 12  # pictures a second
_SLOWER = 2.0  # than it happened
_HELD = 1.5  # s that a film stays at its end
_FINE = 150  # points of the distances over time
_LANE = 80.0  # m of the lane that are drawn to each side of the crossing


@dataclass(frozen=True, eq=False)
class ShownEpisode:
    """An episode that is to be drawn.

    Attributes:
        title: text above the picture.
        scenario: scenario of the test.
        phi: positions of φ at ticks, m.
        adversary: positions of the adversary at `times`, n × 2, m.
        car: the car at `times`, n × 4: reference point (x, y), m, heading, rad, speed, m/s.
        times: times since the start, s: those of the ticks and, if there is a contact, at the end its own.
        collided: whether the episode ended in a collision.
        belief: what was believed of the car at `times`, as `believed_car` has it; None where nothing is known.
    """

    title: str
    scenario: Scenario
    phi: FloatArray
    adversary: FloatArray
    car: FloatArray
    times: FloatArray
    collided: bool
    belief: FloatArray | None = None

    @property
    def along(self) -> FloatArray:
        """Path coordinates of the car, m."""
        return right_and_along(self.scenario.road.line, np.ascontiguousarray(self.car[:, :2]))[:, 1]

    def poses(self, times: FloatArray) -> FloatArray:
        """Return the car's poses at some times (s): x, y (m), heading (rad), n × 3."""
        states = np.column_stack([self.car[:, :2], np.unwrap(self.car[:, 2])])
        return interpolated(times, self.times, states)

    def phi_at(self, times: FloatArray) -> FloatArray:
        """Return where φ is at some times (s), held at its end: n × 2, m."""
        ticks = self.scenario.time_step * np.arange(len(self.phi))
        return interpolated(times, ticks, self.phi)

    def distances(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the gap between car and adversary and the distance from φ at some times (s), m.

        The adversary's disc, or the disc that a box holds, against the car's outline; straight lines between ticks.
        """
        walked = interpolated(times, self.times, self.adversary)
        away = np.linalg.norm(walked - self.phi_at(times), axis=1)
        car, (radius, _, half_width) = self.scenario.car, self.scenario.adversary.shape
        gaps = []
        for (x, y), pose in zip(walked.tolist(), self.poses(times).tolist(), strict=True):
            ahead, left = to_car_frame(x, y, *pose)
            outside = rectangle_distance(ahead, left, car.front, car.rear, car.half_width)
            gaps.append(max(0.0, outside - (radius or half_width)))
        return np.array(gaps), away


class EpisodePicture:
    """A picture of an episode, which can be set to any time of it."""

    def __init__(self, shown: ShownEpisode) -> None:
        """Draw what does not move."""
        self._shown = shown
        box = _extent(shown)
        width = min(3.6, max(2.2, _HEIGHT * (box[1] - box[0]) / (box[3] - box[2]))) + 0.7
        self.figure = Figure(figsize=(PAGE, _HEIGHT + 1.5), layout="constrained")
        above, beside = self.figure.subplots(1, 2, width_ratios=[width, PAGE - width])
        for axes in (above, beside):
            axes.tick_params(labelsize=TYPE)
        self._draw_above(above, box)
        self._draw_distances(beside)
        self.figure.suptitle(shown.title, fontsize=9, parse_math=False)
        handles, labels = above.get_legend_handles_labels()
        self.figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=TYPE)
        self.set(float(shown.times[-1]))

    def set(self, time: float) -> None:
        """Move car, adversary and cursor to a time (s)."""
        shown = self._shown
        along = float(np.interp(time, shown.times, shown.along))
        self._car.set_xy(outline_of(shown.scenario, shown.poses(np.array([time]))[0]))
        if shown.belief is not None:
            ahead, deviation = (float(np.interp(time, shown.times, shown.belief[:, column])) for column in (0, 1))
            for artist, number in zip(self._believed, (DEVIATIONS, 0.0), strict=True):
                artist.set_xy(front_band(shown.scenario, along + ahead, number * deviation))
        before = shown.times < time
        here = np.array([[np.interp(time, shown.times, shown.adversary[:, axis]) for axis in (0, 1)]])
        self._user.set_xy(shown.scenario.adversary.outline(np.concatenate([shown.adversary[before], here])))
        there = shown.phi_at(np.array([time]))
        self._there.set_data(there[:, 0], there[:, 1])
        self._cursor.set_xdata([time, time])
        speed = float(np.interp(time, shown.times, shown.car[:, 3]))
        self._clock.set_text(f"{time:.2f} s, car {speed:.1f} m/s")

    def _draw_above(self, axes: Axes, box: tuple[float, float, float, float]) -> None:
        shown, scenario = self._shown, self._shown.scenario
        draw_road(axes, scenario, -_LANE, _LANE, float(shown.times[-1]))
        draw_before(axes, scenario, shown.car[:-1, :3], "front of the car at each tick, with its time")
        self._label_fronts(axes, box)
        axes.plot(*shown.phi.T, color=palette.SAFE, lw=1.6, marker=".", ms=6, zorder=4, label="φ, a dot each tick")
        circles: dict[str, Any] = {"marker": "o", "mfc": "none", "ms": 5, "zorder": 5}
        axes.plot(*shown.adversary.T, color=palette.KAMIKAZE, lw=2.0, label="ψ: the adversary", **circles)
        labelled: list[FloatArray] = []
        for time, place in zip(shown.times.tolist(), shown.adversary, strict=True):
            if all(np.linalg.norm(place - other) >= _APART for other in labelled):
                labelled.append(place)
                write_time(axes, time, place, palette.KAMIKAZE, (0, 8))
        self._car = draw_car(axes, scenario, shown.car[-1, :3].tolist(), "car")
        self._car.set_zorder(3)
        self._believed = []
        if shown.belief is not None:
            label = f"where the adversary believes the car's front, ± {DEVIATIONS:g} sd"
            nowhere = front_band(scenario, 0.0, 0.0)
            self._believed = [
                Polygon(nowhere, fc=palette.BELIEF, ec="none", alpha=0.35, zorder=3.5, label=label),
                Polygon(nowhere, fc="none", ec=palette.BELIEF, lw=2.0, ls="--", zorder=3.6),
            ]
            for one in self._believed:
                axes.add_patch(one)
        outline = scenario.adversary.outline(shown.adversary)
        self._user = Polygon(outline, fc=palette.KAMIKAZE, ec="black", zorder=7)
        axes.add_patch(self._user)
        ring: dict[str, Any] = {"mfc": "none", "mec": palette.SAFE, "mew": 2, "ms": 10, "zorder": 6}
        (self._there,) = axes.plot([], [], "o", label="φ at that time", **ring)
        set_extent(axes, box)
        axes.set_xlabel("x, East (m)", fontsize=9)
        axes.set_ylabel("y, North (m)", fontsize=9)
        self._clock = axes.set_title("", loc="right", fontsize=9)

    def _label_fronts(self, axes: Axes, box: tuple[float, float, float, float]) -> None:
        """Write when the front of the car was where, beside it, as far as there is room."""
        scenario, last = self._shown.scenario, None
        for time, pose in zip(self._shown.times[:-1].tolist(), self._shown.car[:-1, :3], strict=True):
            x, y = outline_of(scenario, pose)[3].tolist()
            if box[2] < y < box[3] and (last is None or np.hypot(x - last[0], y - last[1]) > _CAR_TIMES):
                last = (x, y)
                write_time(axes, time, np.array(last), palette.CAR, (4, 0))

    def _draw_distances(self, axes: Axes) -> None:
        shown = self._shown
        times = np.linspace(0.0, float(shown.times[-1]), _FINE)
        gaps, away = shown.distances(times)
        axes.plot(times, gaps, color=palette.CAR, lw=1.8, label="gap between car and adversary")
        axes.plot(times, away, color=palette.KAMIKAZE, lw=1.8, ls="--", label="distance from where φ is then")
        self._cursor = axes.axvline(0.0, color="black", lw=1.0)
        axes.set_xlim(0.0, max(float(shown.times[-1]), shown.scenario.time_step))
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("time (s)", fontsize=9)
        axes.set_ylabel("distance (m)", fontsize=9)
        axes.grid(alpha=0.3)
        axes.legend(frameon=False, fontsize=TYPE, loc="upper right")


def _extent(shown: ShownEpisode) -> tuple[float, float, float, float]:
    """Return what the picture shows: x from and to, y from and to, m."""
    cars = np.concatenate([outline_of(shown.scenario, pose) for pose in shown.car[:, :3]])
    left, right, low, high = extent_of(shown.phi, shown.adversary, cars, beside=0.8)
    low = max(low, high - _MOST) if shown.scenario.road.straight else low
    return left, right, low, high + _TIMES * (high - low)


def check_format(name: str) -> None:
    """Refuse a format that cannot be written here.

    Raises:
        UsageError: it needs a program that is not there.
    """
    if name == "mp4" and shutil.which("ffmpeg") is None:
        raise UsageError("--format mp4: needs the program ffmpeg, which is not on the PATH; --format gif needs nothing")


def save_episode(path: Path, shown: ShownEpisode) -> None:
    """Save an episode: .png at its end, .gif and .mp4 as a film at half speed.

    Raises:
        OSError: ffmpeg could not write the film.
    """
    picture = EpisodePicture(shown)
    if path.suffix == ".png":
        save_picture(picture.figure, path, DPI)
        return
    picture.figure.draw_without_rendering()
    picture.figure.set_layout_engine("none")  # it takes most of the time of a frame, and has done its work
    end = float(shown.times[-1])
    moving = np.linspace(0.0, end, max(2, round(end * _SLOWER * _RATE) + 1)).tolist()
    times = [*moving, *[end] * round(_HELD * _RATE)]
    film = FuncAnimation(picture.figure, picture.set, times, cache_frame_data=False)
    try:
        film.save(path, writer="pillow" if path.suffix == ".gif" else "ffmpeg", fps=_RATE, dpi=_FILM_DPI)
    except subprocess.CalledProcessError as error:
        raise OSError(f"ffmpeg: cannot write {path.name}") from error


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
    box = _panel_extent(
        scenario, [group.safe_trajectory for group in groups], [log for part in logs for log in part], least
    )
    columns = min(2, len(groups))
    lines = -(-len(groups) // columns)
    width = (PAGE - 0.7) / 2.0
    height = min(width * (box[3] - box[2]) / (box[1] - box[0]), 4.5)
    # Around the panels: title and axis labels of each row, the heading and the legend.
    figure = Figure(figsize=(PAGE, lines * (height + 0.65) + 1.45), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).ravel()
    for panel in panels[len(groups) :]:
        panel.set_visible(False)
    for place, (panel, group) in enumerate(zip(panels, groups, strict=False)):
        _draw_panel(panel, scenario, group.safe_trajectory, box)
        if logs[place]:
            _draw_approach(panel, scenario, logs[place], box[2])
        elif group.aborted:
            _cross_out(panel)
        _draw_kamikazes(panel, result, logs[place])
        _draw_walks(
            panel, [one.positions for one in least[place][:shown]], palette.MARGIN,
            "margin trajectory (least deviation that is hit), ending at +", "+", alpha=0.6, lw=0.9, ls=(0, (4, 2)),
            zorder=3.5,
        )  # fmt: skip
        panel.set_title(_panel_title(assessment, result, place, shown), fontsize=TYPE, parse_math=False)
    for row in range(lines):
        panels[row * columns].set_ylabel("y, North (m)", fontsize=TYPE)
    for panel in panels[max(0, len(groups) - columns) : len(groups)]:
        panel.set_xlabel("x, East (m)", fontsize=TYPE)
        panel.xaxis.set_tick_params(labelbottom=True)
    entries: dict[str, Any] = {}
    for panel in panels[: len(groups)]:  # the first may have no kamikaze trajectory
        entries = {**dict(zip(*reversed(panel.get_legend_handles_labels()), strict=True)), **entries}
    below: dict[str, Any] = {"ncols": 2, "frameon": False, "fontsize": TYPE}
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", **below)
    colour = palette.ALERT if assessment.reasons else "black"
    figure.suptitle(_heading(assessment, result), fontsize=9, parse_math=False, color=colour)
    save_picture(figure, path)


def _figures(
    assessment: Assessment, result: ObjectiveResult, deviation: float | None, skd: float | None, margin: float | None
) -> str:
    """Return those of three means (m) that are the car's own in this picture; others are of no use beside these."""
    single, ranks = len(assessment.results) == 1, result is assessment.for_deviation
    plans_skd, margins = single or result is not assessment.for_skd, assessment.margins
    least = "margin" if margins is None or margins.converged else "margin at most"
    known = (least, margin, ranks), ("planned deviation", deviation, plans_skd), ("SKD", skd, single or not ranks)
    return ", ".join(f"{name} {value:.3f} m" for name, value, own in known if own and value is not None)


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


def _panel_extent(
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
    draw_road(axes, scenario, *(box[2:] if scenario.road.straight else (-_LANE_SHOWN, _LANE_SHOWN)))
    axes.plot(*phi.positions.T, color=palette.SAFE, lw=1.8, marker=".", ms=5, zorder=5, label="safe φ, a dot each tick")
    last = np.full(2, np.inf)
    for number in range(0, len(phi), _LABELLED):
        place = phi.positions[number]
        if np.linalg.norm(place - last) < _BETWEEN:
            continue
        last = place
        write_time(axes, number * phi.time_step, place, palette.SAFE, (0, -4))
    axes.tick_params(labelsize=TYPE)
    set_extent(axes, box)


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
    draw_car(axes, scenario, last, "car, median at impact", 0.6)
    visible = poses[fronts > low] if scenario.road.straight else poses
    draw_before(axes, scenario, visible, "its front at the ticks before, with their times")
    if not scenario.road.straight:
        return
    for number, (pose, front) in enumerate(zip(poses, fronts.tolist(), strict=True)):
        if low < front < last[1] + scenario.car.front - 0.35:
            edge = outline_of(scenario, pose)[3]
            write_time(axes, number * scenario.time_step, edge, palette.CAR, (4, 0))


def _cross_out(axes: Axes) -> None:
    """Let a panel without a kamikaze not look like one of a car that no kamikaze could make hit."""
    axes.set_facecolor("#F3E3D8")
    words = "ABORTED:\nthis says nothing\nabout the car"
    axes.text(
        0.5, 0.35, words, transform=axes.transAxes, ha="center", va="center", color=palette.ALERT, weight="bold",
        fontsize=9, zorder=7,
    )  # fmt: skip
