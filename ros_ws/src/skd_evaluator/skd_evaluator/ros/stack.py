"""The stack under test: its managed nodes are brought up anew for each episode, and its first commands are awaited.

Managed nodes go up and down through the services of their lifecycle (`lifecycle_msgs`). A reset goes all the way down
and up again: what a node has forgotten by then is settled for cleaning up (it is as after its creation; ROS 2 design,
"Managed nodes") and for nothing less.

While the first commands of an episode are awaited, the user is told every ten seconds why they do not come, and nothing
before that: a look costs time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Any, NamedTuple

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from skd_sim.ros.discovery import (
    candidates,
    class_of,
    foreign_nodes,
    living_publishers,
    unheard,
    why_no_command,
)
from skd_sim.ros.from_messages import from_stamp
from skd_sim.ros.support import EGO_ODOMETRY
from skd_sim.world.episode import AbortKind, abort_reason
from skd_sim.world.timing import stamp_fault

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
_FIRST_TRANSITION_STATE = State.TRANSITION_STATE_CONFIGURING


class _TroubleError(Exception):
    """A node does not do what it should; the text is the reason of an abort."""


class LifecycleNodes:
    """Brings managed nodes up anew for each episode, whatever state they are found in."""

    def __init__(
        self,
        context: Context,
        names: Sequence[str],
        *,
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
        self._names = names
        self._patience = patience
        self._last_of_all = math.inf
        self._check_processes = check_processes
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
        states = {name: self._settled(name) for name in self._names}
        for state, transition in _DOWN.items():
            for name in reversed(self._names):
                if states[name] == state:
                    self._do(name, transition)
                    states[name] = self._settled(name)

    def _latest(self) -> float:
        return min(time.monotonic() + self._patience, self._last_of_all)

    def _settled(self, name: str) -> int:
        """Return in which primary state a node is, or soon will be."""
        latest = self._latest()
        while True:
            state = self._state(name)
            if state.id == State.PRIMARY_STATE_FINALIZED:
                raise _TroubleError(_reason(AbortKind.FAILED, name, "is finalized: it has to be started anew"))
            if state.id < _FIRST_TRANSITION_STATE:
                return int(state.id)
            if time.monotonic() > latest:
                raise _TroubleError(_reason(AbortKind.NO_ANSWER, name, f"was {state.label} for {self._patience:g} s"))
            time.sleep(_WAKE)

    def _do(self, name: str, transition: int) -> None:
        """Do a transition; where its answer is lost, the node's state says whether it was done."""
        request = ChangeState.Request(transition=Transition(id=transition))
        before, latest = self._settled(name), self._latest()
        while True:
            answer = self._answer(name, self._change[name], request, latest)
            if answer is not None and not answer.success:
                state = self._state(name).label
                raise _TroubleError(
                    _reason(AbortKind.FAILED, name, f"did not {_CALLED[transition]}; it is {state} now")
                )
            if answer is not None or self._settled(name) != before:
                return

    def _state(self, name: str) -> Any:
        latest = self._latest()
        while True:
            answer = self._answer(name, self._get[name], GetState.Request(), latest)
            if answer is not None:
                return answer.current_state

    def _answer(self, name: str, client: Any, request: Any, latest: float) -> Any:
        """Return a service's answer, or None where it seems to be lost."""
        while not client.service_is_ready():
            self._look_after(latest, name, f"is not there: nobody offers {client.srv_name}{self._others()}")
            self._executor.spin_once(timeout_sec=_WAKE)
        future, lost = client.call_async(request), time.monotonic() + _LOST_AFTER
        while not future.done() and time.monotonic() < lost:
            self._look_after(latest, name, f"does not answer on {client.srv_name}")
            self._executor.spin_until_future_complete(future, timeout_sec=_WAKE)
        return future.result() if future.done() else None

    def _look_after(self, latest: float, name: str, otherwise: str) -> None:
        problem = self._check_processes()
        if problem is not None:
            raise _TroubleError(problem)
        if time.monotonic() > latest:
            kind = AbortKind.NO_ANSWER if self._get[name].service_is_ready() else AbortKind.NOT_STARTED
            raise _TroubleError(_reason(kind, name, f"{otherwise} (waited {self._patience:g} s)"))

    def _others(self) -> str:
        """Return which managed nodes there are, for one whose name is not among them."""
        found = [name for name in _managed(self._node.get_service_names_and_types()) if name not in self._names]
        return f", managed nodes there are {', '.join(found)}" if found else ""


@contextmanager
def resetting(
    context: Context,
    names: Sequence[str],
    *,
    patience: float,
    check_processes: Callable[[], str | None] = lambda: None,
) -> Iterator[Callable[[], str | None]]:
    """Yield what is to be called before each episode; the nodes are taken down at the end. See `LifecycleNodes`."""
    if not names:
        yield lambda: None
        return
    with closing(LifecycleNodes(context, names, patience=patience, check_processes=check_processes)) as nodes:
        yield nodes.before_episode


def _managed(services: Iterable[tuple[str, Sequence[str]]]) -> list[str]:
    kind = "lifecycle_msgs/srv/GetState"
    return sorted(service.removesuffix("/get_state") for service, kinds in services if kind in kinds)


def _reason(kind: AbortKind, name: str, what: str) -> str:
    return abort_reason(kind, f"{name}, a managed node of the car controller, {what}")


_LISTEN_AFTER = 1.0
"""s of waiting after which this node listens to what else is published: by then something is the matter."""
_SAY_EVERY = 10.0
_SAY_AGAIN = 3
"""How many times as long passes until a line is said again that says nothing new."""
_ANY = QoSProfile(depth=10, history=HistoryPolicy.KEEP_LAST, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Fits every publisher."""


class Awaited(NamedTuple):
    """A kind of command that an episode needs.

    Attributes:
        topic: full name of the topic.
        kind: type of its messages, as `geometry_msgs/msg/Twist`.
    """

    topic: str
    kind: str


@dataclass
class _Heard:
    """What has come on a topic since it is listened to: how many, and the newest stamp (ns), if they have any."""

    subscription: Any = None
    count: int = 0
    newest: int | None = None

    def take(self, message: Any) -> None:
        self.count += 1
        if (header := getattr(message, "header", None)) is not None:
            self.newest = max(self.newest or 0, from_stamp(header.stamp))


class FirstCommands:
    """Says every ten seconds for which command an episode waits, and what is on the graph instead of it."""

    def __init__(
        self, node: Node, awaited: Sequence[Awaited], say: Callable[[str], None], *, by_stamp: bool = True
    ) -> None:
        """Know nothing yet.

        Args:
            node: node through which the graph is seen; it has to be spun while `look` is called.
            awaited: the commands that are awaited.
            say: called with each line.
            by_stamp: whether a command without a stamp (0) is of no use: only lockstep without a quiet time needs one.
        """
        self._by_stamp = by_stamp
        self._node = node
        self._awaited = awaited
        self._say = say
        self._heard: dict[str, _Heard] = {}
        self.begin(0)

    def begin(self, start: int) -> None:
        """An episode was handed out: the state of its tick 0 is stamped `start` (ns)."""
        self.end()
        self._start = start
        self._began = self._listened = time.monotonic()
        self._said = 0
        self._last: list[str] = []

    def end(self) -> None:
        """The commands are there, or will not come."""
        for heard in self._heard.values():
            self._node.destroy_subscription(heard.subscription)
        self._heard.clear()

    def look(self, *, state_came: bool) -> None:
        """See whether something is to be said; to be called now and then while the first commands have not come.

        Args:
            state_came: whether the state of tick 0 has come.
        """
        now = time.monotonic()
        if now - self._listened > _LISTEN_AFTER:
            self._listened = now
            self._listen()
        waited = int((now - self._began) / _SAY_EVERY)
        if waited > self._said:
            self._said = waited
            reasons = self._reasons(state_came=state_came)
            if reasons != self._last or waited % _SAY_AGAIN == 0:
                self._last = reasons
                for reason in reasons:
                    topic, _, why = reason.partition(": ")
                    self._say(f"waiting for {topic} ({waited * _SAY_EVERY:g} s): {why}")

    def _listen(self) -> None:
        for topic, kind in self._awaited:
            if any(one.kind == kind for one in living_publishers(self._node, topic)):
                self._hear(topic, kind)
        for topic, publisher in candidates(self._node, self._awaited[0].topic):
            self._hear(topic, publisher.kind)

    def _hear(self, topic: str, kind: str) -> None:
        message = class_of(kind)
        if topic not in self._heard and message is not None:
            heard = self._heard[topic] = _Heard()
            heard.subscription = self._node.create_subscription(message, topic, heard.take, _ANY)

    def _reasons(self, *, state_came: bool) -> list[str]:
        """Return each topic on which something is missing, and why."""
        if not state_came:
            topic = self._node.resolve_topic_name(EGO_ODOMETRY)
            publishers = living_publishers(self._node, topic)
            why = f"{publishers[0].name} is there and says nothing" if publishers else f"nobody publishes on {topic}"
            return [f"{topic}: {why}"]
        return [f"{one.topic}: {self._why(one)}" for one in self._awaited if not self._answered(one)]

    def _answered(self, one: Awaited) -> bool:
        heard = self._heard.get(one.topic)
        if heard is None or not heard.count:
            return False
        return heard.newest in (None, self._start) or (not self._by_stamp and not heard.newest)

    def _why(self, one: Awaited) -> str:
        def arrives(topic: str) -> bool:
            return topic in self._heard and self._heard[topic].count > 0

        why = why_no_command(self._node, one.topic, one.kind, arrives)
        if not why and arrives(one.topic):
            fault = stamp_fault(self._heard[one.topic].newest or 0, self._start)
            return f"commands come, but their stamps are of no use: {fault}"
        if not why:
            names = ", ".join(publisher.name for publisher in living_publishers(self._node, one.topic))
            why = f"{names} is there and has not published yet"
        deaf = [f"{name} listens to {topic}" for name, topic in unheard(self._node)]
        if deaf:
            return f"{why}; {' and '.join(deaf)}, where nobody publishes: remap it"
        if not foreign_nodes(self._node):
            return f"{why}; there is no node on the graph but SKD's own"
        return why
