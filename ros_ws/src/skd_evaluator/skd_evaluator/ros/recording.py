"""What is recorded of one episode, and the bag that it becomes, in whichever process that is written."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from rclpy.serialization import deserialize_message, serialize_message
from skd_msgs.msg import Episode as EpisodeMsg
from skd_sim.arrays import FloatArray
from skd_sim.episode.stamps import tick_stamp
from skd_sim.messages.from_messages import message_to_episode
from visualization_msgs.msg import MarkerArray

from skd_evaluator.bags.writer import RecordedMessage, write_bag
from skd_evaluator.ros.markers import fixed_markers, moving_markers


class Recording(NamedTuple):
    """One episode, to be written.

    Attributes:
        path: folder of the bag.
        specification: bytes of the message that specifies the episode, as everybody may read it.
        start: stamp of tick 0, ns.
        marker_topic: full name of the topic on which markers are recorded.
        adversary: places of the adversary at the ticks, n × 2, m.
        car: places and speeds of the car at the ticks, n × 3, m and m/s; NaN where they are not known.
        latched: what was latched when the episode began, its specification first.
        messages: all that came since.
    """

    path: Path
    specification: bytes
    start: int
    marker_topic: str
    adversary: FloatArray
    car: FloatArray
    latched: list[RecordedMessage]
    messages: list[RecordedMessage]


def write_recording(recording: Recording) -> None:
    """Write a recording as a bag, with the markers that show it.

    Raises:
        OSError: it cannot be written.
    """
    write_bag(recording.path, [*recording.latched, *_markers(recording), *recording.messages])


def _markers(recording: Recording) -> list[RecordedMessage]:
    episode = message_to_episode(deserialize_message(recording.specification, EpisodeMsg))
    scenario, found = episode.scenario, []
    walked = [(float(x), float(y)) for x, y in recording.adversary]
    for tick, car in enumerate(recording.car):
        stamp = tick_stamp(recording.start, tick, scenario.time_step)
        place = (float(car[0]), float(car[1])) if math.isfinite(car[0]) else None
        markers = moving_markers(scenario, place, walked[: tick + 1], tick * scenario.time_step, stamp)
        if not tick:
            markers = [*fixed_markers(episode, stamp), *markers]
        data = serialize_message(MarkerArray(markers=markers))
        found.append(RecordedMessage(recording.marker_topic, MarkerArray, stamp, data, latched=True))
    return found
