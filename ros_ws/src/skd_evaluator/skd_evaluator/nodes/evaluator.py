"""Node `evaluator`: hands out episodes, collects what happens, records it, and publishes the assessment."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import rclpy
from geometry_msgs.msg import AccelStamped, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from skd_msgs.msg import Assessment as AssessmentMsg
from skd_msgs.msg import Episode as EpisodeMsg
from skd_msgs.msg import EpisodeResult
from skd_sim.episode import Episode, EpisodeLog, Outcome
from skd_sim.from_messages import from_stamp
from skd_sim.nodes.support import (
    ACCELERATION_COMMAND,
    ASSESSMENT,
    CLOCK,
    EGO_ODOMETRY,
    EPISODE,
    EPISODE_RESULT,
    LATCHED,
    MARKERS,
    PEDESTRIAN_ODOMETRY,
    STREAM,
    VELOCITY_COMMAND,
)
from skd_sim.nodes.to_messages import episode_to_message
from skd_sim.stamps import NANOSECONDS, next_start
from visualization_msgs.msg import MarkerArray

from skd_evaluator.assembly import EpisodeKey, Result, Samples, aborted, result_from_message
from skd_evaluator.assessment import Assessment
from skd_evaluator.bags.writer import RecordedMessage, write_bag
from skd_evaluator.nodes.assessment_message import assessment_to_message
from skd_evaluator.nodes.markers import episode_markers

_RECORDED: dict[str, type] = {
    CLOCK: Clock,
    EGO_ODOMETRY: Odometry,
    PEDESTRIAN_ODOMETRY: Odometry,
    ACCELERATION_COMMAND: AccelStamped,
    VELOCITY_COMMAND: TwistStamped,
    EPISODE_RESULT: EpisodeResult,
}
_WAKE = 0.1  # s: how often a waiting evaluator looks after the processes


class Evaluator(Node):
    """Runs episodes through the graph; an `EpisodeRunner`."""

    def __init__(self) -> None:
        """Make the topics on which it speaks; it listens from `begin_campaign` on."""
        super().__init__("evaluator")
        self._next_start = NANOSECONDS
        self._samples = Samples()
        self._result: tuple[Result, int] | None = None
        self._key = EpisodeKey("", -1, 0)
        self._recorded: list[RecordedMessage] = []
        self._episode_publisher = self.create_publisher(EpisodeMsg, EPISODE, LATCHED)
        self._assessment_publisher = self.create_publisher(AssessmentMsg, ASSESSMENT, LATCHED)
        self._marker_publisher = self.create_publisher(MarkerArray, MARKERS, LATCHED)

    def begin_campaign(
        self,
        campaign: str,
        *,
        record_to: Path | None = None,
        silence_limit: float = 120.0,
        check_processes: Callable[[], str | None] = lambda: None,
        before_episode: Callable[[], None] = lambda: None,
        maximum_distance: float | None = None,
    ) -> None:
        """Say how the episodes to come are run; to be called once, before the first.

        Args:
            campaign: name of the campaign, in every message and bag.
            record_to: folder for one bag per episode; nothing is recorded by default.
            silence_limit: wall seconds without any sign of the simulator after which an episode is aborted.
            check_processes: called while waiting; returns what is wrong with the graph's processes, if anything.
            before_episode: called before each episode.
            maximum_distance: as in `Plan`, for the record.
        """
        self._campaign = campaign
        self._record_to = record_to
        self._silence_limit = silence_limit
        self._check_processes = check_processes
        self._before_episode = before_episode
        self._maximum_distance = maximum_distance
        handlers: dict[str, Callable[[Any], None]] = {
            EGO_ODOMETRY: self._on_car,
            PEDESTRIAN_ODOMETRY: self._on_pedestrian,
            EPISODE_RESULT: self._on_result,
        }
        for topic, kind in _RECORDED.items():
            handler = handlers.get(topic)
            if handler is not None or record_to is not None:
                self._listen(topic, kind, handler)

    def _listen(self, topic: str, kind: type, handler: Callable[[Any], None] | None) -> None:
        name = self.resolve_topic_name(topic)

        def on_bytes(data: bytes) -> None:
            self._heard = time.monotonic()
            message = deserialize_message(data, kind)
            if self._record_to is not None:
                stamped = message.clock if topic == CLOCK else message.header.stamp
                self._recorded.append(RecordedMessage(name, kind, from_stamp(stamped), bytes(data)))
            if handler is not None:
                handler(message)

        self.create_subscription(kind, topic, on_bytes, STREAM, raw=True)

    # --- what comes in

    def _on_car(self, message: Any) -> None:
        stamp = from_stamp(message.header.stamp)
        if stamp >= self._key.start:
            position = message.pose.pose.position
            self._samples.add_car(stamp, position.x, position.y, message.twist.twist.linear.x)
            if self._marker_publisher.get_subscription_count() > 0:
                self._marker_publisher.publish(episode_markers(self._episode, self._samples, stamp))

    def _on_pedestrian(self, message: Any) -> None:
        stamp = from_stamp(message.header.stamp)
        if stamp >= self._key.start:
            position = message.pose.pose.position
            self._samples.add_pedestrian(stamp, position.x, position.y)

    def _on_result(self, message: Any) -> None:
        if EpisodeKey(message.campaign, int(message.episode_id), from_stamp(message.start)) == self._key:
            self._result = result_from_message(message), from_stamp(message.header.stamp)

    # --- episodes

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        """Run episodes one after another and yield their logs."""
        for episode in episodes:
            yield self.run_episode(episode)

    def run_episode(self, episode: Episode) -> EpisodeLog:
        """Run one episode to its end; one that cannot be finished comes back as ABORTED with the reason."""
        self._before_episode()
        start = self._next_start
        self._key = EpisodeKey(self._campaign, episode.episode_id, start)
        self._episode = episode
        self._samples.clear()
        self._recorded.clear()
        self._result = None
        message = episode_to_message(episode, self._campaign, start, self._maximum_distance)
        self._heard = time.monotonic()
        self._episode_publisher.publish(message)
        log = self._wait(episode, start)
        end = max([start, *self._samples.car, *self._samples.pedestrian])
        if self._result is not None:
            end = max(end, self._result[1])
        self._next_start = next_start(end)
        if self._record_to is not None:
            self._record(message, log, end)
        return log

    def _wait(self, episode: Episode, start: int) -> EpisodeLog:
        while True:
            rclpy.spin_once(self, timeout_sec=_WAKE)
            if self._result is not None:
                result = self._result[0]
                if self._samples.missing(episode, start, result) == 0:
                    return self._samples.log(episode, start, result)
                if result.outcome == Outcome.ABORTED:
                    return aborted(episode, result.reason)
            problem = self._check_processes()
            if problem is None and time.monotonic() - self._heard > self._silence_limit:
                problem = f"nothing was heard of the vehicle simulator for {self._silence_limit:g} s"
            if problem is not None:
                self.get_logger().warning(f"episode {episode.episode_id} aborted: {problem}")
                return aborted(episode, problem)

    def _record(self, message: Any, log: EpisodeLog, end: int) -> None:
        assert self._record_to is not None
        spec = self._recorded_message(EPISODE, message, self._key.start)
        messages = [spec, *self._recorded]
        if self._result is None:  # the simulator is gone, so the evaluator says for it how the episode ended
            result = EpisodeResult(header=message.header, campaign=self._campaign, start=message.header.stamp)
            result.episode_id = self._key.episode_id
            result.outcome = int(log.outcome)
            result.impact_time = result.impact_speed = math.nan
            result.reason = log.reason
            messages.append(self._recorded_message(EPISODE_RESULT, result, end))
        mode = log.episode.mode.name.lower()
        write_bag(self._record_to / f"{mode}_{log.episode.episode_id:016x}", messages)

    def _recorded_message(self, topic: str, message: Any, stamp: int) -> RecordedMessage:
        return RecordedMessage(self.resolve_topic_name(topic), type(message), stamp, serialize_message(message))

    def publish_assessment(self, assessment: Assessment) -> None:
        """Publish an assessment, latched, and see that it reaches who listens."""
        self._assessment_publisher.publish(assessment_to_message(assessment, self._campaign, self._next_start))
        self._assessment_publisher.wait_for_all_acked(Duration(seconds=1))
