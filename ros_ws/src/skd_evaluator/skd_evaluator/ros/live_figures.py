"""Figures that Foxglove plots: how far car and adversary are apart, and how far the adversary has strayed from φ.

Standard messages of one number each, published where somebody listens; a recording has both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from rclpy.node import Node
from rclpy.serialization import serialize_message
from skd_sim.ros.support import CLEARANCE, DEFORMATION, STREAM
from skd_sim.world.episode import Episode, EpisodeLog
from skd_sim.world.stamps import period_of, tick_stamp
from skd_sim.world.state import AdversaryState, CarState
from std_msgs.msg import Float64

from skd_evaluator.bags.writer import RecordedMessage
from skd_evaluator.driving.situation import Onlooker, figures_of


class LiveFigures:
    """Publishes the figures of each moment, where somebody has subscribed when the episode begins."""

    def __init__(self, node: Node) -> None:
        """Make the topics; `node` publishes on them."""
        self._clearance = node.create_publisher(Float64, CLEARANCE, STREAM)
        self._deformation = node.create_publisher(Float64, DEFORMATION, STREAM)
        self._onlooker: Onlooker | None = None

    def begin(self, episode: Episode, start: int) -> None:
        """Begin an episode.

        Args:
            episode: what is run.
            start: stamp of its tick 0, ns.
        """
        listeners = self._clearance.get_subscription_count() + self._deformation.get_subscription_count()
        self._onlooker = Onlooker(episode) if listeners else None
        self._scenario, self._start = episode.scenario, start
        self._cars: dict[int, CarState] = {}
        self._adversaries: dict[int, AdversaryState] = {}

    def take_car(self, stamp: int, car: CarState) -> None:
        """Take a state of the car, stamped in ns."""
        if self._onlooker is not None:
            self._cars[stamp] = car
            self._publish(stamp)

    def take_adversary(self, stamp: int, adversary: AdversaryState) -> None:
        """Take a state of the adversary, stamped in ns."""
        if self._onlooker is not None:
            self._adversaries[stamp] = adversary
            self._publish(stamp)

    def _publish(self, stamp: int) -> None:
        """Publish the figures of a moment of which both states are there."""
        place = period_of(stamp, self._start, self._scenario.time_step, self._scenario.control_periods)
        if self._onlooker is None or place is None or not (stamp in self._cars and stamp in self._adversaries):
            return
        seen = self._onlooker.see(*place, self._cars.pop(stamp), self._adversaries.pop(stamp), math.nan, math.nan)
        self._clearance.publish(Float64(data=seen.clearance))
        if not math.isnan(seen.strayed):
            self._deformation.publish(Float64(data=seen.strayed))


def recorded_figures(log: EpisodeLog, start: int, names: Mapping[str, str]) -> list[RecordedMessage]:
    """Return the figures of an episode for its recording.

    Args:
        log: what happened.
        start: stamp of tick 0, ns.
        names: names of the two topics, resolved.
    """
    step = log.episode.scenario.time_step
    return [
        RecordedMessage(names[topic], Float64, tick_stamp(start, tick, step), serialize_message(Float64(data=value)))
        for topic, values in zip((CLEARANCE, DEFORMATION), figures_of(log), strict=True)
        for tick, value in enumerate(values)
    ]
