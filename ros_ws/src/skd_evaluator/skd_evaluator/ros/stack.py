"""The stack under test: its managed nodes are brought up anew for each episode, and its first commands are awaited.

Managed nodes go up and down through the services of their lifecycle (`lifecycle_msgs`). A reset goes all the way down
and up again: what a node has forgotten by then is settled for cleaning up (it is as after its creation; ROS 2 design,
"Managed nodes") and for nothing less.

While the first commands of an episode are awaited, a line says why they do not come; where waiting does not mend it,
it is given up within ten seconds.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from skd_sim.errors import AssessmentError
from skd_sim.ros.diagnosis import Awaited, Evidence, Heard, class_of, diagnose, living_publishers
from skd_sim.ros.support import Topic
from skd_sim.world.episode import AbortKind, abort_reason

_WAKE = 0.1  # s
_LOST_AFTER = 2.0
"""s after which an answer counts as lost: a server drops it if it discovers the client too late (after 0.1 s)."""
_FAREWELL = 2.0  # s in which all nodes together have to be down at the end
_DOWN = {State.PRIMARY_STATE_ACTIVE: Transition.TRANSITION_DEACTIVATE}
_DOWN[State.PRIMARY_STATE_INACTIVE] = Transition.TRANSITION_CLEANUP
_UP = (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
_CALLED = {
    Transition.TRANSITION_CONFIGURE: "configure",
    Transition.TRANSITION_ACTIVATE: "activate",
    Transition.TRANSITION_DEACTIVATE: "deactivate",
    Transition.TRANSITION_CLEANUP: "clean up",
}
_STATES = {State.PRIMARY_STATE_UNCONFIGURED: "unconfigured", State.PRIMARY_STATE_INACTIVE: "inactive"}
_STATES[State.PRIMARY_STATE_ACTIVE] = "active"
_FIRST_TRANSITION_STATE = State.TRANSITION_STATE_CONFIGURING


class _TroubleError(Exception):
    """A node does not do what it should; the text is the reason of an abort."""


class LifecycleNodes:
    """Brings managed nodes up anew for each episode, whatever state they are found in."""

    def __init__(
        self,
        context: Context,
        names: Sequence[str],
        patience: float,
        check_processes: Callable[[], str | None] = lambda: None,
    ) -> None:
        """Look for nothing yet.

        Args:
            context: ROS context of the graph.
            names: full names of the nodes, in the order in which they are brought up.
            patience: wall seconds in which each has to be there, and to answer.
            check_processes: called while waiting; returns what is wrong with the graph's processes, if anything.
        """
        self._names, self._patience, self._check_processes = names, patience, check_processes
        self._last_of_all = math.inf
        self._node = Node("_skd_lifecycle", context=context, start_parameter_services=False, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self._node)
        self._get = {name: self._node.create_client(GetState, f"{name}/get_state") for name in names}
        self._change = {name: self._node.create_client(ChangeState, f"{name}/change_state") for name in names}

    def before_episode(self) -> str | None:
        """Take all nodes down and bring them up again; return the reason of an abort where one does not do it."""
        try:
            self._take_down()
            for transition in _UP:
                for name in self._names:
                    self._do(name, transition)
        except _TroubleError as trouble:
            return str(trouble)
        return None

    def close(self) -> None:
        """Leave the nodes unconfigured, as far as they still answer and it takes no time, and let go of them."""
        self._last_of_all = time.monotonic() + _FAREWELL
        try:
            if all(client.service_is_ready() for client in self._get.values()):
                self._take_down()
        except _TroubleError:
            pass  # its process ends next, if it is ours; else it is its own affair
        finally:
            self._executor.shutdown()
            self._node.destroy_node()

    def _take_down(self) -> None:
        for state, transition in _DOWN.items():
            for name in reversed(self._names):
                if self._settled(name) == state:
                    self._do(name, transition)

    def _settled(self, name: str) -> int:
        """Return in which primary state a node is, or soon will be."""
        latest = self._latest()
        while True:
            state = self._call(name, self._get[name], GetState.Request(), latest)
            if state is not None and state.current_state.id < _FIRST_TRANSITION_STATE:
                if state.current_state.id == State.PRIMARY_STATE_FINALIZED:
                    raise _TroubleError(_reason(AbortKind.FAILED, name, "is finalized: it has to be started anew"))
                return int(state.current_state.id)
            self._look_after(latest, AbortKind.NO_ANSWER, name, "is between two states")
            time.sleep(_WAKE)

    def _do(self, name: str, transition: int) -> None:
        """Do a transition; where its answer is lost, the node's state says whether it was done."""
        request = ChangeState.Request(transition=Transition(id=transition))
        before, latest = self._settled(name), self._latest()
        while True:
            answer = self._call(name, self._change[name], request, latest)
            if answer is not None and not answer.success:
                what = f"did not {_CALLED[transition]}; it is {_STATES[self._settled(name)]} now"
                raise _TroubleError(_reason(AbortKind.FAILED, name, what))
            if answer is not None or self._settled(name) != before:
                return

    def _latest(self) -> float:
        return min(time.monotonic() + self._patience, self._last_of_all)

    def _call(self, name: str, client: Any, request: Any, latest: float) -> Any:
        """Return a service's answer; None where it seems to be lost."""
        while not client.service_is_ready():
            self._look_after(latest, AbortKind.NOT_STARTED, name, f"is not there: no node offers {client.srv_name}")
            self._executor.spin_once(timeout_sec=_WAKE)
        future, lost = client.call_async(request), time.monotonic() + _LOST_AFTER
        while not future.done() and time.monotonic() < lost:
            self._look_after(latest, AbortKind.NO_ANSWER, name, f"does not answer on {client.srv_name}")
            self._executor.spin_until_future_complete(future, timeout_sec=_WAKE)
        return future.result() if future.done() else None

    def _look_after(self, latest: float, kind: AbortKind, name: str, otherwise: str) -> None:
        problem = self._check_processes()
        if problem is None and time.monotonic() > latest:
            problem = _reason(kind, name, f"{otherwise} (waited {self._patience:g} s)")
        if problem is not None:
            raise _TroubleError(problem)


@contextmanager
def resetting(
    context: Context, names: Sequence[str], patience: float, check_processes: Callable[[], str | None] = lambda: None
) -> Iterator[Callable[[], str | None]]:
    """Yield what is to be called before each episode; the nodes are taken down at the end. See `LifecycleNodes`."""
    if not names:
        yield lambda: None
        return
    with closing(LifecycleNodes(context, names, patience, check_processes)) as nodes:
        yield nodes.before_episode


def _reason(kind: AbortKind, name: str, what: str) -> str:
    return abort_reason(kind, f"{name}, a managed node of the car controller, {what}")


_LOOK_EVERY = 1.0  # s
_SAY_AFTER, _HINT_AFTER, _SAY_AGAIN = 3.0, 8.0, 30.0
"""s of waiting after which a certain cause is said, and any other, and said again where nothing has changed."""
_CERTAIN_AFTER = 4.0
"""s for which the same certain cause has been seen, in the same nodes, until a wait is given up."""
_ANY = QoSProfile(depth=10, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Fits every publisher."""


class FirstCommands:
    """Says for which command an episode waits and why it does not come, and gives up a wait that is in vain."""

    def __init__(
        self, node: Node, awaited: Awaited, say: Callable[[str], None], *, by_stamp: bool = True, walk_topic: str = ""
    ) -> None:
        """Know nothing yet.

        Args:
            node: node through which the graph is seen; it has to be spun while `look` is called.
            awaited: the car's command.
            say: called with each line.
            by_stamp: whether a command has to have its state's stamp, as in lockstep without a quiet time.
            walk_topic: topic of the adversary's commands; empty where it is in this process.
        """
        self._node, self._awaited, self._say, self._by_stamp = node, awaited, say, by_stamp
        self._walk_topic = walk_topic
        self._heard: dict[str, Heard] = {}
        self.begin(0)

    def begin(self, start: int, *, senses: bool = True) -> None:
        """An episode was handed out: the state of its tick 0 is stamped `start` (ns); whether its car has a laser."""
        self.end()
        self._start, self._senses = start, senses
        self._began = self._looked = self._certain_since = time.monotonic()
        self._said = -_SAY_AGAIN
        self._causes: list[tuple[str, str]] = []
        self._certain: tuple[str, frozenset[str]] | None = None

    def end(self) -> None:
        """The commands are there, or will not come."""
        for heard in self._heard.values():
            self._node.destroy_subscription(heard.subscription)
        self._heard.clear()
        self.reasons: list[str] = []

    def look(self, *, state_came: bool) -> None:
        """See what is wrong; to be called now and then while the first commands have not come.

        Args:
            state_came: whether the state of tick 0 has come.

        Raises:
            AssessmentError: waiting does not mend it.
        """
        now = time.monotonic()
        if now - self._looked < _LOOK_EVERY:
            return
        self._looked, waited = now, now - self._began
        waits: list[tuple[str, str, str]] = []  # topic, cause, in words
        certain = None
        if state_came:
            seen = Evidence(self._node, self._awaited, self._start, self._by_stamp, self._senses, self._heard)
            if not seen.answered:
                cause, is_certain, text = diagnose(seen)
                waits.append((self._awaited.topic, cause, text))
                certain = (cause, frozenset(seen.listening)) if is_certain else None
            self._listen(seen)
            if self._walk_topic and not self._node.count_publishers(self._walk_topic):
                waits.append((self._walk_topic, "", f"no node publishes on {self._walk_topic}"))
        else:
            topic = self._node.resolve_topic_name(Topic.EGO_ODOMETRY)
            publishers = living_publishers(self._node, topic)
            why = f"{publishers[0].name} is there and says nothing" if publishers else f"no node publishes on {topic}"
            waits.append((topic, "", f"{why}: vehicle_simulator is to publish it"))
        self.reasons = [f"{topic}: {text}" for topic, _, text in waits]
        causes = [one[:2] for one in waits]
        if waited >= (_HINT_AFTER if certain is None else _SAY_AFTER) and (
            causes != self._causes or waited - self._said >= _SAY_AGAIN
        ):
            self._causes, self._said = causes, waited
            for topic, _, text in waits:
                self._say(f"waiting for {topic} ({waited:.0f} s): {text}")
        if certain is None or certain != self._certain:
            self._certain, self._certain_since = certain, now
        elif now - self._certain_since >= _CERTAIN_AFTER:
            raise AssessmentError(f"the car controller is not heard: {waits[0][2]}")

    def _listen(self, seen: Evidence) -> None:
        topic, kind = seen.awaited
        if any(one.kind == kind for one in seen.publishers):
            self._hear(topic, kind)
        for name, publisher in seen.candidates:
            self._hear(name, publisher.kind)

    def _hear(self, topic: str, kind: str) -> None:
        message = class_of(kind)
        if topic not in self._heard and message is not None:
            heard = self._heard[topic] = Heard()
            heard.subscription = self._node.create_subscription(message, topic, heard.take, _ANY)


class Health:
    """Publishes /diagnostics: the car controller and the episode, once a second where a node listens."""

    def __init__(self, node: Node) -> None:
        """Make the topic; `node` publishes on it."""
        self._node, self._latest = node, 0.0
        self._publisher = node.create_publisher(DiagnosticArray, Topic.DIAGNOSTICS, 10)

    def publish(self, reasons: Sequence[str], values: Mapping[str, object]) -> None:
        """Publish, unless it is less than a second ago.

        Args:
            reasons: why commands do not come, a line each.
            values: what is known of the campaign and its episode.
        """
        now = time.monotonic()
        if now - self._latest < _LOOK_EVERY or not self._publisher.get_subscription_count():
            return
        self._latest = now
        level, said = (DiagnosticStatus.WARN, "; ".join(reasons)) if reasons else (DiagnosticStatus.OK, "answers")
        facts = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(
            status=[
                DiagnosticStatus(level=level, name="skd: car controller", message=said, hardware_id="skd"),
                DiagnosticStatus(name="skd: episode", message="runs", hardware_id="skd", values=facts),
            ]
        )
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
