"""What RViz and Foxglove show: lanes, car, adversary, φ and the path walked as markers, and two figures as numbers.

The figures are how far car and adversary are from each other, and the adversary from φ. They are published where
a node listens; a recording has both.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from geometry_msgs.msg import Point
from rclpy.node import Node
from rclpy.serialization import serialize_message
from skd_sim.options.options import MAP_FRAME
from skd_sim.ros.state_publisher import CAR_HEIGHT
from skd_sim.ros.support import CLEARANCE, DEVIATION, STREAM
from skd_sim.ros.to_messages import to_stamp
from skd_sim.scenario.road import Road, road_pose, road_position
from skd_sim.scenario.road_user import Body, height_of
from skd_sim.scenario.scenario import Scenario
from skd_sim.world.episode import EpisodeLog, EpisodeSpec, Outcome
from skd_sim.world.state import AdversaryState, CarState
from skd_sim.world.timing import period_of, tick_stamp
from std_msgs.msg import Float64
from visualization_msgs.msg import Marker, MarkerArray

from skd_evaluator import palette
from skd_evaluator.assessment.run.assembly import Samples
from skd_evaluator.bags.write import RecordedMessage
from skd_evaluator.driving.drive import Onlooker
from skd_evaluator.metrics.deviation import deviation
from skd_evaluator.metrics.surrogate_measures import clearances
from skd_evaluator.metrics.surrogate_scenes import course_of, scene_of

_LANES, _CAR, _ADVERSARY, _SAFE, _WALKED, _LANE_LINES, _OBSTACLES = range(7)  # obstacles last: there may be many
_LANE_ENDS = (-40.0, 40.0)  # m along a lane


def _rgba(colour: str, alpha: float = 1.0) -> tuple[float, float, float, float]:
    """Return a colour of the palette, "#RRGGBB", as shares of red, green and blue."""
    red, green, blue = (int(colour[start : start + 2], 16) / 255.0 for start in (1, 3, 5))
    return red, green, blue, alpha


def _marker(number: int, kind: int, stamp: int, rgba: tuple[float, float, float, float]) -> Marker:
    marker = Marker()
    marker.header.frame_id = MAP_FRAME
    marker.header.stamp = to_stamp(stamp)
    marker.ns = "skd"
    marker.id = number
    marker.type = kind
    marker.action = Marker.ADD
    marker.pose.orientation.w = 1.0
    marker.color.r, marker.color.g, marker.color.b, marker.color.a = rgba
    return marker


def _box(marker: Marker, centre: tuple[float, float, float], size: tuple[float, float, float]) -> Marker:
    position, scale = marker.pose.position, marker.scale
    position.x, position.y, position.z = (float(value) for value in centre)
    scale.x, scale.y, scale.z = (float(value) for value in size)
    return marker


def _line(marker: Marker, points: Iterable[tuple[float, float]], width: float) -> Marker:
    marker.scale.x = width
    marker.points = [Point(x=float(x), y=float(y), z=0.05) for x, y in points]
    return marker


def _turned(marker: Marker, heading: float) -> Marker:
    marker.pose.orientation.z, marker.pose.orientation.w = math.sin(0.5 * heading), math.cos(0.5 * heading)
    return marker


def _lanes(road: Road, stamp: int) -> list[Marker]:
    """Return the lanes' surface, two triangles between each two places along one; of several, edges and arrows too."""
    surface = _marker(_LANES, Marker.TRIANGLE_LIST, stamp, _rgba(palette.ROAD_EDGE))
    surface.scale.x = surface.scale.y = surface.scale.z = 1.0
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
    return [surface, _line(_marker(_LANE_LINES, Marker.LINE_LIST, stamp, _rgba(palette.ROAD)), lines, 0.08)]


def _adversary(stamp: int, adversary: Body, walked: list[tuple[float, float]]) -> Marker:
    kind = Marker.CUBE if adversary.is_box else Marker.CYLINDER
    marker = _turned(
        _marker(_ADVERSARY, kind, stamp, _rgba(palette.KAMIKAZE)), adversary.last_heading(np.array(walked))
    )
    return _body(marker, adversary, walked[-1])


def _others(scenario: Scenario, elapsed: float, stamp: int) -> list[Marker]:
    """Return the markers of the others that do not stand, so many seconds after the start."""
    found, first = [], _OBSTACLES + len(scenario.rectangles)
    for index, (other, state) in enumerate(zip(scenario.others, scenario.others_after(elapsed), strict=True)):
        if not other.stands:
            marker = _marker(
                first + index, Marker.CUBE if other.is_box else Marker.CYLINDER, stamp, _rgba(palette.OBSTACLE)
            )
            found.append(_body(_turned(marker, state.heading), other, state[:2]))
    return found


def _body(marker: Marker, body: Body, place: tuple[float, float]) -> Marker:
    radius, half_length, half_width = body.shape
    height = height_of(body.kind)
    size = 2.0 * (radius or half_length), 2.0 * (radius or half_width), height
    return _box(marker, (*place, 0.5 * height), size)


def fixed_markers(episode: EpisodeSpec, stamp: int) -> list[Marker]:
    """Return the markers of an episode that stay as they are: lanes, what stands, and φ; from `stamp` (ns) on."""
    markers = _lanes(episode.scenario.road, stamp)
    for index, (x, y, heading, half_length, half_width) in enumerate(episode.scenario.rectangles.tolist()):
        box = _turned(_marker(_OBSTACLES + index, Marker.CUBE, stamp, _rgba(palette.OBSTACLE)), heading)
        markers.append(_box(box, (x, y, 0.5 * CAR_HEIGHT), (2.0 * half_length, 2.0 * half_width, CAR_HEIGHT)))
    if episode.safe_trajectory is not None:
        path = _marker(_SAFE, Marker.LINE_STRIP, stamp, _rgba(palette.SAFE))
        markers.append(_line(path, episode.safe_trajectory.positions.tolist(), 0.1))
    return markers


def moving_markers(
    scenario: Scenario,
    place: tuple[float, float] | None,
    walked: list[tuple[float, float]],
    elapsed: float,
    stamp: int,
) -> list[Marker]:
    """Return the markers of everybody who moves, and of the way that the adversary has come.

    Args:
        scenario: scenario that gives the shapes.
        place: place of the car's reference point, m; None where it is not known.
        walked: places of the adversary up to now, m.
        elapsed: time since the start of the episode, s.
        stamp: time stamp of the markers, ns.
    """
    markers, car, line = _others(scenario, elapsed, stamp), scenario.car, scenario.road.line
    if place is not None:
        heading = road_pose(line, road_position(line, *place)[0])[2]
        ahead = 0.5 * (car.front - car.rear)
        centre = (place[0] + ahead * math.cos(heading), place[1] + ahead * math.sin(heading), 0.5 * CAR_HEIGHT)
        box = _turned(_marker(_CAR, Marker.CUBE, stamp, _rgba(palette.CAR, 0.9)), heading)
        markers.append(_box(box, centre, (car.front + car.rear, car.width, CAR_HEIGHT)))
    if walked:
        markers.append(_adversary(stamp, scenario.adversary, walked))
    if len(walked) > 1:
        path = _marker(_WALKED, Marker.LINE_STRIP, stamp, _rgba(palette.KAMIKAZE))
        markers.append(_line(path, walked, 0.06))
    return markers


def episode_markers(episode: EpisodeSpec, samples: Samples, stamp: int, *, fixed: bool = True) -> MarkerArray:
    """Return the markers of an episode at simulation time `stamp` (ns), with those that stay or without."""
    place = samples.car[stamp][:2] if stamp in samples.car else None
    walked = [samples.adversary[time] for time in sorted(samples.adversary) if time <= stamp]
    elapsed = 1e-9 * (stamp - min(samples.adversary, default=stamp))
    moving = moving_markers(episode.scenario, place, walked, elapsed, stamp)
    return MarkerArray(markers=[*(fixed_markers(episode, stamp) if fixed else ()), *moving])


class LiveFigures:
    """Publishes the figures of each moment, where somebody has subscribed when the episode begins."""

    def __init__(self, node: Node) -> None:
        """Make the topics; `node` publishes on them."""
        self._clearance = node.create_publisher(Float64, CLEARANCE, STREAM)
        self._deviation = node.create_publisher(Float64, DEVIATION, STREAM)
        self._onlooker: Onlooker | None = None

    def begin(self, episode: EpisodeSpec, start: int) -> None:
        """Begin an episode.

        Args:
            episode: what is run.
            start: stamp of its tick 0, ns.
        """
        listeners = self._clearance.get_subscription_count() + self._deviation.get_subscription_count()
        self._onlooker = Onlooker(episode) if listeners else None
        self._scenario, self._start = episode.scenario, start
        self._cars: dict[int, CarState] = {}
        self._adversaries: dict[int, AdversaryState] = {}

    def take(self, stamp: int, state: CarState | AdversaryState) -> None:
        """Take a state of the car or the adversary, stamped in ns; publish when both of a moment are there."""
        if self._onlooker is not None:
            if isinstance(state, CarState):
                self._cars[stamp] = state
            else:
                self._adversaries[stamp] = state
            self._publish(stamp)

    def _publish(self, stamp: int) -> None:
        """Publish the figures of a moment of which both states are there."""
        place = period_of(stamp, self._start, self._scenario.time_step, self._scenario.control_periods)
        if self._onlooker is None or place is None or not (stamp in self._cars and stamp in self._adversaries):
            return
        seen = self._onlooker.see(*place, self._cars.pop(stamp), self._adversaries.pop(stamp), math.nan, math.nan)
        self._clearance.publish(Float64(data=seen.clearance))
        if not math.isnan(seen.strayed):
            self._deviation.publish(Float64(data=seen.strayed))


def recorded_figures(log: EpisodeLog, start: int, names: Mapping[str, str]) -> list[RecordedMessage]:
    """Return the figures of an episode at each tick, as far as they are known, for its recording.

    Args:
        log: what happened.
        start: stamp of tick 0, ns.
        names: names of the two topics, resolved.
    """
    scenario, psi, safe = log.episode.scenario, log.trajectory.positions, log.episode.safe_trajectory
    contact = log.outcome == Outcome.COLLISION
    values: dict[str, list[float]] = {}
    if len(log.car) > 1 and np.isfinite(log.car).all():
        ended = (log.impact_time, log.impact_speed) if contact else None
        course = course_of(scenario, log.adversary, log.car, ended)
        values[CLEARANCE] = clearances(scene_of(scenario, *course)).tolist()
    if safe is not None:
        ticks = [*map(float, range(len(psi)))]
        ticks[-1] = log.impact_time / scenario.time_step if contact else ticks[-1]
        values[DEVIATION] = [deviation(safe.positions, psi[: count + 1], tick) for count, tick in enumerate(ticks)]
    return [
        RecordedMessage(names[topic], Float64, tick_stamp(start, tick, scenario.time_step), serialize_message(message))
        for topic, figures in values.items()
        for tick, message in enumerate(Float64(data=value) for value in figures)
    ]
