"""rclpy.callback_groups. The executors here run one callback at a time, so every group is exclusive."""

from __future__ import annotations

import weakref
from typing import Any


class CallbackGroup:
    """A set of entities whose callbacks belong together."""

    def __init__(self) -> None:
        self.entities: weakref.WeakSet[Any] = weakref.WeakSet()

    def add_entity(self, entity: Any) -> None:
        """Add an entity."""
        self.entities.add(entity)

    def has_entity(self, entity: Any) -> bool:
        """True if an entity has been added."""
        return entity in self.entities

    def can_execute(self, entity: Any) -> bool:
        """True if a callback of the entity may run now."""
        return True

    def beginning_execution(self, entity: Any) -> bool:
        """Called before a callback runs."""
        return True

    def ending_execution(self, entity: Any) -> None:
        """Called after a callback ran."""


class ReentrantCallbackGroup(CallbackGroup):
    """Callbacks may run at the same time; here they do not."""


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """One callback at a time."""
