"""The evaluator in the graph: hands out episodes, collects what happens, records it, and publishes the assessment.

Simulator and adversary may be plain objects in its process, which hear each other by calls (`Composed`). Topics then
carry the states to the car and its commands back, and whatever other nodes listen to. While the adversary plans, the
car decides.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from geometry_msgs.msg import AccelStamped, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from skd_adversary.ros.adversary_node import GraphAdversary
from skd_msgs.msg import Assessment as AssessmentMsg
from skd_msgs.msg import Episode as EpisodeMsg
from skd_msgs.msg import EpisodeResult
from skd_sim.errors import AssessmentError, UsageError
from skd_sim.options.car_and_adversary import is_own_world
from skd_sim.options.options import CommandOptions
from skd_sim.ros.commands import car_commands
from skd_sim.ros.diagnosis import Awaited, kind_name, living_publishers, second_publisher
from skd_sim.ros.from_messages import from_stamp, odometry_to_adversary, odometry_to_car
from skd_sim.ros.simulator_node import GraphSimulator
from skd_sim.ros.support import LATCHED, STREAM, GraphNode, Topic
from skd_sim.ros.to_messages import episode_to_message, to_stamp
from skd_sim.simulators.simulator import Frame, NamedSimulator
from skd_sim.world.episode import (
    NANOSECONDS,
    AbortKind,
    EpisodeLog,
    EpisodeSpec,
    Outcome,
    abort_reason,
    kind_of,
    next_start,
    tick_stamp,
)
from skd_sim.world.state import AdversaryState, CarState
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from skd_evaluator.assessment.assessment import Assessment
from skd_evaluator.assessment.figure_table import Of, keys_of
from skd_evaluator.assessment.files.assessment_json import figure
from skd_evaluator.assessment.options import GraphOptions
from skd_evaluator.assessment.plausibility import examine
from skd_evaluator.assessment.run.episodes import EpisodeEnd, EpisodeKey, Samples, aborted, result_from_message
from skd_evaluator.driving.drive import Show
from skd_evaluator.ros.processes import AbortedEpisodes
from skd_evaluator.ros.recording import SETTLE, BagRecorder, recorded_name
from skd_evaluator.ros.stack import FirstCommands, Health
from skd_evaluator.ros.visualization import LiveFigures, episode_markers

_FIGURES = ("double", "double[2]", "boolean")
"""Kinds of fields that say something of the car; the others count episodes."""


def _field(kind: str, value: Any) -> Any:
    """Return a figure as a field of a message has it: nan, or false, where it is not defined."""
    if kind == "double":
        return math.nan if value is None else float(value)
    if kind == "double[2]":
        return [math.nan, math.nan] if value is None else [float(value[0]), float(value[1])]
    return bool(value) if kind == "boolean" else value


def _ends(ends: Sequence[float | None], text: str) -> list[float]:
    """Return an interval whose ends may lie beyond what was compared; of those the text says on which side."""
    sides = [math.inf if word.startswith("above") else -math.inf for word in text.strip("[]").split(", ")]
    return [side if end is None else end for end, side in zip(ends, sides, strict=True)]


def assessment_to_message(assessment: Assessment, campaign: str, stamp: int) -> AssessmentMsg:
    """Return the message of an assessment published at simulation time `stamp` (ns).

    A field has the figure of its name. Figures that are not credible are not defined: a reader of the message sees no
    warning beside it.
    """
    settings, unsaid = keys_of(Of.SETTING), not assessment.credible
    result = assessment.as_dict()
    name = "equivalent_multiplier"
    text, interval = result[f"{name}_text"], result[f"{name}_ci95_text"]
    equivalent = {
        name: figure(result, name) if text else None,
        f"{name}_ci95": _ends(result[f"{name}_ci95"], interval) if interval else None,
    }
    found = {**result, **equivalent, "campaign": campaign, "scenario_name": assessment.plan.scenario.name}
    message = AssessmentMsg()
    for field, kind in message.get_fields_and_field_types().items():
        if field != "header":
            of_the_car = kind in _FIGURES and field not in settings
            setattr(message, field, _field(kind, None if unsaid and of_the_car else found[field]))
    message.header.stamp = to_stamp(stamp)
    return message


class Composed:
    """Simulator and adversary as objects of the evaluator's process, which speak through its node."""

    def __init__(self, evaluator: Evaluator, options: GraphOptions) -> None:
        """Make both; the evaluator hears each state, the result of each episode, and why it cannot go on."""
        self._evaluator = evaluator
        self._simulator = GraphSimulator(evaluator, NamedSimulator(), options.simulator_parameters(), alone=False)
        self._simulator.on_frame, self._simulator.on_result = self._hear_frame, self._hear_result
        self._adversary = GraphAdversary(evaluator)
        self._due: tuple[int, int, CarState] | None = None

    def begin(self, episode: EpisodeSpec, message: EpisodeMsg) -> None:
        """Begin an episode, which a message says to others."""
        self._due = None
        try:
            self._adversary.begin(episode)
        except Exception as error:  # an objective may be of another package
            self._fail(error)
        else:
            self._simulator.begin(message)

    def work(self) -> None:
        """Let the adversary decide, if it is its turn; to be called when all others have been heard."""
        if self._due is None:
            return
        (tick, stamp, car), self._due = self._due, None
        try:
            velocity = self._adversary.answer(tick, stamp, car)
        except Exception as error:
            self._fail(error)
            return
        if velocity is not None:
            self._simulator.walk(stamp, velocity)

    def _fail(self, error: Exception) -> None:
        said = str(error).partition("\n")[0]
        self._evaluator.refuse(AbortKind.FAILED, f"adversary: {type(error).__name__}: {said}")

    def _hear_frame(self, stamp: int, frame: Frame) -> None:
        self._evaluator.hear_frame(stamp, frame)
        if not frame.period and frame.outcome == Outcome.RUNNING:  # the car decides in between, the adversary does not
            self._due = frame.tick, stamp, frame.car

    def _hear_result(self, result: Any) -> None:
        self._due = None  # the last state needs no answer
        self._evaluator.hear_result(result)


_PLAIN = CommandOptions()
_WAKE = 0.1  # s: how often a waiting evaluator looks after the processes
_REPEAT = 2.0  # s: how often an episode that does not begin is said again; between middlewares the first may be lost
_DISCOVERY = 1.0  # s: how long an episode waits for topics that no node publishes yet; nodes may come later
_FIRST_DISCOVERY = 10.0  # s: the same for a recording's first episode, while the nodes are still starting
_LOST = 10.0  # s: how long after an episode its last states may come, from the last message of all on
_LOCKSTEP_SETTLE = 2.0  # s: a command of each tick is certain to come, unless its sender has not found us yet
_OURS = (Topic.EPISODE, Topic.EPISODE_RESULT, Topic.EGO_ODOMETRY, Topic.ADVERSARY_ODOMETRY)  # one node publishes each


class Evaluator(GraphNode):
    """Runs episodes through the graph; a `Runner`.

    Attributes:
        failures: what is known of the episodes that were aborted, from `begin_campaign` on.
    """

    def __init__(
        self, context: Context | None = None, composed: GraphOptions | None = None, **node_arguments: Any
    ) -> None:
        """Make the topics on which it speaks; it listens from `begin_campaign` on.

        Args:
            context: ROS context of the graph; by default that of the process.
            composed: how the graph is run, if simulator and adversary are in this process; None: they are not.
            node_arguments: further arguments of `rclpy.node.Node`.
        """
        super().__init__("evaluator", context=context, **node_arguments)
        self._next_start = NANOSECONDS
        self._samples = Samples()
        self._result: tuple[EpisodeEnd, int] | None = None
        self._refused: str | None = None
        self._key = EpisodeKey("", -1, 0)
        self._recorder: BagRecorder | None = None
        self._looked = 0.0
        self._streams: list[Any] = []
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self)
        self._episode_publisher = self.create_publisher(EpisodeMsg, Topic.EPISODE, LATCHED)
        self._assessment_publisher = self.create_publisher(AssessmentMsg, Topic.ASSESSMENT, LATCHED)
        self._marker_publisher = self.create_publisher(MarkerArray, Topic.MARKERS, LATCHED)
        self._figures, self._health = LiveFigures(self), Health(self)
        self._composed = None if composed is None else Composed(self, composed)

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
        anew: bool = False,
        answers_each_state: bool | None = None,
        say: Callable[[str], None] | None = None,
        log_folder: Path | None = None,
    ) -> None:
        """Say how the episodes to come are run; to be called once, before the first.

        Args:
            campaign: name of the campaign, in every message and bag.
            record_to: folder for one bag per episode; nothing is recorded by default.
            silence_limit: wall seconds without any sign of the simulator after which an episode is aborted.
            check_processes: called while waiting; returns what is wrong with the graph's processes, if anything.
            before_episode: called before each episode; returns why it cannot begin, as the reason of an abort.
            after_silence: called with the reason when an episode was aborted because a node did not answer.
            commands: what the car under test publishes, for the record; the same as the simulator's.
            own_world: whether the simulator is SKD's own, so that all that follows from an episode's seed has to agree.
            anew: whether the car under test is started anew for each episode, so that each is like a first one.
            answers_each_state: whether every state gets a command with its stamp, for which a recording waits longer;
                else a command without a stamp is one as well. None: it is not known.
            say: called with each line for the user; by default it is a warning of this node.
            log_folder: folder with the output of the graph's processes, to be named in errors that one of them caused.
        """
        say = say or self.get_logger().warning
        self.failures = AbortedEpisodes(say, log_folder)
        self._campaign, self._silence_limit = campaign, silence_limit
        self._check_processes, self._before_episode = check_processes, before_episode
        self._after_silence = after_silence
        self._own_world, self._anew = own_world, anew
        driven = car_commands(commands)
        self._drive_topic, walk_topic = map(self.resolve_topic_name, (commands.command_topic, Topic.VELOCITY_COMMAND))
        if self._composed is None:
            self._listen(Topic.EPISODE_RESULT, EpisodeResult, self.hear_result)
        self._first_commands = FirstCommands(
            self,
            Awaited(self._drive_topic, kind_name(driven.kind)),
            say,
            by_stamp=answers_each_state is not False,
            walk_topic=walk_topic if self._composed is None else "",
        )
        if self._composed is None or record_to is not None:
            self._listen(Topic.EGO_ODOMETRY, Odometry, self._on_car)
            self._listen(Topic.ADVERSARY_ODOMETRY, Odometry, self._on_adversary)
        if record_to is not None:
            self._listen(Topic.CLOCK, Clock, stamp=lambda message: from_stamp(message.clock))
            self._listen(commands.command_topic, driven.kind, stamp=lambda message: driven.read(message)[0] or 0)
            self._listen(Topic.VELOCITY_COMMAND, TwistStamped)
            self._listen(Topic.TF, TFMessage, stamp=_stamp_of_transforms)
            self._listen(Topic.COMMAND, AccelStamped)
            settle = _LOCKSTEP_SETTLE if answers_each_state and driven.stamped else SETTLE
            drive, walk = (recorded_name(self, one) for one in (commands.command_topic, Topic.VELOCITY_COMMAND))
            self._recorder = BagRecorder(self, record_to, drive, walk, own_world=own_world, patience=settle, say=say)

    def destroy_node(self) -> None:
        """Let go of everything."""
        self._executor.shutdown()
        super().destroy_node()

    def _listen(
        self,
        topic: str,
        kind: type,
        handle: Callable[[Any], None] = lambda _message: None,
        stamp: Callable[[Any], int] = lambda message: from_stamp(message.header.stamp),
    ) -> None:
        """Subscribe to the bytes of a topic: they are recorded as they came."""
        name = recorded_name(self, topic)

        def on_bytes(data: bytes) -> None:
            if topic != Topic.TF:  # a stack sends transforms too, whether or not the simulator goes on
                self._heard = time.monotonic()
            message = deserialize_message(data, kind)
            if self._recorder is not None:
                self._recorder.keep(name, kind, stamp(message), bytes(data))
            if self._composed is None:  # else it was heard by a call
                handle(message)

        self._streams.append(self.create_subscription(kind, topic, on_bytes, STREAM, raw=True))

    # --- what comes in

    def hear_frame(self, stamp: int, frame: Frame) -> None:
        """Take a state of this process's simulator, with its stamp (ns)."""
        self._heard = time.monotonic()
        self._add(stamp, frame.adversary)
        self._add(stamp, frame.car)

    def _on_car(self, message: Odometry) -> None:
        self._add(from_stamp(message.header.stamp), odometry_to_car(message))

    def _on_adversary(self, message: Odometry) -> None:
        self._add(from_stamp(message.header.stamp), odometry_to_adversary(message))

    def _add(self, stamp: int, state: CarState | AdversaryState) -> None:
        if stamp < self._key.start:
            return
        try:
            self._samples.add(stamp, state)
        except UsageError as error:
            self._require_alone()
            of_car = isinstance(state, CarState)
            whose, topic = ("car", Topic.EGO_ODOMETRY) if of_car else ("adversary", Topic.ADVERSARY_ODOMETRY)
            where = f"{(stamp - self._key.start) / NANOSECONDS:.3f} s of the episode"
            who = f"another node has published {self.resolve_topic_name(topic)}, or the simulator contradicts itself"
            raise AssessmentError(f"two different states of the {whose} came for {where}: {who}") from error
        self._figures.take(stamp, state)
        if isinstance(state, CarState) and self._marker_publisher.get_subscription_count():
            self._marker_publisher.publish(episode_markers(self._episode, self._samples, stamp))

    def hear_result(self, message: EpisodeResult) -> None:
        """Take the result of an episode."""
        if EpisodeKey(message.campaign, int(message.episode_id), from_stamp(message.start)) == self._key:
            result, most = result_from_message(message), self._episode.scenario.ticks
            if result.ticks > most:
                self.refuse(AbortKind.REFUTED, f"its result has {result.ticks} ticks of at most {most}")
            elif self._result is None:
                self._result = result, from_stamp(message.header.stamp)
                self._ended = time.monotonic()
                if self._composed is not None and self._recorder is not None:
                    name, data = recorded_name(self, Topic.EPISODE_RESULT), serialize_message(message)
                    self._recorder.keep(name, EpisodeResult, self._result[1], data)

    def watch(self, show: Show, commands: CommandOptions) -> None:
        """Call a function with each situation from now on; its commands are of the kind that the options say."""
        self._figures.watch(show, commands)

    def refuse(self, kind: AbortKind, why: str) -> None:
        """Abort the running episode, whose end is not waited for; to be called while it waits."""
        self._refused = self._refused or abort_reason(kind, why)

    # --- episodes

    def run(self, episodes: Sequence[EpisodeSpec]) -> Iterator[EpisodeLog]:
        """Run episodes one after another and yield their logs.

        Raises:
            AssessmentError: the graph cannot go on, or one episode after the other fails at its start.
        """
        for episode in episodes:
            log = self.run_episode(episode)
            self.failures.note(log)
            yield log

    def run_episode(self, episode: EpisodeSpec) -> EpisodeLog:
        """Run one episode to its end; one that cannot be finished comes back as ABORTED with the reason.

        Raises:
            AssessmentError: there are two simulators or evaluators, or the graph's processes die again and again.
        """
        problem = self._before_episode()
        recorder = self._recorder if self._recorder is not None and self._recorder.takes(episode) else None
        first = recorder is not None and (self._anew or self._next_start == NANOSECONDS)
        self._find_publishers(max(_DISCOVERY, min(_FIRST_DISCOVERY, self._silence_limit)) if first else _DISCOVERY)
        self._check_processes()  # what died since the last episode is no fault of this one
        self._require_alone()
        start = self._next_start
        self._key = EpisodeKey(self._campaign, episode.episode_id, start)
        latest_end = tick_stamp(start, episode.scenario.ticks, episode.scenario.time_step)
        self._next_start = next_start(latest_end)  # also where an error ends this one
        self._episode = episode
        self._samples.clear()
        self._figures.begin(episode, start)
        self._result = self._refused = None
        if self._recorder is not None:  # it forgets the last episode, whether this one is to be kept or not
            self._recorder.begin(self._key, latest_end)
        specification = episode_to_message(episode, self._campaign, start)
        self._heard = self._looked = time.monotonic()
        if problem is None:
            self._announce(episode, specification)
            self._first_commands.begin(start, senses=episode.scenario.sensor is not None)
            problem = self._wait(episode, specification)
            self._first_commands.end()
        problem = self._refused or problem or self._refuted(episode)
        if problem or self._result is None:
            self._result, end = None, self._newest()
            result = EpisodeEnd(Outcome.ABORTED, self._complete_ticks(episode), math.nan, math.nan, problem)
        else:
            result, stamp = self._result
            if recorder is not None:
                recorder.settle(episode, result, self._spin)
            end = max(stamp, self._newest())
        # Beyond every tick that this episode might have had: the simulator may go on with it for a while, and a node
        # that gets the next one's first state before its specification must not take it for a tick of this one.
        self._next_start = next_start(max(end, latest_end))
        whole = self._samples.missing(episode, start, result) == 0
        log = self._samples.log(episode, start, result) if whole else aborted(episode, result.reason)
        if recorder is not None:
            recorder.write(specification, log, self._samples, result, end, unsaid=self._result is None)
        self._publish_health([log.reason] if log.reason else [])
        if kind_of(log.reason) == AbortKind.NO_ANSWER:
            self._after_silence(log.reason)
        return log

    def _find_publishers(self, patience: float) -> None:
        """Wait, a moment at most, until something is heard on all subscriptions: nodes find each other one by one.

        The simulator begins as soon as *it* hears a controller, so a recording that did not wait for one which takes
        seconds to start would lack its first commands. Of a controller that has just been started anew, the messages of
        the one before do not count.
        """
        latest = time.monotonic() + patience
        while time.monotonic() < latest and not (
            all(one.get_publisher_count() for one in self._streams)
            and (not self._anew or living_publishers(self, self._drive_topic))
        ):
            self._spin(0.01)
            if time.monotonic() - self._looked > _WAKE:
                self._looked = time.monotonic()
                self._check_processes()

    def _announce(self, episode: EpisodeSpec, specification: EpisodeMsg) -> None:
        self._published = time.monotonic()
        self._episode_publisher.publish(specification)
        if self._composed is not None:
            self._composed.begin(episode, specification)

    def _spin(self, seconds: float) -> None:
        """Run a callback that is due within so many seconds, and then what it has left to do."""
        self._executor.spin_once(timeout_sec=seconds)
        if self._composed is not None:
            self._composed.work()

    def _missing(self, episode: EpisodeSpec) -> int:
        """Return how many states of the episode, whose result is there, have not come."""
        assert self._result is not None
        return self._samples.missing(episode, self._key.start, self._result[0])

    def _refuted(self, episode: EpisodeSpec) -> str:
        """Return why a result contradicts its states; empty where it can have happened."""
        if self._result is None or self._missing(episode):
            return ""
        return refuted(self._samples.log(episode, self._key.start, self._result[0]), own_world=self._own_world) or ""

    def _newest(self) -> int:
        return max([self._key.start, *self._samples.car, *self._samples.adversary])

    def _complete_ticks(self, episode: EpisodeSpec) -> int:
        """Return the last tick up to which every state has come."""
        there = self._samples.car.keys() & self._samples.adversary.keys()
        stamps = (tick_stamp(self._key.start, tick, episode.scenario.time_step) for tick in itertools.count(1))
        return sum(1 for _ in itertools.takewhile(there.__contains__, stamps))

    def _wait(self, episode: EpisodeSpec, specification: EpisodeMsg) -> str:
        """Return when the result and all that belongs to it are here, or, with the reason, when they cannot come."""
        while True:
            self._spin(_WAKE)
            now = time.monotonic()
            if self._refused is not None:
                return self._refused
            if self._result is not None:
                aborted_long_ago = self._result[0].outcome == Outcome.ABORTED and now - self._ended > SETTLE
                if aborted_long_ago or self._missing(episode) == 0:
                    return ""
            if now - self._looked < _WAKE:
                continue
            self._looked = now
            if len(self._samples.car) >= 2:
                self._first_commands.end()
            else:
                self._first_commands.look(state_came=bool(self._samples.car))
                if self._composed is None and now - self._published > _REPEAT:
                    self._announce(episode, specification)
            self._publish_health(self._first_commands.reasons)
            problem = self._check_processes()
            self._require_alone()
            if problem is None and self._result is not None and now - max(self._heard, self._ended) > _LOST:
                lost, count = self._missing(episode), 2 * (self._result[0].ticks + 1)
                said = f"the episode ended, and {lost} of its {count} states have not come {_LOST:g} s later"
                why = "this machine has too much to do, or the network loses messages"
                problem = abort_reason(AbortKind.LOST, f"{said}: {why}")
            if problem is None and now - self._heard > self._silence_limit:
                said = f"nothing was heard of the vehicle simulator for {self._silence_limit:g} s"
                problem = abort_reason(AbortKind.NO_ANSWER, said)
            if problem is not None:
                latest = now + SETTLE
                while time.monotonic() < latest:  # what was sent before it happened belongs to the episode
                    self._spin(SETTLE)
                return problem

    def _publish_health(self, reasons: Sequence[str]) -> None:
        facts = {
            "campaign": self._campaign,
            "episode": self._episode.episode_id,
            "mode": self._episode.mode.name.lower(),
            "states of the car": len(self._samples.car),
            "aborted episodes": len(self.failures.reasons),
        }
        self._health.publish(reasons, facts)

    def _require_alone(self) -> None:
        """Refuse a graph with a second evaluator or simulator: it could not be said whose episode it runs.

        Raises:
            AssessmentError: with the names of both.
        """
        for topic in _OURS:
            if (several := second_publisher(self, topic)) is not None:
                raise AssessmentError(f"{several}; end all but one")

    def publish_assessment(self, assessment: Assessment) -> None:
        """Publish an assessment, latched, and see that it reaches its subscribers."""
        self._assessment_publisher.publish(assessment_to_message(assessment, self._campaign, self._next_start))
        self._assessment_publisher.wait_for_all_acked(Duration(seconds=1))


def _stamp_of_transforms(message: TFMessage) -> int:
    return from_stamp(message.transforms[0].header.stamp) if message.transforms else 0


def refuted(log: EpisodeLog, *, own_world: bool) -> str | None:
    """Return, as the reason of an abort, why an episode cannot have happened as it is said to; none where it can.

    Args:
        log: what is said to have happened in the episode.
        own_world: whether SKD started the simulator; where the episode asks for SKD's own world, all that follows from
            its seed then has to agree.
    """
    if log.outcome == Outcome.ABORTED:
        return None
    verdict = examine(log)
    if verdict.fault:
        return abort_reason(AbortKind.REFUTED, f"the episode {verdict.fault}")
    if verdict.ours or not (own_world and is_own_world(log.episode.simulator)):
        return None
    said = f"{verdict.where} does not follow from the episode's other states (by {verdict.deviation:.3g})"
    return abort_reason(AbortKind.REFUTED, said)
