"""rclpy.context: from init to shutdown."""

from __future__ import annotations

import sys
import threading
import weakref
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any

from rosless.exceptions import RCLError

if TYPE_CHECKING:
    from rosless.arguments import Arguments
    from rosless.discovery import Graph
    from rosless.participant import Participant

_live_contexts: weakref.WeakSet[Context] = weakref.WeakSet()


class Context:
    """The lifecycle of init and shutdown; a context is used once."""

    def __init__(self) -> None:
        # re-entrant: a signal handler runs in the main thread, which may hold it
        self._lock = threading.RLock()
        self._callbacks: list[Callable[[], Callable[[], None] | None]] = []
        self._initialized = False
        self._ok = False
        self._participant: Participant | None = None
        self._graph: Graph | None = None
        self._arguments: Arguments | None = None

    def init(
        self, args: list[str] | None = None, *, initialize_logging: bool = True, domain_id: int | None = None
    ) -> None:
        """Parse the ROS arguments and join the domain."""
        from rosless import arguments, domain, logging
        from rosless.discovery import Graph
        from rosless.participant import Participant

        with self._lock:
            if domain_id is not None and domain_id < 0:
                raise RuntimeError(f"Domain id ({domain_id}) should not be lower than zero.")
            if self._initialized:
                raise RuntimeError("Context.init() must only be called once")
            self._arguments = arguments.parse_with_environment(sys.argv if args is None else args)
            if initialize_logging:
                for name, level in self._arguments.log_levels.items():
                    logging.set_logger_level(name, logging.LoggingSeverity[level])
            self._participant = Participant(domain.domain_id(domain_id))
            self._graph = Graph(self._participant)
            self._initialized = True
            self._ok = True
            _live_contexts.add(self)

    @property
    def participant(self) -> Participant:
        """The DDS participant of this context."""
        if self._participant is None:
            raise RuntimeError("Context must be initialized before it can be used")
        return self._participant

    @property
    def graph(self) -> Graph:
        """What this context knows of the graph."""
        if self._graph is None:
            raise RuntimeError("Context must be initialized before it can be used")
        return self._graph

    @property
    def arguments(self) -> Arguments:
        """The process-wide ROS arguments."""
        if self._arguments is None:
            raise RuntimeError("Context must be initialized before it can be used")
        return self._arguments

    def ok(self) -> bool:
        """True between init and shutdown."""
        return self._ok

    def shutdown(self) -> None:
        """Shut down; an error if that has been done."""
        if not self._initialized:
            raise RuntimeError("Context must be initialized before it can be shutdown")
        with self._lock:
            if not self._ok:
                raise RCLError("failed to shutdown: rcl_shutdown already called on the given context")
            self._shutdown()

    def try_shutdown(self) -> None:
        """Shut down, if that has not been done."""
        with self._lock:
            if self._ok:
                self._shutdown()

    def _shutdown(self) -> None:
        self._ok = False
        callbacks, self._callbacks = self._callbacks, []
        for reference in callbacks:
            callback = reference()
            if callback is not None:
                callback()
        self.release()

    def release(self) -> None:
        """Leave the domain, once the context is shut down and its nodes are destroyed."""
        if not self._ok and self._graph is not None and not self._graph.has_local_nodes:
            self.participant.close()

    def on_shutdown(self, callback: Callable[[], None]) -> None:
        """Have a function called at shutdown, or now if that is over."""
        if not callable(callback):
            raise TypeError(f"callback should be a callable, got {type(callback)}")
        if self._initialized and not self._ok:
            callback()
            return
        reference: Callable[[], Any]
        if hasattr(callback, "__self__") and hasattr(callback, "__func__"):
            reference = weakref.WeakMethod(callback)
        else:

            def reference() -> Callable[[], None]:
                return callback

        with self._lock:
            self._callbacks.append(reference)

    def get_domain_id(self) -> int:
        """The DDS domain of this context."""
        if self._participant is None:
            raise RuntimeError("Context must be initialized before it can have a domain id")
        return self._participant.domain_id

    def destroy(self) -> None:
        """Leave the domain."""
        self.try_shutdown()
        if self._participant is not None:
            self._participant.close()

    def __enter__(self) -> Context:
        self.init()
        return self

    def __exit__(
        self, exc_type: type[BaseException] | None, exc: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.try_shutdown()


def live_contexts() -> list[Context]:
    """Contexts that have been initialised and not shut down."""
    return [context for context in list(_live_contexts) if context.ok()]
