"""What the nodes share: names of topics, quality of service, parameters with ranges, following episodes, and `main`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Any

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from skd_msgs.msg import Episode as EpisodeMsg

from skd_sim.errors import AssessmentError, UsageError
from skd_sim.inputs.files import nearest
from skd_sim.interruption import END_LIMIT, Interruption, end_within
from skd_sim.options.options import CommandOptions, Option, options_of
from skd_sim.ros.from_messages import from_stamp
from skd_sim.world.episode import period_of


class Topic(StrEnum):
    """Names of topics, relative ones below a node's namespace."""

    CLOCK = "/clock"
    TF = "/tf"
    TF_STATIC = "/tf_static"
    ROBOT_DESCRIPTION = "robot_description"
    EGO_ODOMETRY = "ego/odometry"
    EGO_IMU = "ego/imu"
    EGO_SCAN = "ego/scan"
    EGO_POINTS = "ego/points"
    ADVERSARY_ODOMETRY = "adversary/odometry"
    ADVERSARY_DETECTIONS = "adversary/detections"
    ACCELERATION_COMMAND = CommandOptions.command_topic
    VELOCITY_COMMAND = "adversary/velocity_command"
    EPISODE = "skd/episode"
    EPISODE_RESULT = "skd/episode_result"
    ASSESSMENT = "skd/assessment"
    MARKERS = "skd/markers"
    CLEARANCE = "skd/clearance"
    DEVIATION = "skd/deviation"
    COMMAND = "skd/command"
    DIAGNOSTICS = "/diagnostics"
    BELIEVED_CAR = "skd/believed_car"


STREAM = QoSProfile(depth=4000, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.RELIABLE)
"""States, commands and results: none may be lost.

The lockstep waits for who answers, not for who listens: an evaluator that gets no processor for a tenth of a second has
a hundred states of a car that decides 20 times a second to catch up with. Fast DDS keeps 5,000 at most.
"""

LATCHED = QoSProfile(
    depth=1,
    history=HistoryPolicy.KEEP_LAST,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""The current episode and the last assessment: a node that joins late gets it."""

_LONGEST_WAIT = 0.05  # s
_OF_OTHERS = ("qos_overrides.", "use_sim_time", "start_type_description_service")
"""Parameters that rclpy itself looks after, some of them later."""


class GraphNode(Node):
    """A node without rclpy's own events (of quality of service that does not fit): each turn would look at all of them.

    Why nothing comes of a publisher is said by `command_search`.
    """

    def create_publisher(self, *arguments: Any, **options: Any) -> Any:
        """As a node's."""
        events = PublisherEventCallbacks(use_default_callbacks=False)
        return super().create_publisher(*arguments, event_callbacks=events, **options)

    def create_subscription(self, *arguments: Any, **options: Any) -> Any:
        """As a node's."""
        events = SubscriptionEventCallbacks(use_default_callbacks=False)
        return super().create_subscription(*arguments, event_callbacks=events, **options)


def descriptor_of(one: Option) -> ParameterDescriptor:
    """Return what `ros2 param describe` shows of an option; it cannot be changed while the node runs."""
    text = f"{one.text}; {one.absent or 'empty'}: {one.unset}" if one.unset else one.text
    descriptor = ParameterDescriptor(description=text, read_only=True)
    if one.texts:
        descriptor.additional_constraints = f"one of: {', '.join(one.texts)}"
    if one.low is not None and one.high is not None:
        if isinstance(one.plain_default, int):
            descriptor.integer_range = [IntegerRange(from_value=int(one.low), to_value=int(one.high), step=1)]
        else:
            whole = FloatingPointRange(from_value=float(one.low), to_value=float(one.high), step=0.0)
            descriptor.floating_point_range = [whole]
    return descriptor


def declare(node: Node, *tables: Callable[..., Any]) -> dict[str, Any]:
    """Declare the options of tables as parameters and return their values, as plain data.

    Raises:
        UsageError: a value that was given is of the wrong type or not allowed.
    """
    values = {}
    for one in (one for table in tables for one in options_of(table)):
        try:
            value = node.declare_parameter(one.name, one.plain_default, descriptor_of(one)).value
        except ParameterException as error:
            raise UsageError(f"{node.get_name()}: {error}") from error
        if one.texts and value not in one.texts:
            allowed = ", ".join(one.texts)
            raise UsageError(f"{node.get_name()}: parameter {one.name} must be one of {allowed}; got {value!r}")
        values[one.name] = value
    _warn_of_unknown(node)
    return values


def _warn_of_unknown(node: Node) -> None:
    """Warn of parameters that were given but that the node does not have; rclpy ignores them."""
    for name in node._parameter_overrides:
        if not node.has_parameter(name) and not name.startswith(_OF_OTHERS):
            near = nearest(name, node._parameters)
            hint = f"; did you mean {near}?" if near else ""
            node.get_logger().warning(f"there is no parameter {name}{hint}")


def spin(node: Node, ended: Callable[[], bool] = lambda: False) -> None:
    """Run a node's callbacks until it has ended, which is looked at at least every 0.05 s: a signal may come unseen.

    Raises:
        ExternalShutdownException: the context is shut down.
    """
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    try:
        while not ended():
            executor.spin_once(timeout_sec=_LONGEST_WAIT)
    finally:
        executor.remove_node(node)
        executor.shutdown()


def run_node(
    make: Callable[[], Node],
    args: Sequence[str] | None,
    work: Callable[[Any], int] | None = None,
    *,
    interrupted: int = 0,
) -> int:
    """Run a node and return the process's exit code.

    Signals are listened to here, not by rclpy, whose own thread would wake executors and shut contexts down while this
    one takes them apart: it then reads what is freed.

    Args:
        make: makes the node; a ValueError from here on is one line and exit code 2.
        args: arguments of the command line.
        work: what the node does, and its exit code; by default it answers messages until a signal comes.
        interrupted: exit code where a signal ends it; the end of a node that only answers is no failure.
    """
    node: Node | None = None
    code, failed = interrupted, False
    with Interruption() as interruption:
        try:
            rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
            node = make()
            if not interruption.came:  # numba, for one, may have lost it
                if work is not None:
                    code = work(node)
                else:
                    spin(node, lambda: interruption.came)
        except (KeyboardInterrupt, ExternalShutdownException):
            pass
        except (ValueError, AssessmentError) as error:
            rclpy.logging.get_logger("skd").fatal(str(error))
            code = 2 if isinstance(error, ValueError) else 1
        except Exception:
            # Numba loses an interrupt that comes while LLVM works, and then fails on what was not compiled, which is no
            # error of its own.
            if not interruption.came:
                failed = True
                raise
        finally:
            # Ctrl-C in a terminal comes twice below `ros2 launch`: from the terminal and from the launch.
            interruption.held = True
            with end_within(END_LIMIT, code):
                if node is not None and not failed:  # else it goes with the process, when the error is said
                    node.destroy_node()
                rclpy.try_shutdown()
    return code


class Moments:
    """Puts together what several topics say of one moment, whatever comes first.

    Attributes:
        needed: what has to be there of a moment.
    """

    def __init__(self, *needed: object) -> None:
        """Begin without anything."""
        self.needed = set(needed)
        self._seen: dict[int, dict[Any, Any]] = {}

    def put(self, stamp: int, part: object, value: Any) -> dict[Any, Any] | None:
        """Add a part at a stamp (ns); return all of the moment where that is whole now, and forget what is older."""
        seen = self._seen.setdefault(stamp, {})
        seen[part] = value
        if not self.needed <= seen.keys():
            return None
        self._seen = {other: kept for other, kept in self._seen.items() if other > stamp}
        return seen


class EpisodeFollower:
    """Hands each message to its tick, and control period, of the current episode.

    Attributes:
        episode: the current one, once there is one.
    """

    def __init__(
        self,
        node: Node,
        read: Callable[[Any], Any],
        begin: Callable[[Any], None],
        at_frame: Callable[[int, int, int, Any], None],
    ) -> None:
        """Subscribe to episodes.

        Args:
            node: node that follows the episodes.
            read: gives what the node knows of an episode by the message that announces it.
            begin: called with each new episode; a ValueError from it or from `read` is logged, the episode ignored.
            at_frame: called with (tick, control period in it, stamp in ns, item) for each item of the current episode.
        """
        self.episode: Any = None
        self._start = 0
        self._node, self._read = node, read
        self._begin = begin
        self._at_frame = at_frame
        self._identity = ("", -1, 0)
        self._latest = (0, 0)
        self._early: list[tuple[int, Any]] = []
        node.create_subscription(EpisodeMsg, Topic.EPISODE, self._on_episode, LATCHED)

    def _on_episode(self, message: Any) -> None:
        start = from_stamp(message.header.stamp)
        identity = (str(message.campaign), int(message.episode_id), start)
        if self.episode is not None and identity == self._identity:
            return  # said again, because it had not begun everywhere
        self._identity = identity
        self._start = start
        try:
            episode = self._read(message)
            self._begin(episode)
        except ValueError as error:
            self._node.get_logger().error(f"an episode is ignored: {error}")
            self.episode = None
            return
        self.episode, self._latest = episode, (0, 0)
        early, self._early = self._early, []
        for stamp, item in early:
            self.deliver(stamp, item)

    def deliver(self, stamp: int, item: Any) -> None:
        """Hand over what was stamped `stamp` (ns), now or when its episode begins."""
        if self.episode is not None:
            scenario = self.episode.scenario
            place = period_of(stamp, self._start, scenario.time_step, scenario.control_periods)
            if place is not None and self._latest <= place <= (scenario.ticks, 0):
                self._latest = place
                self._at_frame(*place, stamp, item)
                return
            if place is not None and place < self._latest:
                # Time ran back: another evaluator has begun, and its episode is still on its way. Answering as in the
                # old one would be wrong.
                self.episode = None
        # Only tick 0 of the next episode can come early: all nodes wait for each other there.
        self._early = [*self._early[-1:], (stamp, item)]
