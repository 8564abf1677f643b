"""rclpy.executors: wait for messages, timers and events, and run their callbacks."""

# ruff: noqa: N818  # the names are rclpy's

from __future__ import annotations

import inspect
import threading
import time
from collections import deque
from collections.abc import Callable, Coroutine
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol

from rosless import wire
from rosless.constants import S_TO_NS
from rosless.context import Context
from rosless.exceptions import RCLError
from rosless.task import Future, Task
from rosless.utilities import get_default_context, timeout_sec_to_nsec

if TYPE_CHECKING:
    from rosless.node import Node

_GUARD_COOKIE = 0
_GRAPH_COOKIE = 1
_FOREVER = -1


class ExternalShutdownException(Exception):
    """Raised by a spin whose context has been shut down."""

    def __init__(self) -> None:
        super().__init__()


class TimeoutException(Exception):
    """Raised when a wait has run out of time."""


class ShutdownException(Exception):
    """Raised inside an executor that has been shut down."""


class ConditionReachedException(Exception):
    """Raised inside an executor when what it waits for has happened."""


class Waitable(Protocol):
    """What an executor can run: subscriptions, timers, guard conditions, events, services, clients, tasks."""

    def take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        """Take what is there, and say what to call with which arguments."""
        ...


class _TaskRun:
    """One step of a task."""

    __slots__ = ("task",)

    def __init__(self, task: Task) -> None:
        self.task = task

    def take(self) -> tuple[Callable[..., Any], tuple[Any, ...]] | None:
        return self.task, ()


class Executor:
    """Runs the callbacks of its nodes, one at a time, in the thread that spins."""

    def __init__(self, *, context: Context | None = None) -> None:
        self._context = get_default_context() if context is None else context
        self._nodes: dict[Node, None] = {}
        self._lock = threading.RLock()
        self._is_shutdown = False
        participant = self._context.participant.entity
        self._guard = wire.GuardHandle(participant)
        self._wait_set = wire.WaitSet(participant)
        self._wait_set.attach(self._guard.entity, _GUARD_COOKIE)
        self._wait_set.attach(self._context.graph.wait_entity, _GRAPH_COOKIE)
        self._items: dict[int, Any] = {}  # cookie -> what to run
        self._cookies: dict[int, int] = {}  # DDS entity -> cookie
        self._next_cookie = _GRAPH_COOKIE + 1
        self._timers: list[Any] = []
        self._changed = True
        self._ready: deque[Any] = deque()
        self._unfinished: list[Task] = []
        self._context.on_shutdown(self.wake)

    @property
    def context(self) -> Context:
        """The context of this executor."""
        return self._context

    def create_task(self, callback: Callable[..., Any] | Coroutine[Any, Any, Any], *args: Any, **kwargs: Any) -> Task:
        """Run a function or coroutine; the task is a future of its result."""
        task = Task(callback, args, kwargs, executor=self)
        self._ready.append(_TaskRun(task))
        self.wake()
        return task

    def shutdown(self, timeout_sec: float | None = None) -> bool:
        """Stop spinning and let go of all nodes."""
        with self._lock:
            if not self._is_shutdown:
                self._is_shutdown = True
                self.wake()
                for node in list(self._nodes):
                    self.remove_node(node)
        return True

    def add_node(self, node: Node) -> bool:
        """Run this node's callbacks; False if that is so already."""
        with self._lock:
            if node in self._nodes:
                return False
            self._nodes[node] = None
            node.executor = self
            self._entities_changed()
            return True

    def remove_node(self, node: Node) -> None:
        """Leave this node's callbacks alone."""
        with self._lock:
            if node in self._nodes:
                del self._nodes[node]
                self._entities_changed()

    def get_nodes(self) -> list[Node]:
        """The nodes of this executor."""
        with self._lock:
            return list(self._nodes)

    def wake(self) -> None:
        """Have the executor look again at what it waits for; callable from every thread."""
        self._guard.trigger()

    def _entities_changed(self) -> None:
        self._changed = True
        self.wake()

    def spin(self) -> None:
        """Run callbacks until shutdown."""
        while self._context._ok and not self._is_shutdown:
            self._spin_once(_FOREVER)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait for one callback and run it."""
        self._spin_once(timeout_sec_to_nsec(timeout_sec))

    def spin_until_future_complete(self, future: Future, timeout_sec: float | None = None) -> None:
        """Run callbacks until a future is done, or time is up."""
        future.add_done_callback(lambda _: self.wake())
        timeout = timeout_sec_to_nsec(timeout_sec)
        end = time.monotonic_ns() + timeout
        while self._context.ok() and not self._is_shutdown and not future.done() and not future.cancelled():
            left = _FOREVER if timeout < 0 else max(0, end - time.monotonic_ns())
            self._spin_once(left, future)
            if timeout >= 0 and time.monotonic_ns() >= end:
                return

    def spin_once_until_future_complete(self, future: Future, timeout_sec: float | None = None) -> None:
        """Wait for one callback and run it, unless a future is done before."""
        future.add_done_callback(lambda _: self.wake())
        self._spin_once(timeout_sec_to_nsec(timeout_sec), future)

    def _spin_once(self, timeout_ns: int, future: Future | None = None) -> None:
        ready = self._ready
        if self._changed or not ready:
            end = 0 if timeout_ns < 0 else time.monotonic_ns() + timeout_ns
            while not self._collect(timeout_ns):
                if not self._context._ok:
                    raise ExternalShutdownException
                if self._is_shutdown or (future is not None and future.done()):
                    return
                if timeout_ns >= 0:
                    timeout_ns = end - time.monotonic_ns()
                    if timeout_ns <= 0:
                        return
        taken = ready.popleft().take()
        if taken is None:
            return
        function, arguments = taken
        result = function(*arguments)
        if result is not None and inspect.iscoroutine(result):
            self._start(Task(result, executor=self))
        elif function.__class__ is Task:
            self._finish(function)

    def _start(self, task: Task) -> None:
        task()
        self._finish(task)

    def _finish(self, task: Task) -> None:
        if task.done():
            error = task.exception()
            if error is not None:
                raise error
        elif not task.cancelled():
            self._unfinished.append(task)

    def _collect(self, timeout_ns: int) -> bool:
        """Wait at most this time, or a while of it, and queue what is ready; False if that is nothing."""
        if self._changed:
            self._synchronize()
        ready = self._ready
        limit = wire.LONGEST_WAIT_NS
        if 0 <= timeout_ns < limit:
            limit = timeout_ns
        for timer in self._timers:
            if timer._canceled or timer._destroyed:
                continue
            left = timer.time_until_next_call()
            if left <= 0:
                ready.append(timer)
                limit = 0
            elif left < limit and timer._clock.follows_wall:
                limit = left
        if ready:
            limit = 0
        try:
            cookies = self._wait_set.wait(limit)
        except RCLError:
            if self._context._ok:
                raise
            # the context has been shut down, and what belongs to it deleted
            raise ExternalShutdownException from None
        if self._unfinished:
            unfinished, self._unfinished = self._unfinished, []
            ready.extend(_TaskRun(task) for task in unfinished)
        if cookies:
            items = self._items
            if len(cookies) > 1:
                cookies.sort()  # in the order in which the entities were made, as rclpy does
            for cookie in cookies:
                if cookie == _GUARD_COOKIE:
                    self._guard.clear()
                elif cookie == _GRAPH_COOKIE:
                    self._context.graph.drain()
                elif cookie in items:
                    ready.append(items[cookie])
        if not self._context._ok:
            raise ExternalShutdownException
        return bool(ready)

    def _synchronize(self) -> None:
        """Attach new entities of the nodes to the wait set and detach those that have gone."""
        with self._lock:
            self._changed = False
            wanted: dict[int, Any] = {}
            self._timers = []
            for node in self._nodes:
                self._timers.extend(node.timers)
                for item in node.wait_items():
                    if item.wait_entity:
                        wanted[item.wait_entity] = item
            for entity in [entity for entity in self._cookies if entity not in wanted]:
                self._wait_set.detach(entity)
                del self._items[self._cookies.pop(entity)]
            for entity, item in wanted.items():
                if entity not in self._cookies:
                    cookie, self._next_cookie = self._next_cookie, self._next_cookie + 1
                    self._wait_set.attach(entity, cookie)
                    self._cookies[entity] = cookie
                    self._items[cookie] = item
            present = {id(item) for item in wanted.values()} | {id(timer) for timer in self._timers}
            stale = [i for i in self._ready if not isinstance(i, _TaskRun) and id(i) not in present]
            if stale:
                kept = [i for i in self._ready if i not in stale]
                self._ready.clear()
                self._ready.extend(kept)

    def __enter__(self) -> Executor:
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.shutdown()


class SingleThreadedExecutor(Executor):
    """Runs callbacks in the thread that spins."""


class MultiThreadedExecutor(Executor):
    """As SingleThreadedExecutor: callbacks never run at the same time.

    What differs from rclpy is a callback that blocks until another callback has run: that never happens here.
    """

    def __init__(self, num_threads: int | None = None, *, context: Context | None = None) -> None:
        super().__init__(context=context)


async def await_or_execute(callback: Callable[..., Any], *args: Any) -> Any:
    """Call a function, and await the result if that is a coroutine."""
    result = callback(*args)
    return await result if inspect.iscoroutine(result) else result


class TimeoutObject:
    """A timeout in seconds that can be changed while it runs."""

    def __init__(self, timeout: float) -> None:
        self._timeout = timeout

    @property
    def timeout(self) -> float:
        """The timeout in seconds."""
        return self._timeout

    @timeout.setter
    def timeout(self, timeout: float) -> None:
        self._timeout = timeout

    @property
    def nanoseconds(self) -> int:
        """The timeout in nanoseconds."""
        return int(self._timeout * S_TO_NS)
