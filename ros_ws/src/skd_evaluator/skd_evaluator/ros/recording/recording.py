"""What is recorded of one episode, and the bag that it becomes, in whichever process that is written."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from rclpy.serialization import deserialize_message, serialize_message
from skd_msgs.msg import Episode as EpisodeMsg
from skd_sim.arrays import FloatArray
from skd_sim.episode.episode import Episode, EpisodeLog, Mode, Outcome
from skd_sim.episode.stamps import tick_stamp
from skd_sim.messages.from_messages import message_to_episode
from skd_sim.nodes.support import MARKERS
from visualization_msgs.msg import MarkerArray

from skd_evaluator.bags.writer import RecordedMessage, write_bag
from skd_evaluator.campaign.plan.plan import model_digest
from skd_evaluator.ros.live_figures import recorded_figures
from skd_evaluator.ros.markers import fixed_markers, moving_markers


class Recording(NamedTuple):
    """One episode, to be written.

    Attributes:
        path: folder of the bag.
        specification: bytes of the message that specifies the episode, as everybody may read it.
        start: stamp of tick 0, ns.
        names: full names of the topics on which markers and figures are recorded, by those that SKD gives them.
        adversary: places of the adversary at the ticks, n × 2, m.
        car: places and speeds of the car at the ticks, n × 3, m and m/s; NaN where they are not known.
        outcome: how it ended.
        impact_time: s since the start, at the first contact; NaN without a collision.
        latched: what was latched when the episode began, its specification first.
        messages: all that came since.
    """

    path: Path
    specification: bytes
    start: int
    names: Mapping[str, str]
    adversary: FloatArray
    car: FloatArray
    outcome: Outcome
    impact_time: float
    latched: list[RecordedMessage]
    messages: list[RecordedMessage]


def bag_name(episode: Episode) -> str:
    """Return the name of an episode's bag, another one for each episode of a campaign."""
    number, mode = episode.episode_id, episode.mode.name.lower()
    if episode.mode != Mode.KAMIKAZE:
        return f"{mode}_{number:016x}"
    model = model_digest(number, episode.car_model)
    # Those of several objectives have the same ids, and so have those by which a car is learned.
    return "_".join(filter(None, (mode, episode.objective, f"{number:016x}", model)))


def write_recording(recording: Recording) -> None:
    """Write a recording as a bag, with the markers that show it and the figures of each tick.

    Raises:
        OSError: it cannot be written.
    """
    episode = message_to_episode(deserialize_message(recording.specification, EpisodeMsg))
    log = EpisodeLog(episode, recording.outcome, recording.adversary, recording.car, recording.impact_time)
    figures = recorded_figures(log, recording.start, recording.names)
    markers = _markers(log, recording.start, recording.names[MARKERS])
    write_bag(recording.path, [*recording.latched, *markers, *figures, *recording.messages])


def _markers(log: EpisodeLog, start: int, topic: str) -> list[RecordedMessage]:
    episode, scenario, found = log.episode, log.episode.scenario, []
    walked = [(float(x), float(y)) for x, y in log.adversary]
    for tick, car in enumerate(log.car):
        stamp = tick_stamp(start, tick, scenario.time_step)
        place = (float(car[0]), float(car[1])) if math.isfinite(car[0]) else None
        markers = moving_markers(scenario, place, walked[: tick + 1], tick * scenario.time_step, stamp)
        if not tick:
            markers = [*fixed_markers(episode, stamp), *markers]
        data = serialize_message(MarkerArray(markers=markers))
        found.append(RecordedMessage(topic, MarkerArray, stamp, data, latched=True))
    return found
