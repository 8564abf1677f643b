"""An executor for nodes in lockstep: it keeps its wait set, and takes all messages that have arrived at once.

rclpy's own builds a wait set anew for every callback, from all that a node has: subscriptions, timers, and the
services, events and guards that every node is born with; that alone takes about 0.1 ms a callback. Here subscriptions
and timers have a wait set that stays; everything else is looked after by rclpy's own way, when nothing else is to do
and now and then.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

warnings.filterwarnings("ignore", "failed to send response", RuntimeWarning)  # who has asked is gone
_LONGEST_WAIT = 0.05  # s, for a signal may come unseen; an idle node then looks at services and events
_LOOK_PERIOD = 0.5  # s between such looks of a busy one
_CALLBACKS_A_LOOK = 4
_LONG_LOOK, _REST, _LONGEST_REST = 0.09, 20.0, 5.0  # s; times as long as a longer one took nobody looks again, but s
_ROUNDS = 20  # messages of each topic in a row, before timers and the rest have their turn
_NANOSECONDS = 1_000_000_000


class LockstepExecutor(SingleThreadedExecutor):
    """Runs the callbacks of nodes in the thread that spins; none of them may be a coroutine."""

    def __init__(self, node: Node, deliver: Callable[[], bool] = lambda: False) -> None:
        """Take a node, which may get and lose subscriptions and timers at any time; `add_node` takes more.

        Args:
            node: the first node.
            deliver: hands over what the nodes say to each other by a call; returns whether there was anything.
        """
        super().__init__(context=node.context)
        self._stale = True
        self._members: list[Node] = []
        self._deliver = deliver
        self._subscriptions: list[Any] = []
        self._timers: list[Any] = []
        self._wait_set: Any = None
        self._held = ExitStack()
        self._left: list[Any] = []
        self._looked = self._next_look = 0.0
        self.add_node(node)

    def add_node(self, node: Node) -> bool:
        """Take another node of the same context."""
        self._members.append(node)
        self._stale = True
        return bool(super().add_node(node))

    def leave(self, subscription: Any) -> None:
        """Look at a subscription only with everything else, and when `take` is called: each that waits costs time."""
        self._left.append(subscription)
        self._stale = True

    def take(self, subscription: Any) -> None:
        """Run the callback of a subscription for all messages that are there.

        Raises:
            ExternalShutdownException: the context is shut down.
        """
        self._deliver()
        if not isinstance(subscription, Subscription):
            return  # what comes by a call has come
        with self._ended_context(), subscription.handle:
            while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
                subscription.callback(taken[0])

    def wake(self) -> None:
        """End a wait: the node calls it when what it has changes."""
        self._stale = True
        super().wake()

    def spin(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Run callbacks until it has ended, which is asked between them and at least every 0.05 s.

        Raises:
            ExternalShutdownException: the context is shut down.
        """
        try:
            while not ended():
                self.spin_once(timeout_sec=_LONGEST_WAIT)
        finally:
            self._let_go()

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Release the nodes and the wait set."""
        self._let_go()
        return bool(super().shutdown(timeout_sec))

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Run the callbacks of all that has arrived, or does within a time; without a time, wait until something does.

        Raises:
            ExternalShutdownException: the context is shut down.
        """
        if not self._context.ok():  # asked here too: a node that is never idle never waits
            raise ExternalShutdownException
        with self._ended_context():
            self._turn(None if timeout_sec is None else time.monotonic() + timeout_sec)

    @contextmanager
    def _ended_context(self) -> Iterator[None]:
        try:
            yield
        except rclpy_implementation.RCLError:
            if self._context.ok():
                raise
            raise ExternalShutdownException from None  # nothing can be taken or sent any more

    def _turn(self, end: float | None) -> None:
        while not self._run_what_is_ready():
            left = _LONGEST_WAIT if end is None else min(_LONGEST_WAIT, end - time.monotonic())
            if left <= 0.0:
                break
            self._wait(left)
            if self._run_what_is_ready():
                break
            self._look_at_the_rest()
        if time.monotonic() - self._looked > _LOOK_PERIOD:
            self._look_at_the_rest()

    def _look_at_the_rest(self) -> None:
        """Look at everything else, unless that took long just now.

        An answer to somebody who is gone waits for them for 0.1 s: whoever asks often could have nothing else be done.
        """
        if time.monotonic() < self._next_look:
            return
        for _ in range(_CALLBACKS_A_LOOK):
            begin = time.monotonic()
            super().spin_once(timeout_sec=0.0)
            self._looked = time.monotonic()
            if (spent := self._looked - begin) > _LONG_LOOK:
                self._next_look = self._looked + min(_REST * spent, _LONGEST_REST)
                break

    def _take_service(self, srv: Any) -> Any:
        """As rclpy's; but what anybody asks of the services with which nodes are born ends no node.

        rclpy raises what its own answer to a request raises, as of a parameter of no known type.
        """
        answer = None
        with self._left_out(srv):
            answer = super()._take_service(srv)

        async def answered() -> None:
            if answer is not None:
                with self._left_out(srv):
                    await answer()

        return answered

    @contextmanager
    def _left_out(self, srv: Any) -> Iterator[None]:
        try:
            yield
        except Exception as error:
            said = f"a request of {srv.srv_name} is left out: {type(error).__name__}: {error}"
            self._members[0].get_logger().warning(said, throttle_duration_sec=5.0)

    def _wait(self, seconds: float) -> None:
        if self._stale:
            self._collect()
        wait_set = self._wait_set
        wait_set.clear_entities()
        for subscription in self._subscriptions:
            wait_set.add_subscription(subscription.handle)
        for timer in self._timers:
            wait_set.add_timer(timer.handle)
        wait_set.add_guard_condition(self._guard.handle)
        wait_set.add_guard_condition(self._sigint_gc.handle)
        wait_set.wait(int(seconds * _NANOSECONDS))
        if not self._context.ok():
            raise ExternalShutdownException

    def _collect(self) -> None:
        """Make the wait set of what the nodes have now, and see that none of it is destroyed while it is in use."""
        self._let_go()
        self._stale = False
        self._subscriptions = [one for node in self._members for one in node.subscriptions if one not in self._left]
        self._timers = [timer for node in self._members for timer in node.timers]
        counts = len(self._subscriptions), 2, len(self._timers), 0, 0, 0
        self._wait_set = rclpy_implementation.WaitSet(*counts, self._context.handle)
        handles = [entity.handle for entity in (*self._subscriptions, *self._timers, self._guard, self._sigint_gc)]
        for handle in (self._context.handle, *handles, self._wait_set):
            self._held.enter_context(handle)

    def _let_go(self) -> None:
        self._stale = True
        self._subscriptions, self._timers, self._wait_set = [], [], None
        self._held.close()

    def _run_what_is_ready(self) -> bool:
        """Run all that is ready, one message of each topic at a time; return whether there was anything."""
        any_ran = self._deliver()
        for timer in self._timers:
            if self._stale:
                return any_ran
            if timer.handle.is_timer_ready():
                timer.handle.call_timer()
                timer.callback()
                self._deliver()
                any_ran = True
        for _ in range(_ROUNDS):
            took = False
            for subscription in self._subscriptions:
                if self._stale:  # a callback may have destroyed what comes next
                    return any_ran
                taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                if taken is not None:
                    subscription.callback(taken[0])
                    self._deliver()
                    took = any_ran = True
            if not took:
                break
        return any_ran
