"""Kernels that wait for numba, whose import takes longer than the rest of a start: for a process that may need none.

`put_off` has `skd_sim.kernels.compilation.kernel` leave functions as `Waiting`. The first one that is called, or the
import of numba by anybody else, turns all of them into kernels, wherever a module holds one. Results are the same.
"""

from __future__ import annotations

import functools
import importlib.util
import sys
import threading
from collections.abc import Callable
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any, Final

from skd_sim.program.lasting import import_lasting

_NUMBA: Final = "numba"
_lock: Final = threading.RLock()
_waiting: Final[list[Waiting]] = []


class Waiting:
    """A function that becomes a kernel when it is first used."""

    def __init__(self, function: Callable[..., Any], options: dict[str, bool]) -> None:
        """Keep what is to be compiled, and how."""
        functools.update_wrapper(self, function)
        self._function, self._options = function, options
        self._kernel: Any = None
        _waiting.append(self)

    def compile(self) -> Any:
        """Return the kernel that this is from now on."""
        if self._kernel is None:
            compiled = import_lasting("skd_sim.kernels.compiler.machine_code").compiled
            self._kernel = compiled(self._function, **self._options)
        return self._kernel

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call the kernel."""
        if self._kernel is None:
            compile_waiting()
        return self.compile()(*arguments, **named)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        compile_waiting()
        return getattr(self.compile(), name)

    def __deepcopy__(self, memo: dict[int, Any]) -> Waiting:
        return self


class _Watch(MetaPathFinder):
    """Notices that somebody imports numba, who may call kernels from code that numba compiles."""

    def find_spec(self, fullname: str, path: Any = None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Have kernels compiled once numba is there; none of the others is looked for here."""
        if fullname != _NUMBA:
            return None
        sys.meta_path.remove(self)
        found = importlib.util.find_spec(_NUMBA)
        if found is None or found.loader is None:
            return found
        execute = found.loader.exec_module

        def execute_and_compile(module: ModuleType) -> None:
            execute(module)
            compile_waiting()

        vars(found.loader)["exec_module"] = execute_and_compile
        return found


def put_off() -> None:
    """Have kernels wait from now on until one is needed, unless numba is there already."""
    if _NUMBA not in sys.modules and not is_put_off():
        sys.meta_path.insert(0, _Watch())


def is_put_off() -> bool:
    """Whether kernels wait."""
    return any(isinstance(finder, _Watch) for finder in sys.meta_path)


def compile_for(value: object) -> None:
    """Turn all that wait into kernels, if a module of the object's classes holds one: it will soon be called."""
    modules = (sys.modules.get(kind.__module__) for kind in type(value).__mro__)
    if any(isinstance(held, Waiting) for module in modules if module for held in vars(module).values()):
        compile_waiting()


def compile_waiting() -> None:
    """Turn all that wait into kernels, in every module that holds one."""
    with _lock:
        import_lasting(_NUMBA)
        if not _waiting:
            return
        _waiting.clear()
        for module in list(sys.modules.values()):
            names = getattr(module, "__dict__", None)
            if not isinstance(names, dict):
                continue
            for name, value in list(names.items()):
                if type(value) is Waiting:
                    names[name] = value.compile()
