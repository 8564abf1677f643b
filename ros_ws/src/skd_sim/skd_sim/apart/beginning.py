"""What the process of a controller is told at its start."""

from __future__ import annotations

import importlib.util
import runpy
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.abc import ExecutionLoader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
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
        main: path of the program, for a class that stands there; empty for any other.
    """

    path: tuple[str, ...]
    name: str
    multiplier: float
    modules: SentModules | None
    main: str = ""


def be_main(path: str) -> None:
    """Have `__main__` be a program, as far as it is one that is imported."""
    module = ModuleType("__mp_main__")  # by which a program knows that it is not to begin: the name that Python uses
    vars(module).update(runpy.run_path(path, run_name=module.__name__))
    sys.modules["__main__"] = module
