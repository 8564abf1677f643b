"""Make ``import rclpy`` and ``import nav_msgs.msg`` work where ROS 2 is not installed.

Imported at every interpreter start through ``rosless.pth``, so it imports nothing beyond what the
interpreter has already loaded; the rest of the package is imported when a name that it serves is asked for.
"""

from __future__ import annotations

import _thread
import os
import sys

TYPE_CHECKING = False  # typing's own constant would have typing imported at every interpreter start
if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

else:
    ModuleSpec = type(sys.__spec__)  # the class without the package importlib around it

# Looked at only to say "not ours" without loading the message definitions.
_RCLPY = "rclpy"
_DISABLE = "ROSLESS_DISABLE"


class _ServedLoader:
    """Fills a module from the facade or from the message definitions."""

    def __init__(self, fullname: str) -> None:
        self._fullname = fullname

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Have the import system make an ordinary module."""
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Fill the module."""
        from rosless import facade

        facade.fill(module, self._fullname)


class RoslessFinder:
    """The last finder of all: it is asked only for what nobody else on the path has.

    It serves all or nothing: as soon as a real rclpy can be found, this finder answers no import at all, so
    that message classes never come from one place and rclpy from the other.
    """

    def __init__(self) -> None:
        self._real_rclpy = False
        self._real_rclpy_path: tuple[str, ...] | None = None
        self._searching: set[int] = set()

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Answer for rclpy and for message packages, if no real rclpy does."""
        # What is imported below may itself try modules that do not exist (pathlib asks for "nt").
        thread = _thread.get_ident()
        if thread in self._searching:
            return None
        self._searching.add(thread)
        try:
            return self._find(fullname)
        finally:
            self._searching.discard(thread)

    def _find(self, fullname: str) -> ModuleSpec | None:
        root = fullname.partition(".")[0]
        if root != _RCLPY:
            if not _may_be_interfaces(fullname):
                return None
            if root not in sys.modules and not _is_message_package(root):
                return None
        if os.environ.get(_DISABLE) or self._real_rclpy_exists():
            return None
        from rosless import facade

        parent = sys.modules.get(fullname.rpartition(".")[0])
        if fullname.count(".") == 2 and parent is not None and root != _RCLPY:
            facade.complete_namespace(parent)
        if not facade.serves(fullname):
            return None
        return ModuleSpec(
            fullname,
            _ServedLoader(fullname),  # type: ignore[arg-type]  # importlib.abc.Loader is too slow to import here
            origin="rosless",
            is_package=facade.is_package(fullname),
        )

    def _real_rclpy_exists(self) -> bool:
        loaded = sys.modules.get(_RCLPY)
        if loaded is not None:
            return getattr(loaded.__spec__, "origin", None) != "rosless"
        # sys.path can change between imports, so the answer is kept only as long as it does not.
        state = tuple(sys.path)
        if self._real_rclpy_path != state:
            self._real_rclpy = any(
                finder.find_spec(_RCLPY, None) is not None
                for finder in sys.meta_path
                if finder is not self and not isinstance(finder, RoslessFinder) and hasattr(finder, "find_spec")
            )
            self._real_rclpy_path = state
        return self._real_rclpy


def _may_be_interfaces(fullname: str) -> bool:
    """True for the shapes ``pkg``, ``pkg.msg``, ``pkg.msg._name`` and the same with ``srv``."""
    parts = fullname.split(".")
    return len(parts) == 1 or (len(parts) <= 3 and parts[1] in ("msg", "srv"))


def _is_message_package(root: str) -> bool:
    from rosless.interfaces import packages

    return packages.exists(root)


def activate() -> None:
    """Append the finder to ``sys.meta_path``, once."""
    if not any(isinstance(finder, RoslessFinder) for finder in sys.meta_path):
        sys.meta_path.append(RoslessFinder())


activate()
