"""Node `evaluator`: hands out episodes, collects what happens, records it, and publishes the assessment."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from skd_msgs.msg import Assessment as AssessmentMsg
from skd_msgs.msg import Episode as EpisodeMsg
from skd_msgs.msg import EpisodeResult
from skd_sim.choices.graph_options import CommandOptions
from skd_sim.episode.aborts import AbortKind, abort_reason, kind_of
from skd_sim.episode.episode import Episode, EpisodeLog, Outcome
from skd_sim.episode.stamps import NANOSECONDS, next_start, tick_stamp
from skd_sim.errors import UsageError
from skd_sim.messages.command_messages import car_commands
from skd_sim.messages.from_messages import from_stamp
from skd_sim.messages.read_message import read_message
from skd_sim.messages.seal import Seal
from skd_sim.messages.stream_cdr import read_adversary, read_car, read_clock, read_linear
from skd_sim.messages.to_messages import episode_to_message, scenario_text
from skd_sim.nodes.command_search import kind_name
from skd_sim.nodes.composition.place import ComposableNode, Place
from skd_sim.nodes.executor import LockstepExecutor
from skd_sim.nodes.support import (
    ADVERSARY_ODOMETRY,
    ASSESSMENT,
    CLOCK,
    EGO_ODOMETRY,
    EPISODE,
    EPISODE_RESULT,
    LATCHED,
    MARKERS,
    VELOCITY_COMMAND,
    listen,
)
from skd_sim.state import AdversaryState, CarState
from visualization_msgs.msg import MarkerArray

from skd_evaluator.campaign.judge.rating import Rating
from skd_evaluator.campaign.run.assembly import EpisodeKey, Result, Samples, aborted, result_from_message
from skd_evaluator.ros.assessment_message import assessment_to_message
from skd_evaluator.ros.composed import Composed
from skd_evaluator.ros.live_figures import LiveFigures
from skd_evaluator.ros.markers import episode_markers
from skd_evaluator.ros.readiness.failures import Failures
from skd_evaluator.ros.readiness.one_evaluator import OneEvaluator
from skd_evaluator.ros.readiness.readiness import Readiness
from skd_evaluator.ros.readiness.receipts import ReceivedReceipts
from skd_evaluator.ros.readiness.simulator_check import OneSimulator, refuted
from skd_evaluator.ros.readiness.waiting import Awaited, FirstCommands
from skd_evaluator.ros.recording.bag_recorder import SETTLE, BagRecorder
from skd_evaluator.ros.recording.recording import Recording, write_recording

_PLAIN = CommandOptions()
_OPEN = Seal()
_WAKE = 0.1  # s: how often a waiting evaluator looks after the processes
_REPEAT = 2.0  # s: how often an episode that does not begin is said again; between middlewares the first may be lost
_DISCOVERY = 1.0  # s: how long an episode waits for topics that nobody publishes yet; nodes may come later
_FIRST_DISCOVERY = 10.0  # s: the same for a recording's first episode, while the nodes are still starting
_LOST = 10.0  # s: how long after an episode its last states may come, from the last message of all on


def _read_result(data: bytes) -> tuple[int, Any]:
    message = read_message(data, EpisodeResult)
    return from_stamp(message.header.stamp), message


def _stamped(command: tuple[int | None, Any]) -> tuple[int, Any]:
    """Return a command with stamp 0 where its type has none."""
    return command[0] or 0, command[1]


class Evaluator(ComposableNode):
    """Runs episodes through the graph; an `EpisodeRunner`.

    Attributes:
        failures: what is known of the episodes that were aborted, from `begin_campaign` on.
        readiness: whether the stack is ready for the next episode, from `begin_campaign` on.
    """

    def __init__(
        self, context: Context | None = None, name: str = "evaluator", composed: Composed | None = None
    ) -> None:
        """Make the topics on which it speaks; it listens from `begin_campaign` on.

        Args:
            context: ROS context of the graph; by default that of the process.
            name: name of the node; several nodes in one process need different names.
            composed: the nodes with which it shares its process, if there are any.
        """
        super().__init__(name, Place(context=context, exchange=composed.exchange if composed else None))
        self._next_start = NANOSECONDS
        self._samples = Samples()
        self._result: tuple[Result, int] | None = None
        self._refused: str | None = None
        self._key = EpisodeKey("", -1, 0)
        self._recorder: BagRecorder | None = None
        self._looked = 0.0
        self._streams: list[Any] = []
        self._spinner = LockstepExecutor(self, composed.exchange.deliver) if composed else LockstepExecutor(self)
        for other in composed.nodes if composed else ():
            self._spinner.add_node(other)
        self._episode_publisher = self.create_publisher(EpisodeMsg, EPISODE, LATCHED)
        self._assessment_publisher = self.create_publisher(AssessmentMsg, ASSESSMENT, LATCHED)
        self._marker_publisher = self.create_publisher(MarkerArray, MARKERS, LATCHED)
        self._figures = LiveFigures(self)

    def begin_campaign(
        self,
        campaign: str,
        *,
        record_to: Path | None = None,
        silence_limit: float = 120.0,
        check_processes: Callable[[], str | None] = lambda: None,
        before_episode: Callable[[], str | None] = lambda: None,
        after_silence: Callable[[str], None] = lambda _reason: None,
        commands: CommandOptions = _PLAIN,
        own_world: bool = False,
        receipts_of: Sequence[str] = (),
        seal: Seal = _OPEN,
        anew: bool = False,
        settle: float = SETTLE,
        write: Callable[[Recording], None] = write_recording,
        say: Callable[[str], None] | None = None,
        log_folder: Path | None = None,
        patience: float = math.inf,
    ) -> None:
        """Say how the episodes to come are run; to be called once, before the first.

        Args:
            campaign: name of the campaign, in every message and bag.
            record_to: folder for one bag per episode; nothing is recorded by default.
            silence_limit: wall seconds without any sign of the simulator after which an episode is aborted.
            check_processes: called while waiting; returns what is wrong with the graph's processes, if anything.
            before_episode: called before each episode; returns why it cannot begin, as the reason of an abort.
            after_silence: called with the reason when an episode was aborted because somebody did not answer.
            commands: what the car under test publishes, for the record; the same as the simulator's.
            own_world: whether the simulator is SKD's own, so that all that follows from an episode's seed has to agree.
            receipts_of: names of nodes that certainly say what they took an episode for.
            seal: shuts what is announced to all who have not its key.
            anew: whether the car under test is started anew for each episode, so that each is like a first one.
            settle: how long a recording waits, after a result, for the commands of all ticks, wall seconds; long where
                there is certainly one of each tick, short where a node sends them when it likes.
            write: writes what was recorded of an episode, now or behind it.
            say: called with each line for the user; by default it is a warning of this node.
            log_folder: folder with the output of the graph's processes, to be named in errors that one of them caused.
            patience: s after which a stack that sends its commands elsewhere, or so that they are not taken, ends the
                campaign; by default as long as somebody may mend it.
        """
        self._say = self._warn if say is None else say
        self.failures = Failures(self._say, log_folder)
        driven = car_commands(commands)
        drive_topic, walk_topic = map(self.resolve_topic_name, (commands.command_topic, VELOCITY_COMMAND))
        awaited = (Awaited(drive_topic, kind_name(driven.kind)), Awaited(walk_topic, kind_name(TwistStamped)))
        self._first_commands = FirstCommands(self, awaited, self._say, patience)
        self._campaign = campaign
        self._silence_limit = silence_limit
        self._check_processes = check_processes
        self.readiness = Readiness(self, drive_topic, before_episode, self._look_after_processes)
        self._after_silence = after_silence
        self._own_world, self._seal = own_world, seal
        self._anew = anew
        self._listen(EGO_ODOMETRY, Odometry, read_car, self._on_car)
        self._listen(ADVERSARY_ODOMETRY, Odometry, read_adversary, self._on_adversary)
        self._listen(EPISODE_RESULT, EpisodeResult, _read_result, self._on_result)
        *states, results = self._streams
        self._simulator = OneSimulator(self, states, results)
        self._announcer = OneEvaluator(self, campaign)
        self._receipts = ReceivedReceipts(self, receipts_of, self._refuse, seal)
        for one in (self._announcer, self._receipts):  # what they hear is wanted at an episode's ends
            self._spinner.leave(one.subscription)
        if record_to is not None:
            self._listen(CLOCK, Clock, read_clock)
            self._listen(drive_topic, driven.kind, lambda data: _stamped(driven.read(data)))
            self._listen(walk_topic, TwistStamped, read_linear)
            self._recorder = BagRecorder(
                self, record_to, drive_topic, walk_topic, own_world=own_world, patience=settle, write=write
            )
            if own_world:  # another simulator need not publish any
                self._streams.append(self._recorder.scenery.transforms)

    def _warn(self, line: str) -> None:
        self.get_logger().warning(line)

    def destroy_node(self) -> None:
        """Let go of everything."""
        self._spinner.shutdown()
        super().destroy_node()

    def _listen(
        self,
        topic: str,
        kind: type,
        read: Callable[[bytes], tuple[int, Any]],
        handle: Callable[[int, Any], None] = lambda _stamp, _content: None,
    ) -> None:
        """Subscribe to the bytes of a topic: they are recorded as they came."""
        name = self.resolve_topic_name(topic)

        def with_bytes(data: bytes) -> tuple[bytes, int, Any]:
            return bytes(data), *read(data)

        def on_message(data: bytes, stamp: int, content: Any) -> None:
            self._heard = time.monotonic()
            if self._recorder is not None:
                self._recorder.keep(name, kind, stamp, data)
            handle(stamp, content)

        self._streams.append(listen(self, kind, topic, with_bytes, on_message))

    # --- what comes in

    def _on_car(self, stamp: int, car: CarState) -> None:
        if stamp >= self._key.start:
            try:
                self._samples.add_car(stamp, car.x, car.y, car.speed)
            except UsageError as error:
                raise self._simulator.contradiction("car", EGO_ODOMETRY, stamp - self._key.start) from error
            self._figures.take_car(stamp, car)
            if self._marker_publisher.get_subscription_count() > 0:
                self._marker_publisher.publish(
                    episode_markers(self._episode, self._samples, stamp, with_phi=self._seal.is_open)
                )

    def _on_adversary(self, stamp: int, adversary: AdversaryState) -> None:
        if stamp >= self._key.start:
            try:
                self._samples.add_adversary(stamp, adversary.x, adversary.y)
            except UsageError as error:
                raise self._simulator.contradiction("adversary", ADVERSARY_ODOMETRY, stamp - self._key.start) from error
            self._figures.take_adversary(stamp, adversary)

    def _on_result(self, stamp: int, message: Any) -> None:
        if EpisodeKey(message.campaign, int(message.episode_id), from_stamp(message.start)) == self._key:
            try:
                result = result_from_message(message)
            except ValueError as error:
                self._refused = abort_reason(AbortKind.REFUTED, f"its result is none: {error}")
                return
            most = self._episode.scenario.ticks
            if result.ticks > most:
                self._refused = abort_reason(
                    AbortKind.REFUTED, f"its result has {result.ticks} ticks of at most {most}"
                )
            elif self._result is None:
                self._result = result, stamp
                self._ended = time.monotonic()
            elif repr(self._result[0]) != repr(result):
                self._refused = abort_reason(AbortKind.SECOND_SENDER, "two different results came of the episode")

    def give_up(self, reason: str) -> None:
        """Abort the running episode, whose end nobody waits for; to be called while it waits."""
        self._refuse(abort_reason(AbortKind.OTHER, reason))

    def _refuse(self, reason: str) -> None:
        self._refused = self._refused or reason

    # --- episodes

    def run(self, episodes: Sequence[Episode]) -> Iterator[EpisodeLog]:
        """Run episodes one after another and yield their logs.

        Raises:
            AssessmentError: the graph cannot go on, or one episode after the other fails at its start.
        """
        for episode in episodes:
            log = self.run_episode(episode)
            self.failures.note(log)
            yield log

    def run_episode(self, episode: Episode) -> EpisodeLog:
        """Run one episode to its end; one that cannot be finished comes back as ABORTED with the reason.

        Raises:
            AssessmentError: there are two simulators or evaluators, or the graph's processes die again and again.
        """
        hindrance = self.readiness.take()
        recorder = self._recorder if self._recorder is not None and self._recorder.takes(episode) else None
        first = recorder is not None and (self._anew or self._next_start == NANOSECONDS)
        patience = max(_DISCOVERY, min(_FIRST_DISCOVERY, self._silence_limit)) if first else _DISCOVERY
        self.readiness.find_publishers(self._streams, self._spinner.spin_once, patience, anew=self._anew)
        self._look_after_processes()  # what died since the last episode is no fault of this one
        start = self._next_start
        self._key = EpisodeKey(self._campaign, episode.episode_id, start)
        latest_end = tick_stamp(start, episode.scenario.ticks, episode.scenario.time_step)
        self._next_start = next_start(latest_end)  # also where an error ends this one
        self._episode = episode
        self._samples.clear()
        self._figures.begin(episode, start, with_phi=self._seal.is_open)
        self._result = self._refused = None
        if self._recorder is not None:  # it forgets the last episode, whether this one is to be kept or not
            self._recorder.begin(self._key, latest_end)
        specification = episode_to_message(episode, self._campaign, start)
        message = self._seal.shut(specification, scenario_text(episode.shown_scenario))
        self._heard = self._published = time.monotonic()
        if hindrance is None:
            announcement = self._announcer.announce(message)
            self._receipts.begin(episode, self._campaign, start)
            self._episode_publisher.publish(announcement)
            self._first_commands.begin(start)
            problem = self._wait(episode, start, announcement)
            self._first_commands.end()
        else:
            problem = hindrance
        self._require_one_evaluator()  # also by what came with the result
        problem = self._refute(episode, start) or problem
        if self._result is None:
            end = self._newest()
            result = Result(Outcome.ABORTED, self._complete_ticks(episode, start), math.nan, math.nan, problem)
        else:
            result, stamp = self._result
            if recorder is not None:
                recorder.settle(episode, result, self._spinner.spin_once)
            end = max(stamp, self._newest())
        # Beyond every tick that this episode might have had: the simulator may go on with it for a while, and a node
        # that gets the next one's first state before its specification must not take it for a tick of this one.
        self._next_start = next_start(max(end, latest_end))
        whole = self._samples.missing(episode, start, result) == 0
        log = self._samples.log(episode, start, result) if whole else aborted(episode, result.reason)
        if recorder is not None:
            recorder.write(specification, log, result, end, unsaid=self._result is None)
        if kind_of(log.reason) == AbortKind.NO_ANSWER:
            self._after_silence(log.reason)
        return log

    def _refute(self, episode: Episode, start: int) -> str | None:
        """Take back a result that is not the simulator's or that its states contradict, and return the reason."""
        if self._result is None:
            return None
        result = self._result[0]
        problem = self._simulator.foreign_sender() or self._refused
        if problem is None and self._samples.missing(episode, start, result) == 0:
            problem = refuted(self._samples.log(episode, start, result), own_world=self._own_world)
        if problem is not None:
            self._result = None
        return problem

    def _newest(self) -> int:
        return max([self._key.start, *self._samples.car, *self._samples.adversary])

    def _complete_ticks(self, episode: Episode, start: int) -> int:
        """Return the last tick up to which every state has come."""
        step = episode.scenario.time_step
        ticks = 0
        while all(tick_stamp(start, ticks + 1, step) in side for side in (self._samples.car, self._samples.adversary)):
            ticks += 1
        return ticks

    def _wait(self, episode: Episode, start: int, announcement: bytes) -> str:
        """Return when the result and all that belongs to it are here, or, with the reason, when they cannot come."""
        self._simulator.require()
        self._require_one_evaluator()
        while True:
            self._spinner.spin_once(timeout_sec=_WAKE)
            now = time.monotonic()
            if self._refused is not None:
                self._result = None
                return self._simulator.foreign_sender() or self._refused
            if self._result is not None:
                result = self._result[0]
                aborted_long_ago = result.outcome == Outcome.ABORTED and now - self._ended > SETTLE
                if aborted_long_ago or (self._samples.missing(episode, start, result) == 0 and not self._awaits()):
                    return ""
            if now - self._looked < _WAKE:
                continue
            if len(self._samples.car) >= 2:
                self._first_commands.end()
            else:
                self._first_commands.look(state_came=bool(self._samples.car))
                if now - self._published > _REPEAT:
                    self._published = now
                    self._episode_publisher.publish(announcement)
            problem = self._look_after_processes() or self._simulator.foreign_sender()
            self._simulator.require()
            if problem is None and self._result is not None and now - max(self._heard, self._ended) > _LOST:
                problem = self._lost(episode, start, self._result[0])
            if problem is None and now - self._heard > self._silence_limit:
                said = f"nothing was heard of the vehicle simulator for {self._silence_limit:g} s"
                problem = abort_reason(AbortKind.NO_ANSWER, said)
            if problem is not None:
                latest = now + SETTLE
                while time.monotonic() < latest:  # what was sent before it happened belongs to the episode
                    self._spinner.spin_once(timeout_sec=SETTLE)
                self._result = None
                return problem

    def _require_one_evaluator(self) -> None:
        self._spinner.take(self._announcer.subscription)
        self._announcer.require()

    def _awaits(self) -> list[str]:
        """Return who has not said what it took the episode for; who failed need not."""
        self._spinner.take(self._receipts.subscription)
        aborted = self._result is not None and self._result[0].outcome == Outcome.ABORTED
        return [] if aborted else self._receipts.awaited()

    def _lost(self, episode: Episode, start: int, result: Result) -> str:
        if self._samples.missing(episode, start, result) == 0:
            silent = f"{' and '.join(self._awaits())} did not say what it took the episode for"
            return abort_reason(AbortKind.UNASKED, silent)
        lost, count = self._samples.missing(episode, start, result), 2 * (result.ticks + 1)
        said = f"the episode ended, and {lost} of its {count} states have not come {_LOST:g} s later"
        return abort_reason(AbortKind.LOST, f"{said}: this machine has too much to do, or the network loses messages")

    def _look_after_processes(self) -> str | None:
        self._looked = time.monotonic()
        return self._check_processes()

    def publish_assessment(self, rating: Rating) -> None:
        """Publish an assessment, latched, and see that it reaches who listens."""
        self._assessment_publisher.publish(assessment_to_message(rating, self._campaign, self._next_start))
        self._assessment_publisher.wait_for_all_acked(Duration(seconds=1))
