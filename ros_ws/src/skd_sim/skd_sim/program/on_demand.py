"""Libraries that are imported when something of them is first used: for those that most starts do without."""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import Any


class _OnDemand(ModuleType):
    """Stands for a module until something of it is asked for, and keeps what was."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # what Python itself asks every module: nobody uses the library thereby
            raise AttributeError(name)
        found = getattr(importlib.import_module(self.__name__), name)
        vars(self)[name] = found
        return found


def on_demand(name: str) -> Any:
    """Return what stands for a module whose import takes long.

    `importlib.util.LazyLoader` would do the same, but two threads that ask at once may get half a module (CPython
    issue 114763), and it looks for the module at the start.

    Args:
        name: full name of the module, as `scipy.special`.
    """
    return _OnDemand(name)
