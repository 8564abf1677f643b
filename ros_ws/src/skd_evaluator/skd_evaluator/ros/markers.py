"""What RViz and Foxglove show: lane, car, pedestrian, safe trajectory and the path walked so far."""

from __future__ import annotations

from collections.abc import Iterable

from geometry_msgs.msg import Point
from skd_sim.episode import Episode
from skd_sim.nodes.to_messages import MAP_FRAME, to_stamp
from visualization_msgs.msg import Marker, MarkerArray

from skd_evaluator.campaign.assembly import Samples

_LANE, _CAR, _PEDESTRIAN, _SAFE, _WALKED = range(5)
_LANE_LENGTH = 80.0  # m
_CAR_HEIGHT, _PEDESTRIAN_HEIGHT = 1.5, 1.8  # m


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


def episode_markers(episode: Episode, samples: Samples, stamp: int) -> MarkerArray:
    """Return the markers of an episode at simulation time `stamp` (ns)."""
    scenario = episode.scenario
    car, walker = scenario.car, scenario.pedestrian
    lane = _marker(_LANE, Marker.CUBE, stamp, (0.35, 0.35, 0.35, 1.0))
    markers = [_box(lane, (0.0, 0.0, -0.01), (scenario.road.lane_width, _LANE_LENGTH, 0.01))]
    if stamp in samples.car:
        x, y, _ = samples.car[stamp]
        centre = (x, y + 0.5 * (car.front - car.rear), 0.5 * _CAR_HEIGHT)
        box = _marker(_CAR, Marker.CUBE, stamp, (0.29, 0.44, 0.65, 0.9))
        markers.append(_box(box, centre, (car.width, car.front + car.rear, _CAR_HEIGHT)))
    walked = [samples.pedestrian[time] for time in sorted(samples.pedestrian)]
    if walked:
        centre = (*walked[-1], 0.5 * _PEDESTRIAN_HEIGHT)
        disc = _marker(_PEDESTRIAN, Marker.CYLINDER, stamp, (0.84, 0.38, 0.3, 1.0))
        markers.append(_box(disc, centre, (2.0 * walker.reach, 2.0 * walker.reach, _PEDESTRIAN_HEIGHT)))
    if len(walked) > 1:
        path = _marker(_WALKED, Marker.LINE_STRIP, stamp, (0.84, 0.38, 0.3, 1.0))
        markers.append(_line(path, walked, 0.06))
    if episode.safe_trajectory is not None:
        path = _marker(_SAFE, Marker.LINE_STRIP, stamp, (0.11, 0.47, 0.22, 1.0))
        markers.append(_line(path, episode.safe_trajectory.positions.tolist(), 0.1))
    return MarkerArray(markers=markers)
