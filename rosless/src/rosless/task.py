"""rclpy.task: futures, and coroutines that an executor steps."""

from __future__ import annotations

import inspect
import threading
import weakref
from collections.abc import Callable, Coroutine, Generator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosless.executors import Executor


class Future:
    """The outcome of something that is not finished yet."""

    def __init__(self, *, executor: Executor | None = None) -> None:
        self._done = False
        self._cancelled = False
        self._result: Any = None
        self._exception: BaseException | None = None
        self._callbacks: list[Callable[[Future], None]] = []
        self._lock = threading.Lock()
        self._executor: Callable[[], Executor | None] = (lambda: None) if executor is None else weakref.ref(executor)

    def __await__(self) -> Generator[None, None, Any]:
        while not self._done and not self._cancelled:
            yield
        return self.result()

    def cancel(self) -> None:
        """Say that no result will come."""
        with self._lock:
            if self._done:
                return
            self._cancelled = True
        self._call_callbacks()

    def cancelled(self) -> bool:
        """True after :meth:`cancel`."""
        return self._cancelled

    def done(self) -> bool:
        """True once there is a result or an exception."""
        return self._done

    def result(self) -> Any:
        """The result; raises the exception if there is one."""
        if self._exception is not None:
            raise self._exception
        return self._result

    def exception(self) -> BaseException | None:
        """The exception, if there is one."""
        return self._exception

    def set_result(self, result: Any) -> None:
        """Finish with a result."""
        with self._lock:
            self._result = result
            self._done = True
            self._cancelled = False
        self._call_callbacks()

    def set_exception(self, exception: BaseException) -> None:
        """Finish with an exception."""
        with self._lock:
            self._exception = exception
            self._done = True
            self._cancelled = False
        self._call_callbacks()

    def add_done_callback(self, callback: Callable[[Future], None]) -> None:
        """Have a function called when this is finished, or now if it is."""
        with self._lock:
            if not self._done and not self._cancelled:
                self._callbacks.append(callback)
                return
        callback(self)

    def _set_executor(self, executor: Executor) -> None:
        self._executor = weakref.ref(executor)

    def _call_callbacks(self) -> None:
        callbacks, self._callbacks = self._callbacks, []
        executor = self._executor()
        for callback in callbacks:
            if executor is not None:
                executor.create_task(callback, self)
            else:
                callback(self)
        if executor is not None:
            executor.wake()


class Task(Future):
    """A function or coroutine that an executor runs; a coroutine goes on each time it comes round."""

    def __init__(
        self,
        handler: Callable[..., Any] | Coroutine[Any, Any, Any],
        args: tuple[Any, ...] = (),
        kwargs: dict[str, Any] | None = None,
        executor: Executor | None = None,
    ) -> None:
        super().__init__(executor=executor)
        self._handler: Any = handler
        if inspect.iscoroutinefunction(handler):
            self._handler = handler(*args, **(kwargs or {}))
            args, kwargs = (), None
        self._args, self._kwargs = args, kwargs or {}

    def __call__(self) -> None:
        """Run, or go on, until done or waiting."""
        if self._done or self._cancelled:
            return
        try:
            if inspect.iscoroutine(self._handler):
                self._handler.send(None)
                return
            result = self._handler(*self._args, **self._kwargs)
        except StopIteration as stop:
            result = stop.value
        except Exception as error:
            self.set_exception(error)
            return
        self.set_result(result)

    def executing(self) -> bool:
        """Always False: one thread runs everything."""
        return False
