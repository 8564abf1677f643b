"""What RViz and Foxglove show: lanes, car, adversary, φ and the path walked as markers, and two figures as numbers.

The figures are how far car and adversary are from each other, and the adversary from φ. They are published where
a node listens; a recording has both.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Vector3
from rclpy.node import Node
from skd_sim.options.options import MAP_FRAME, CommandOptions
from skd_sim.ros.commands import Quantity, angle_of_yaw_rate, car_commands
from skd_sim.ros.simulator_node import CAR_HEIGHT
from skd_sim.ros.support import STREAM, Moments, Topic
from skd_sim.ros.to_messages import header, to_orientation
from skd_sim.scenario.road import Road
from skd_sim.scenario.road_user import Body, height_of
from skd_sim.world.dynamics.basic import wheels
from skd_sim.world.episode import CommandAges, EpisodeLog, EpisodeSpec, Outcome, period_of, tick_stamp
from skd_sim.world.state import AdversaryState, CarState
from std_msgs.msg import ColorRGBA, Float64
from visualization_msgs.msg import Marker, MarkerArray

from skd_evaluator import palette
from skd_evaluator.assessment.run.episodes import Samples
from skd_evaluator.driving.drive import Onlooker, Show
from skd_evaluator.metrics.deviation import deviation
from skd_evaluator.metrics.surrogate_measures import clearances
from skd_evaluator.metrics.surrogate_scenes import course_of, scene_of

_LANES, _CAR, _ADVERSARY, _SAFE, _WALKED, _LANE_LINES, _OBSTACLES = range(7)  # obstacles last: there may be many
_LANE_ENDS = (-40.0, 40.0)  # m along a lane


def _marker(number: int, kind: int, stamp: int, colour: str, *, alpha: float = 1.0, heading: float = 0.0) -> Marker:
    """Return a marker in a colour of the palette, "#RRGGBB"."""
    marker = Marker(header=header(stamp, MAP_FRAME), ns="skd", id=number, type=kind, action=Marker.ADD)
    marker.pose.orientation = to_orientation(heading)
    red, green, blue = (int(colour[start : start + 2], 16) / 255.0 for start in (1, 3, 5))
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    return marker


def _box(marker: Marker, centre: tuple[float, float, float], size: tuple[float, float, float]) -> Marker:
    marker.pose.position = Point(**dict(zip("xyz", map(float, centre), strict=True)))
    marker.scale = Vector3(**dict(zip("xyz", map(float, size), strict=True)))
    return marker


def _line(marker: Marker, points: Iterable[tuple[float, float]], width: float) -> Marker:
    marker.scale.x = width
    marker.points = [Point(x=float(x), y=float(y), z=0.05) for x, y in points]
    return marker


def _lanes(road: Road, stamp: int) -> list[Marker]:
    """Return the lanes' surface, two triangles between each two places along one; of several, edges and arrows too."""
    surface = _marker(_LANES, Marker.TRIANGLE_LIST, stamp, palette.ROAD_EDGE)
    surface.scale = Vector3(x=1.0, y=1.0, z=1.0)
    corners, lines = [], []
    for left, right in road.surfaces(*_LANE_ENDS):
        for one in range(len(left) - 1):
            corners += [left[one], right[one], right[one + 1], left[one], right[one + 1], left[one + 1]]
            lines += [left[one], left[one + 1], right[one], right[one + 1]]
    surface.points = [Point(x=float(x), y=float(y), z=-0.01) for x, y in corners]
    if not road.lanes:
        return [surface]
    for ahead, right, left in road.arrows(*_LANE_ENDS):
        lines += [right, ahead, ahead, left]
    return [surface, _line(_marker(_LANE_LINES, Marker.LINE_LIST, stamp, palette.ROAD), lines, 0.08)]


def _user(number: int, stamp: int, colour: str, body: Body, place: tuple[float, float], heading: float) -> Marker:
    """Return the marker of a road user."""
    marker = _marker(number, Marker.CUBE if body.is_box else Marker.CYLINDER, stamp, colour, heading=heading)
    radius, half_length, half_width = body.shape
    height = height_of(body.kind)
    size = 2.0 * (radius or half_length), 2.0 * (radius or half_width), height
    return _box(marker, (*place, 0.5 * height), size)


def fixed_markers(episode: EpisodeSpec, stamp: int) -> list[Marker]:
    """Return the markers of an episode that stay as they are: lanes, what stands, and φ; from `stamp` (ns) on."""
    markers = _lanes(episode.scenario.road, stamp)
    for index, (x, y, heading, half_length, half_width) in enumerate(episode.scenario.rectangles.tolist()):
        box = _marker(_OBSTACLES + index, Marker.CUBE, stamp, palette.OBSTACLE, heading=heading)
        markers.append(_box(box, (x, y, 0.5 * CAR_HEIGHT), (2.0 * half_length, 2.0 * half_width, CAR_HEIGHT)))
    if episode.safe_trajectory is not None:
        path = _marker(_SAFE, Marker.LINE_STRIP, stamp, palette.SAFE)
        markers.append(_line(path, episode.safe_trajectory.positions.tolist(), 0.1))
    return markers


def moving_markers(episode: EpisodeSpec, samples: Samples, stamp: int) -> list[Marker]:
    """Return the markers of all that move at simulation time `stamp` (ns), and of the path that the adversary has come.

    The car has none where its state is not known.
    """
    scenario = episode.scenario
    first, car = _OBSTACLES + len(scenario.rectangles), scenario.car
    elapsed = 1e-9 * (stamp - min(samples.adversary, default=stamp))
    walked = [samples.adversary[time] for time in sorted(samples.adversary) if time <= stamp]
    markers = [
        _user(first + index, stamp, palette.OBSTACLE, other, state[:2], state.heading)
        for index, (other, state) in enumerate(zip(scenario.others, scenario.others_after(elapsed), strict=True))
        if not other.stands
    ]
    if stamp in samples.car:
        x, y, heading = samples.car[stamp][:3]
        ahead = 0.5 * (car.front - car.rear)
        centre = (x + ahead * math.cos(heading), y + ahead * math.sin(heading), 0.5 * CAR_HEIGHT)
        box = _marker(_CAR, Marker.CUBE, stamp, palette.CAR, alpha=0.9, heading=heading)
        markers.append(_box(box, centre, (car.front + car.rear, car.width, CAR_HEIGHT)))
    if walked:
        heading = scenario.adversary.last_heading(np.array(walked))
        markers.append(_user(_ADVERSARY, stamp, palette.KAMIKAZE, scenario.adversary, walked[-1], heading))
    if len(walked) > 1:
        markers.append(_line(_marker(_WALKED, Marker.LINE_STRIP, stamp, palette.KAMIKAZE), walked, 0.06))
    return markers


def episode_markers(episode: EpisodeSpec, samples: Samples, stamp: int, *, fixed: bool = True) -> MarkerArray:
    """Return the markers of an episode at simulation time `stamp` (ns), with those that stay or without."""
    moving = moving_markers(episode, samples, stamp)
    return MarkerArray(markers=[*(fixed_markers(episode, stamp) if fixed else ()), *moving])


_UNITS = {Quantity.ACCELERATION: "m/s²", Quantity.SPEED: "m/s"}


class LiveFigures:
    """Publishes the figures of each moment, where a node has subscribed when the episode begins, or shows them."""

    def __init__(self, node: Node) -> None:
        """Make the topics; `node` publishes on them."""
        self._node, self._unit = node, _UNITS[Quantity.ACCELERATION]
        self._clearance = node.create_publisher(Float64, Topic.CLEARANCE, STREAM)
        self._deviation = node.create_publisher(Float64, Topic.DEVIATION, STREAM)
        self._onlooker: Onlooker | None = None
        self._show: Show | None = None
        self._yaws = False
        self._drive: tuple[float, float] | None = None
        self._ages = CommandAges(waited_for=False)
        self._latest: int | None = None

    def watch(self, show: Show, commands: CommandOptions) -> None:
        """Call a function with each situation, in which the car's command and its age are known, too."""
        heard = car_commands(commands)

        def on_command(message: Any) -> None:
            if self._latest is not None:  # else it is of the episode before
                stamp, (drive, _limit, steering) = heard.read(message)
                self._drive = drive, steering
                self._ages.come(stamp or None, time.monotonic())

        self._show, self._unit, self._yaws = show, _UNITS[heard.format.quantity], heard.format.is_yaw_rate
        self._node.create_subscription(heard.kind, commands.command_topic, on_command, STREAM)

    def begin(self, episode: EpisodeSpec, start: int) -> None:
        """Begin an episode.

        Args:
            episode: what is run.
            start: stamp of its tick 0, ns.
        """
        listeners = self._clearance.get_subscription_count() + self._deviation.get_subscription_count()
        self._onlooker = Onlooker(episode, self._unit) if listeners or self._show else None
        self._scenario, self._start = episode.scenario, start
        self._moments = Moments(CarState, AdversaryState)
        self._drive, self._latest = None, None
        self._ages.begin()

    def take(self, stamp: int, state: CarState | AdversaryState) -> None:
        """Take a state of the car or the adversary, stamped in ns; publish when both of a moment are there."""
        if self._onlooker is None:
            return
        if isinstance(state, CarState):
            now = time.monotonic()
            if self._latest is not None and stamp > self._latest and self._drive is not None:
                self._ages.use(now)
            self._latest = stamp
            self._ages.publish(stamp, now)
        place = period_of(stamp, self._start, self._scenario.time_step, self._scenario.control_periods)
        both = self._moments.put(stamp, type(state), state)
        if place is None or both is None:
            return
        age = self._ages.ages[-1] if self._ages.ages else math.nan
        command, car = self._drive or math.nan, both[CarState]
        if self._yaws and self._drive is not None:
            wheelbase = wheels(self._scenario.car)[0]
            command = self._drive[0], angle_of_yaw_rate(self._drive[1], car.speed, wheelbase)
        seen = self._onlooker.see(*place, car, both[AdversaryState], command, age)
        self._clearance.publish(Float64(data=seen.clearance))
        if not math.isnan(seen.strayed):
            self._deviation.publish(Float64(data=seen.strayed))
        if self._show is not None:
            self._show(seen)


def recorded_figures(log: EpisodeLog, start: int) -> Iterator[tuple[str, Float64, int]]:
    """Yield (topic, message, stamp in ns) of the figures of an episode at each tick, as far as they are known.

    Args:
        log: what happened.
        start: stamp of tick 0, ns.
    """
    scenario, psi, safe = log.episode.scenario, log.trajectory.positions, log.episode.safe_trajectory
    contact = log.outcome == Outcome.COLLISION
    values: dict[str, list[float]] = {}
    if len(log.car) > 1 and np.isfinite(log.car).all():
        course = course_of(scenario, log.adversary, log.car, log.impact_time, log.impact_speed)
        values[Topic.CLEARANCE] = clearances(scene_of(scenario, *course)).tolist()
    if safe is not None:
        ticks = [*map(float, range(len(psi)))]
        ticks[-1] = log.impact_time / scenario.time_step if contact else ticks[-1]
        values[Topic.DEVIATION] = [
            deviation(safe.positions, psi[: count + 1], tick) for count, tick in enumerate(ticks)
        ]
    for topic, figures in values.items():
        for tick, value in enumerate(figures):
            yield topic, Float64(data=value), tick_stamp(start, tick, scenario.time_step)
