"""What the process of a controller is told at its start."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.abc import ExecutionLoader, MetaPathFinder
from importlib.machinery import ModuleSpec
from typing import NamedTuple


class SentModule(NamedTuple):
    """A module that is not on this machine: the path it has elsewhere, and what stands there."""

    path: str
    source: bytes


class SentModules(ExecutionLoader, MetaPathFinder):
    """Imports modules from memory."""

    def __init__(self, known: Mapping[str, SentModule]) -> None:
        """Know modules by their names."""
        self.known = dict(known)

    def be_found(self) -> None:
        """Have imports find them, before any other of their names."""
        sys.meta_path.insert(0, self)

    def find_spec(self, fullname: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Find a module that was sent."""
        return importlib.util.spec_from_loader(fullname, self) if fullname in self.known else None

    def get_source(self, fullname: str) -> str:
        """Return its text."""
        return importlib.util.decode_source(self.known[fullname].source)

    def get_filename(self, fullname: str) -> str:
        """Return its path where it came from."""
        return self.known[fullname].path


@dataclass(frozen=True)
class Beginning:
    """What to load, and from where.

    Attributes:
        path: `sys.path`.
        name: of the controller.
        multiplier: of a controller that has one.
        modules: that are found in memory.
    """

    path: tuple[str, ...]
    name: str
    multiplier: float
    modules: SentModules | None
