"""Managed nodes of a stack, brought up and down through the services of their lifecycle (`lifecycle_msgs`).

A reset goes all the way down and up again: what a node has forgotten by then is settled for cleaning up (it is as after
its creation; ROS 2 design, "Managed nodes") and for nothing less.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Any

from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from skd_sim.world.aborts import AbortKind, abort_reason

_WAKE = 0.1  # s
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
            state = self._ask(name, self._get[name], GetState.Request()).current_state
            if state.id == State.PRIMARY_STATE_FINALIZED:
                raise _TroubleError(_reason(AbortKind.FAILED, name, "is finalized: it has to be started anew"))
            if state.id < _FIRST_TRANSITION_STATE:
                return int(state.id)
            if time.monotonic() > latest:
                raise _TroubleError(_reason(AbortKind.NO_ANSWER, name, f"was {state.label} for {self._patience:g} s"))
            time.sleep(_WAKE)

    def _do(self, name: str, transition: int) -> None:
        request = ChangeState.Request(transition=Transition(id=transition))
        if not self._ask(name, self._change[name], request).success:
            state = self._ask(name, self._get[name], GetState.Request()).current_state.label
            raise _TroubleError(_reason(AbortKind.FAILED, name, f"did not {_CALLED[transition]}; it is {state} now"))

    def _ask(self, name: str, client: Any, request: Any) -> Any:
        latest = self._latest()
        while not client.service_is_ready():
            self._look_after(latest, name, f"is not there: nobody offers {client.srv_name}{self._others()}")
            self._executor.spin_once(timeout_sec=_WAKE)
        future = client.call_async(request)
        while not future.done():
            self._look_after(latest, name, f"does not answer on {client.srv_name}")
            self._executor.spin_until_future_complete(future, timeout_sec=_WAKE)
        return future.result()

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
