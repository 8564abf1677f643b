"""rclpy.guard_condition: wake an executor from anywhere."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rosless.callback_groups import CallbackGroup
from rosless.context import Context
from rosless.exceptions import InvalidHandle
from rosless.utilities import get_default_context
from rosless.wire import GuardHandle


class GuardCondition:
    """Runs a callback in the executor after :meth:`trigger`."""

    def __init__(
        self,
        callback: Callable[[], Any] | None,
        callback_group: CallbackGroup | None,
        context: Context | None = None,
    ) -> None:
        self._context = get_default_context() if context is None else context
        self._handle = GuardHandle(self._context.participant.entity)
        self.callback = callback
        self.callback_group = callback_group

    @property
    def wait_entity(self) -> int:
        """What a wait set attaches."""
        return self._handle.entity

    def trigger(self) -> None:
        """Have the callback run."""
        if not self._handle.entity:
            raise InvalidHandle("the guard condition has been destroyed")
        self._handle.trigger()

    def take(self) -> tuple[Callable[..., Any], tuple[()]] | None:
        """What to run after waking."""
        self._handle.clear()
        return None if self.callback is None else (self.callback, ())

    def destroy(self) -> None:
        """Destroy the condition."""
        self._handle.delete()
