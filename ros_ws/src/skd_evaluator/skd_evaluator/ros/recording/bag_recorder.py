"""What was heard during an episode, kept as it came, and the bag that it is written to."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.serialization import serialize_message
from skd_msgs.msg import EpisodeResult
from skd_sim.episode.episode import Episode, EpisodeLog
from skd_sim.episode.stamps import period_stamp, tick_stamp
from skd_sim.messages.to_messages import to_stamp
from skd_sim.nodes.support import CLEARANCE, CLOCK, DEFORMATION, EGO_ODOMETRY, EPISODE, EPISODE_RESULT, MARKERS, TF

from skd_evaluator.bags.writer import RecordedMessage
from skd_evaluator.campaign.plan.plan import walks_a_way
from skd_evaluator.campaign.run.assembly import EpisodeKey, Result
from skd_evaluator.ros.recording.recording import Recording, bag_name
from skd_evaluator.ros.recording.scenery import Scenery

SETTLE = 0.05
"""s for which a recording waits, after the result, for what other topics still have on the way."""


class BagRecorder:
    """Records one episode after another, each to a bag of its own.

    Attributes:
        scenery: what else belongs into a bag.
    """

    def __init__(
        self,
        node: Node,
        folder: Path,
        drive_topic: str,
        walk_topic: str,
        *,
        own_world: bool,
        patience: float,
        write: Callable[[Recording], None],
    ) -> None:
        """Record nothing yet.

        Args:
            node: node that listens to the topics.
            folder: folder for the bags.
            drive_topic: topic of the car's commands, resolved.
            walk_topic: topic of the adversary's commands, resolved.
            own_world: whether the simulator is SKD's own, and so publishes transforms.
            patience: how long to wait, after a result, for the commands of all ticks, wall seconds.
            write: writes a recording, or has it written.
        """
        self._node = node
        self._folder = folder
        self._drive_topic, self._walk_topic = drive_topic, walk_topic
        self._own_world = own_world
        self._patience = patience
        self._write = write
        self._written: set[str] = set()
        self._messages: list[RecordedMessage] = []
        self._key = EpisodeKey("", -1, 0)
        self._now = self._latest_end = 0
        self.scenery = Scenery(node, self._messages.append, self._foreign_log_time)

    def takes(self, episode: Episode) -> bool:
        """Whether the bag of an episode is kept: thousands of ways that were tried would bury those that count.

        Nor is one that is run again, to see whether it goes as before.
        """
        return not walks_a_way(episode) and bag_name(episode) not in self._written

    def begin(self, key: EpisodeKey, latest_end: int) -> None:
        """Forget the last episode.

        Args:
            key: key of the episode to come.
            latest_end: stamp of the last tick that the episode can have, ns.
        """
        self._messages.clear()
        self._key, self._latest_end = key, latest_end
        self._now = key.start

    def keep(self, topic: str, kind: type, stamp: int, data: bytes) -> None:
        """Keep a message, unless it is of an earlier episode.

        Args:
            topic: topic that the message came on, resolved.
            kind: type of the message.
            stamp: time stamp of the message, ns.
            data: the message's bytes as they came.
        """
        log_time = self._log_time(topic, stamp)
        if log_time is not None:
            self._messages.append(RecordedMessage(topic, kind, log_time, data))

    def _log_time(self, topic: str, stamp: int) -> int | None:
        """Return the simulation time (ns) of a message to record; none for one of an earlier episode."""
        if topic in (self._drive_topic, self._walk_topic):
            return self._foreign_log_time(stamp)
        if stamp < self._key.start:
            return None
        self._now = max(self._now, stamp)
        return stamp

    def _foreign_log_time(self, stamp: int) -> int | None:
        """Return the same of what others than the simulator may have sent: not stamped, or by another clock."""
        if not 0 < stamp <= self._latest_end:
            return self._now
        return stamp if stamp >= self._key.start else None

    def settle(self, episode: Episode, result: Result, listen: Callable[[float], None]) -> None:
        """Wait, a moment at most, for messages that topics without common order deliver after the result.

        Args:
            episode: the episode that is over.
            result: its result.
            listen: takes messages that come within this time, s.
        """
        start, step, periods = self._key.start, episode.scenario.time_step, episode.scenario.control_periods
        states = {tick_stamp(start, tick, step) for tick in range(result.ticks + 1)}
        commands = {tick_stamp(start, tick, step) for tick in range(result.ticks)}
        between = {  # of the last tick there may be none: nobody decides after a contact
            period_stamp(start, tick, period, periods, step)
            for tick in range(result.ticks - 1)
            for period in range(1, periods)
        }
        wanted = {self._node.resolve_topic_name(CLOCK): states | between}
        wanted |= {self._walk_topic: commands, self._drive_topic: commands | between}
        if self._own_world:
            wanted[self._node.resolve_topic_name(TF)] = states | between
        odometry = self._node.resolve_topic_name(EGO_ODOMETRY)
        last = range(tick_stamp(start, result.ticks - 1, step) + 1, tick_stamp(start, result.ticks, step))
        heard: dict[str, set[int]] = {topic: set() for topic in (*wanted, odometry)}
        deadline = time.monotonic() + self._patience
        checked = 0
        while time.monotonic() < deadline:
            for message in self._messages[checked:]:
                if message.topic in heard:
                    heard[message.topic].add(message.stamp)
            checked = len(self._messages)
            # A state within the last tick was followed by another one, so the car has answered it.
            wanted[self._drive_topic].update(stamp for stamp in heard[odometry] if stamp in last)
            if all(stamps <= heard[topic] for topic, stamps in wanted.items()):
                return
            listen(SETTLE)

    def write(self, specification: Any, log: EpisodeLog, result: Result, end: int, *, unsaid: bool) -> None:
        """Write the bag of the episode, or have it written.

        Args:
            specification: the message that began the episode.
            log: what happened in the episode.
            result: the episode's result, as published.
            end: stamp of the episode's end, ns.
            unsaid: whether the simulator has not said how the episode ended, so that the evaluator has to.
        """
        heard = {kept.topic for kept in self._messages}
        lacking = [topic for topic in (self._drive_topic, self._walk_topic) if topic not in heard]
        if result.ticks and lacking:
            said = " and ".join(lacking)
            self._node.get_logger().warning(f"the bag of episode {log.episode.episode_id} holds no message on {said}")
        spec = self._own(EPISODE, specification, self._key.start)
        messages = list(self._messages)
        if unsaid:
            ending = EpisodeResult(campaign=self._key.campaign, start=specification.header.stamp)
            ending.header.stamp = to_stamp(end)
            ending.header.frame_id = specification.header.frame_id
            ending.episode_id = self._key.episode_id
            ending.outcome = int(result.outcome)
            ending.ticks = result.ticks
            ending.impact_time = ending.impact_speed = math.nan
            ending.reason = result.reason
            messages = [kept for kept in messages if kept.kind is not EpisodeResult]
            messages.append(self._own(EPISODE_RESULT, ending, end))
        name = bag_name(log.episode)
        self._written.add(name)
        self._write(
            Recording(
                self._folder / name,
                spec.data,
                self._key.start,
                {topic: self._node.resolve_topic_name(topic) for topic in (MARKERS, CLEARANCE, DEFORMATION)},
                log.adversary,
                log.car,
                log.outcome,
                log.impact_time,
                [spec, *self.scenery.latched(self._key.start)],
                messages,
            )
        )

    def _own(self, topic: str, message: Any, stamp: int) -> RecordedMessage:
        data = serialize_message(message)
        return RecordedMessage(
            self._node.resolve_topic_name(topic), type(message), stamp, data, latched=topic == EPISODE
        )
